"""The page in a real browser, the network off; skipped where there is none."""

import re
import shutil
import subprocess

import pytest

from screwpose.report import write_report
from tests.report.scene import make_case, make_result

WITHOUT_WEBGL = ("--disable-gpu", "--disable-3d-apis")
SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    case, truth = make_case()
    write_report(folder, case, make_result(case, truth))
    return folder / "report.html"


def loaded(page, flags, state=""):
    """The page's document after its scripts ran, and what the browser complained about."""
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("no chromium on this machine: the page was not tried in a browser")
    command = [
        browser, "--headless", "--no-sandbox", "--disable-dev-shm-usage",
        "--host-resolver-rules=MAP * ~NOTFOUND", "--enable-logging=stderr",
        f"--user-data-dir={page.parent / 'profile'}", "--virtual-time-budget=3000", *flags, "--dump-dom",
        f"{page.as_uri()}#{state}",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def shown_scenes(document):
    return set(re.findall(r'<g data-scene="([^"]+)">', document))


def test_the_3d_view_is_drawn(page):
    document, complaints = loaded(page, SOFTWARE_WEBGL)
    assert 'data-ready="yes"' in document
    assert re.search(r'<div class="space"[^>]*data-state="ready"[^>]*><canvas', document)
    assert re.search(r'<img class="still" id="still"[^>]*hidden', document)
    # Chromium notes that the pixels are read back for printing, no more.
    assert [line for line in complaints if "GL Driver Message" not in line] == []


def test_without_webgl_the_still_picture_stands_and_the_address_chooses_what_is_seen(page):
    document, _ = loaded(page, WITHOUT_WEBGL, "combination=2&stage=pre&hide=fill,mask,truth")
    assert 'data-ready="yes"' in document
    assert re.search(r'<p class="note" id="no-webgl">', document)
    assert not re.search(r'<img class="still" id="still"[^>]*hidden', document)
    assert shown_scenes(document) == {"2-pre"}
    overlays = re.search(r'<section class="([^"]*)" id="overlays"', document)[1].split()
    assert "hide-fill" in overlays
    assert "hide-outline" not in overlays
