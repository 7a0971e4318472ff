"""A simulated case, servers in processes of their own, and one Chromium for all tests."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from tests.workbench.driving import CHROMIUM, FLAGS, Driver, Server


@pytest.fixture(scope="session")
def simulated(tmp_path_factory) -> Path:
    """The folder of a case of two screws, 320 x 320 px, with its truth; to be left as it is."""
    folder = tmp_path_factory.mktemp("workbench") / "two screws"
    write_case(two_screw_scene(7, landmark_noise_px=0.5, image_size=(320, 320)), folder)
    return folder


@pytest.fixture
def workspace(simulated, tmp_path) -> Path:
    """A folder of cases with one in it, ``demo``."""
    shutil.copytree(simulated, tmp_path / "cases" / "demo")
    return tmp_path / "cases"


@pytest.fixture
def serve():
    """Start servers that end with the test; what went wrong in them fails it."""
    servers = []

    def start(path: Path, *options: str, **variables: str) -> Server:
        servers.append(Server(path, *options, **variables))
        return servers[-1]

    yield start
    for server in servers:
        server.stop()
    said = "".join(line for server in servers for line in server.said)
    assert "Traceback" not in said, said


@pytest.fixture
def slow(tmp_path) -> dict[str, str]:
    """Variables under which a solve compiles first, and so is still running for whoever acts at once."""
    return {"NUMBA_CACHE_DIR": str(tmp_path / "compiled")}


@pytest.fixture(scope="session")
def chromium() -> Iterator[object]:
    """The browser."""
    if CHROMIUM is None or not Path(CHROMIUM).exists():
        pytest.skip("no chromium on this machine (SCREWPOSE_CHROMIUM names another): the workbench was not driven")
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: the workbench was not driven")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def open_tab(chromium):
    """Open tabs in a browser profile of their own; an error in the page fails the test."""
    context = chromium.new_context(viewport={"width": 1280, "height": 720}, accept_downloads=True)
    context.set_default_timeout(
        300_000
    )  # a first solve after installation compiles, which takes minutes on a busy machine
    drivers = []

    def start(address: str) -> Driver:
        drivers.append(Driver(context.new_page(), address))
        return drivers[-1]

    yield start
    wrong = [one for driver in drivers for one in driver.errors]
    context.close()
    assert not wrong, wrong
