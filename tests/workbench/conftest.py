"""A simulated case, servers in processes of their own, and one Chromium for all tests."""

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from tests.workbench.driving import FLAGS, Driver

CHROMIUM = os.environ.get("SCREWPOSE_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


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


class Server:
    """`screwpose open` as a user starts it."""

    def __init__(self, path: Path, *options: str) -> None:
        command = [sys.executable, "-m", "screwpose", "open", str(path), "--no-browser", *options]
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        environment.pop("PYTEST_CURRENT_TEST", None)  # by which NiceGUI believes itself in its own tests
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
        )
        self.said: list[str] = []
        for line in self.process.stdout:
            self.said.append(line)
            if re.match(r"http://\S+$", line):
                self.address = line.strip()
                break
        else:
            raise AssertionError(f"the server did not start: {''.join(self.said)}")
        self.reader = threading.Thread(target=self._listen, daemon=True)
        self.reader.start()

    @property
    def base(self) -> str:
        """The address of the server without a page."""
        return re.match(r"http://[^/]+", self.address)[0]

    def _listen(self) -> None:
        self.said.extend(self.process.stdout)

    def kill(self) -> None:
        """End it as a power cut would."""
        self.process.kill()
        self._ended()

    def stop(self) -> None:
        """End it as Ctrl-C does."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self._ended()

    def _ended(self) -> None:
        self.process.wait()
        self.reader.join()
        self.process.stdout.close()


@pytest.fixture
def serve():
    """Start servers that end with the test; what went wrong in them fails it."""
    servers = []

    def start(path: Path, *options: str) -> Server:
        servers.append(Server(path, *options))
        return servers[-1]

    yield start
    for server in servers:
        server.stop()
    said = "".join(line for server in servers for line in server.said)
    assert "Traceback" not in said, said


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
    context.set_default_timeout(60_000)
    drivers = []

    def start(address: str) -> Driver:
        drivers.append(Driver(context.new_page(), address))
        return drivers[-1]

    yield start
    wrong = [one for driver in drivers for one in driver.errors]
    context.close()
    assert not wrong, wrong
