"""The pictures of the workbench in the docs: the demo case, from the start page to 3D, dark and light.

    python benchmarks/picture_workbench.py -o docs/images
    python benchmarks/picture_workbench.py -o /tmp/large --size 3840 2160

Needs playwright and a Chromium (SCREWPOSE_CHROMIUM names one).
"""

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from tests.workbench.driving import CHROMIUM, FLAGS, Driver, Server


def shoot(tab: Driver, out: Path, name: str) -> None:
    """Once nothing moves any more, and no button under the mouse explains itself; where a mark is looked at, the mouse
    stays."""
    if name != "mark":
        tab.page.mouse.move(2, 2)
    tab.page.wait_for_timeout(900)
    tab.page.screenshot(path=out / f"workbench-{name}.jpg", type="jpeg", quality=82)


def take(out: Path, size: tuple[int, int]) -> None:
    """All pictures into a folder."""
    from playwright.sync_api import sync_playwright

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        write_case(two_screw_scene(7, landmark_noise_px=1.5), Path(place) / "cases" / "demo")
        server = Server(Path(place) / "cases")
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        try:
            context = browser.new_context(viewport={"width": size[0], "height": size[1]})
            tab = Driver(context.new_page(), server.base)
            _dark(tab, server, out)
            tab.page.get_by_role("button", name="Dark or light").click()
            shoot(tab, out, "space-light")
            tab.go("Solve & review")
            tab.see_xrays()
            shoot(tab, out, "review-light")
            tab.page.goto(server.base)
            shoot(tab, out, "start-light")
        finally:
            browser.close()
            server.stop()


def _dark(tab: Driver, server: Server, out: Path) -> None:
    shoot(tab, out, "start")
    tab.page.goto(f"{server.base}/case/demo")
    tab.page.wait_for_function("document.querySelectorAll('.preview').length === 2")
    shoot(tab, out, "images")
    tab.go("Mark")
    tab.see_xrays()
    tab.text("Suggested pairs").wait_for()
    tab.zoom_to("LAT", (370, 600), 2.2 * tab.page.evaluate("window.screwposeViewers.LAT.place.zoom"))
    tab.page.mouse.move(*tab.place_of("AP", (472, 574)))
    shoot(tab, out, "mark")
    tab.button("Solve").click()
    tab.button("Cancel").wait_for()
    tab.page.wait_for_function(
        "Number(document.querySelector('.running [role=progressbar]')?.getAttribute('aria-valuenow') ?? 1) > 0.2"
    )
    shoot(tab, out, "solving")
    tab.solved()
    tab.page.locator(".screw").first.click()
    shoot(tab, out, "review")
    tab.page.locator(".screw").first.click()
    tab.go("3D")
    tab.page.locator(".scene canvas").wait_for()
    tab.page.wait_for_timeout(1500)
    shoot(tab, out, "space")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720))
    given = parser.parse_args()
    take(given.out, tuple(given.size))
