"""The site as it is built: strictly, whole, and asking no other machine for anything."""

import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import pytest

from screwpose.files.publish_schemas import SHIPPED
from tests.docs.pages import ROOT

FETCHED = {("script", "src"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("use", "href")}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site") / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr + done.stdout
    return folder


class Fetches(HTMLParser):
    """What a browser would fetch to show a page."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag == "link" and values.get("rel") != "canonical":
            self.found += [values["href"]] if values.get("rel") not in ("next", "prev") else []
        self.found += [values[key] for name, key in FETCHED if tag == name and values.get(key)]


def test_every_page_is_there_and_asks_for_nothing_elsewhere(site):
    pages = sorted(path.name for path in site.glob("*.html"))
    assert len(pages) >= 12
    for page in pages:
        fetched = Fetches((site / page).read_text(encoding="utf-8")).found
        assert len(fetched) >= 5, page
        for address in fetched:
            assert not re.match(r"(\w+:)?//", address), f"{page}: {address}"
            if page != "404.html":
                assert (site / address.split("?")[0]).is_file(), f"{page}: {address}"


def test_fetches_are_seen():
    text = '<link rel="stylesheet" href="https://fonts.example/a.css"><script src="//cdn.example/x.js"></script>'
    assert Fetches(text).found == ["https://fonts.example/a.css", "//cdn.example/x.js"]


def test_the_sites_schemas_are_the_ones_that_the_program_ships(site):
    shipped = {path.name: path.read_bytes() for path in SHIPPED.glob("*.schema.json")}
    assert sorted(shipped) == [f"{kind}.schema.json" for kind in ("case", "result", "summary", "truth")]
    assert {path.name: path.read_bytes() for path in (site / "schemas").iterdir()} == shipped


def test_search_works_from_a_folder_with_the_network_off(site):
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("no chromium on this machine: the site was not tried in a browser")
    command = [
        browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--host-resolver-rules=MAP * ~NOTFOUND", "--enable-logging=stderr", "--allow-file-access-from-files",
        f"--user-data-dir={site.parent / 'profile'}", "--virtual-time-budget=5000", "--dump-dom",
        f"{(site / 'index.html').as_uri()}?q=triangulation",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert re.search(r'class="md-search-result__link"[^>]*href="[^"]*method\.html', done.stdout) or re.search(
        r'href="[^"]*method\.html[^"]*"[^>]*class="md-search-result__link"', done.stdout
    )
    assert [line for line in done.stderr.splitlines() if "CONSOLE" in line] == []
