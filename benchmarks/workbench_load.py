"""Does the workbench stay fluid under load? Frames of large X-rays, and many browsers on one server.

    python benchmarks/workbench_load.py -o load-out
    python benchmarks/workbench_load.py -o load-out --browsers 20

Frames: a pair of 3000 x 3000 px of 16 bit with 16 screws marked; the wheel and the hand zoom and pan for some seconds.
Reported are the time that drawing a frame takes in the page, and the time from frame to frame. Headless Chromium draws
WebGL in software here, which is many times slower than any graphics card: what is measured is an upper bound.

Browsers: each opens a case of its own, moves a mark of its own to a place of its own, and asks for a solve. At the end
every case must have its own marks and the result of its own case.
Writes workbench_load.json; needs playwright and a Chromium.
"""

import argparse
import json
import os
import shutil
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rich.console import Console

from screwpose.files import write_bytes, write_json
from screwpose.images import encode_png
from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from tests.workbench.driving import CHROMIUM, FLAGS, Driver, Server, case_in, result_in

SIDE_PX, SCREWS = 3000, 16


def large_case(given: Path, folder: Path) -> None:
    """The demo's X-rays at 3000 x 3000 px and 16 bit, with noise of their own, and 16 screws in each."""
    import cv2
    import imagecodecs

    shutil.copytree(given, folder)
    data = case_in(folder)
    rng = np.random.default_rng(1)
    scale = SIDE_PX / 1024
    for name, view in data["views"].items():
        small = np.asarray(imagecodecs.png_decode((folder / view["image"]).read_bytes()), dtype=np.float32)
        large = cv2.resize(small, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_CUBIC) * (
            65535.0 / np.iinfo(np.uint8).max
        )
        noisy = np.clip(large + rng.normal(0.0, 300.0, large.shape), 0, 65535).astype(np.uint16)
        write_bytes(folder / view["image"], encode_png(noisy))
        # Integer pixels are centres: (u + 0.5) is what scales.
        grown = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1]])
        view["projection"] = (grown @ np.array(view["projection"])).tolist()
        marks = data["annotations"][name]
        data["annotations"][name] = [
            {
                **marks[index % len(marks)],
                "label": f"{name[0].lower()}{index}",
                **{
                    key: [
                        (x + 0.5) * scale - 0.5 + shift
                        for x, shift in zip(marks[index % 2][key], _spread(index), strict=True)
                    ]
                    for key in ("tip", "center")
                },
            }
            for index in range(SCREWS)
        ]
    write_json(folder / "case.json", data)


def _spread(index: int) -> tuple[float, float]:
    return 90.0 * (index // 2) - 300.0, 110.0 * (index // 2) - 500.0


def frames(tab: Driver) -> dict[str, float]:
    """Zoom and pan for some seconds; milliseconds of drawing and from frame to frame."""
    tab.go("Mark")
    tab.see_xrays()
    tab.page.evaluate(
        """() => {
            window.screwposeViewers.AP.times.length = 0;
            window.gaps = [];
            let last = performance.now();
            const tick = (now) => {
                window.gaps.push(now - last);
                last = now;
                window.ticking = requestAnimationFrame(tick);
            };
            window.ticking = requestAnimationFrame(tick);
        }"""
    )
    x, y = tab.place_of("AP", (1500, 1500))
    for step in range(60):
        tab.page.mouse.move(x + 60 * np.sin(step / 6), y + 60 * np.cos(step / 6))
        tab.page.mouse.wheel(0, -40 if step < 30 else 40)
    tab.page.mouse.down()
    for step in range(60):
        tab.page.mouse.move(x + 3 * step, y + 2 * step)
    tab.page.mouse.up()
    tab.page.evaluate("cancelAnimationFrame(window.ticking)")
    drawn, gaps = tab.page.evaluate("[window.screwposeViewers.AP.times, window.gaps.slice(2)]")
    return {
        "frames": len(drawn),
        **{
            f"draw_ms_{name}": round(float(np.percentile(drawn, q)), 2)
            for name, q in (("median", 50), ("p95", 95), ("max", 100))
        },
        **{
            f"gap_ms_{name}": round(float(np.percentile(gaps, q)), 2)
            for name, q in (("median", 50), ("p95", 95), ("max", 100))
        },
    }


def many(server: Server, workspace: Path, browser: object, count: int) -> dict[str, object]:
    """So many browsers at once, each with a case of its own."""
    start = perf_counter()
    tabs = []
    for number in range(count):
        page = browser.new_context(viewport={"width": 900, "height": 600}).new_page()
        page.set_default_timeout(600_000)
        tabs.append(Driver(page, f"{server.base}/case/many-{number}"))
    wanted = {}
    for number, tab in enumerate(tabs):
        tab.go("Mark")
        tab.see_xrays()
        tip = _first_tip(workspace, number)
        wanted[number] = [tip[0] + 0.1 * (number + 1), tip[1]]
        tab.page.wait_for_function(
            "window.screwposeViewers.AP.state.editable && window.screwposeViewers.AP.state.marks.length"
        )
        tab.canvas("AP").focus()
        tab.page.keyboard.press("]")
        tab.page.wait_for_function("window.screwposeViewers.AP.state.selected")
        for _ in range(number + 1):
            tab.page.keyboard.press("ArrowRight")
    for tab in tabs:
        tab.page.wait_for_function("!document.querySelector('[aria-label^=\"Undo\"]').disabled")
        tab.page.wait_for_timeout(300)
        tab.go("Solve & review")
        tab.button("Solve").click()
    queued = perf_counter() - start
    for tab in tabs:
        tab.solved()
    crossed = [
        number
        for number in range(count)
        if np.abs(np.subtract(_first_tip(workspace, number), wanted[number])).max() > 0.02
        or result_in(workspace / f"many-{number}")["case"] != case_in(workspace / f"many-{number}")["id"]
    ]
    return {
        "browsers": count,
        "seconds_to_all_queued": round(queued, 1),
        "seconds_to_all_solved": round(perf_counter() - start, 1),
        "errors": [one for tab in tabs for one in tab.errors], "crossed": crossed,
        "server": [line.strip() for line in server.said[2:]],
    }  # fmt: skip


def _first_tip(workspace: Path, number: int) -> list[float]:
    return case_in(workspace / f"many-{number}")["annotations"]["AP"][0]["tip"]


def main(out: Path, browsers: int) -> None:
    """Both, and write what was measured."""
    from playwright.sync_api import sync_playwright

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        workspace = Path(folder) / "cases"
        write_case(two_screw_scene(7, landmark_noise_px=1.5), workspace / "given")
        large_case(workspace / "given", workspace / "large")
        write_case(two_screw_scene(7, landmark_noise_px=0.5, image_size=(320, 320)), workspace / "small")
        for number in range(browsers):
            shutil.copytree(workspace / "small", workspace / f"many-{number}")
            data = case_in(workspace / f"many-{number}")
            write_json(workspace / f"many-{number}" / "case.json", {**data, "id": f"many-{number}"})
        server = Server(workspace)
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        try:
            page = browser.new_context(viewport={"width": 1280, "height": 720}).new_page()
            page.set_default_timeout(120_000)
            record: dict[str, object] = {"frames": frames(Driver(page, f"{server.base}/case/large"))}
            page.close()
            if browsers:
                record["many"] = many(server, workspace, browser, browsers)
        finally:
            browser.close()
            server.stop()
    record |= {"cpus": os.cpu_count(), "load": os.getloadavg()[0]}
    write_json(out / "workbench_load.json", record)
    Console().print_json(json.dumps(record))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--browsers", type=int, default=20)
    given = parser.parse_args()
    main(given.out, given.browsers)
