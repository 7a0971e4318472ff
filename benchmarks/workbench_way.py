"""A new user's way, timed: two X-rays, calibrations and a CAD file to a reviewed result, with a person's pauses.

    python benchmarks/workbench_way.py -o way-out

A person reads a page before the first click (3 s), moves to a point and aims (1.8 s a landmark, after zooming in), and
looks at the answer (8 s) and at 3D (4 s) before exporting. The clicks are the simulated marks, 1.5 px off the truth.
Writes workbench_way.json; needs playwright and a Chromium.
"""

import argparse
import json
import os
import platform
import sys
import tempfile
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rich.console import Console

from screwpose.files import write_json
from screwpose.files.case import read_case
from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from tests.workbench.driving import CHROMIUM, FLAGS, Driver, Server, case_in

READS_S, AIMS_S, LOOKS_S = 3.0, 1.8, 8.0


def walk(place: Path, tab: Driver) -> dict[str, float]:
    """The whole way; seconds at the end of each stage."""
    simulated = place / "given"
    case, given = read_case(simulated), case_in(simulated)
    for view in ("AP", "LAT"):
        rows = case.views[view].camera.projection.tolist()
        (place / f"calibration_{view.lower()}.txt").write_text("\n".join(" ".join(map(repr, row)) for row in rows))
    files = [simulated / "ap.png", simulated / "lat.png", next((simulated / "models").glob("*.stl"))]
    files += [place / "calibration_ap.txt", place / "calibration_lat.txt"]
    times = {}
    start = perf_counter()

    def pause(seconds: float) -> None:
        tab.page.wait_for_timeout(1000 * seconds)

    pause(READS_S)
    tab.give_files(*files)
    tab.page.wait_for_url("**/case/*")
    tab.page.wait_for_function("document.querySelectorAll('.preview').length === 2")
    pause(READS_S)
    tab.button("Mark the screws").click()
    tab.see_xrays()
    times["images"] = perf_counter() - start
    for view in ("AP", "LAT"):
        pause(READS_S)
        for one in given["annotations"][view]:
            pause(AIMS_S)  # twice: mark() clicks both points
            pause(AIMS_S)
            tab.mark(view, one["tip"], one["center"])
    tab.text("Suggested pairs").wait_for()
    times["marked"] = perf_counter() - start
    pause(READS_S)
    tab.button("Solve").click()
    tab.solved()
    times["solved"] = perf_counter() - start
    pause(LOOKS_S)
    tab.page.locator(".screw").first.click()
    pause(READS_S)
    tab.go("3D")
    tab.page.locator(".scene canvas").wait_for()
    pause(LOOKS_S / 2)
    times["reviewed"] = perf_counter() - start
    tab.go("Export")
    tab.button("Write the report").click()
    tab.page.get_by_role("link", name="Get report.html").wait_for()
    times["exported"] = perf_counter() - start
    return times


def main(out: Path) -> None:
    """Walk once with everything compiled before."""
    from playwright.sync_api import sync_playwright

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        place = Path(folder)
        write_case(two_screw_scene(11, landmark_noise_px=1.5), place / "given")
        server = Server(place / "cases")
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        try:
            page = browser.new_context(viewport={"width": 1280, "height": 720}).new_page()
            times = walk(place, Driver(page, server.address))
        finally:
            browser.close()
            server.stop()
    record = {"seconds": times, "cpus": os.cpu_count(), "load": os.getloadavg()[0], "python": platform.python_version()}
    write_json(out / "workbench_way.json", record)
    Console().print_json(json.dumps(record))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True)
    main(parser.parse_args().out)
