"""A server as a user starts it, a tab on it, and what a person does there."""

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

CHROMIUM = os.environ.get("SCREWPOSE_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-dev-shm-usage", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)  # fmt: skip
# What a page says when its server is killed, as tests do; and WebGL in software reading its pixels back.
_EXPECTED = ("GL Driver Message", "WebSocket", "ERR_CONNECTION", "Failed to load resource")


class Server:
    """`screwpose open` as a user starts it."""

    def __init__(self, path: Path, *options: str, **variables: str) -> None:
        command = [sys.executable, "-m", "screwpose", "open", str(path), "--no-browser", *options]
        environment = {**os.environ, "PYTHONUNBUFFERED": "1", **variables}
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


class Driver:
    """One tab on one address."""

    def __init__(self, page, address: str) -> None:
        self.page = page
        self.errors: list[str] = []
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", self._console)
        page.goto(address)

    def _console(self, message) -> None:
        if message.type == "error" and not any(one in message.text for one in _EXPECTED):
            self.errors.append(message.text)

    # ---- where things are
    def button(self, name: str):
        return self.page.get_by_role("button", name=name, exact=True)

    def text(self, words: str):
        return self.page.get_by_text(words, exact=False).first

    def canvas(self, view: str):
        return self.page.get_by_role("application", name=f"X-ray {view}")

    def go(self, stage: str) -> None:
        """To another stage, and there: a `Solve` of the stage before, clicked while it goes, is never heard."""
        self.button(stage).click()
        self.page.locator(".stages button[aria-current=page]", has_text=stage).wait_for()

    def see_xrays(self) -> None:
        """Wait until both X-rays are on the screen."""
        self.page.wait_for_function("['AP', 'LAT'].every((view) => window.screwposeViewers?.[view]?.$el.dataset.shown)")

    def place_of(self, view: str, point) -> tuple[float, float]:
        """Where an image point is on the screen."""
        x, y = self.page.evaluate(
            """([view, point]) => {
                const one = window.screwposeViewers[view], box = one.$refs.over.getBoundingClientRect();
                const [x, y] = one.toScreen(point);
                return [box.left + x / one.ratio, box.top + y / one.ratio];
            }""",
            [view, list(point)],
        )
        return x, y

    # ---- what a hand does
    def give_files(self, *paths: Path) -> None:
        """As if they were dropped: the same input takes both."""
        self.page.locator("input[type=file]").first.set_input_files([str(one) for one in paths])

    def click_point(self, view: str, point) -> None:
        self.page.mouse.click(*self.place_of(view, point))

    def drag_point(self, view: str, start, end) -> None:
        self.page.mouse.move(*self.place_of(view, start))
        self.page.mouse.down()
        x, y = self.place_of(view, end)
        self.page.mouse.move(x - 8, y - 8)
        self.page.mouse.move(x, y, steps=4)
        self.page.mouse.up()

    def zoom_to(self, view: str, point, zoom: float) -> None:
        """With the wheel, until an image pixel is so many on the screen."""
        self.page.mouse.move(*self.place_of(view, point))
        for _ in range(60):
            if self.page.evaluate(f"window.screwposeViewers['{view}'].place.zoom") >= zoom:
                return
            self.page.mouse.wheel(0, -120)
            self.page.evaluate("() => new Promise(requestAnimationFrame)")
        raise AssertionError("the wheel does not zoom")

    def mark(self, view: str, tip, center) -> None:
        """A whole screw, seen near; the whole image again afterwards."""
        long_px = max(abs(a - b) for a, b in zip(tip, center, strict=True))
        self.zoom_to(view, [(a + b) / 2 for a, b in zip(tip, center, strict=True)], min(6.0, 220.0 / long_px))
        self.click_point(view, tip)
        self.text(f"{view} ").wait_for()
        self.page.wait_for_function(f"window.screwposeViewers['{view}'].state.begun !== null")
        self.click_point(view, center)
        self.page.wait_for_function(f"window.screwposeViewers['{view}'].state.begun === null")
        self.page.keyboard.press("0")

    def solved(self) -> None:
        """Wait for the answer."""
        self.text("Combinations").wait_for()


def awaited(work):
    """What a coroutine gives. In a thread of its own: the browser's driver has a loop running in this one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, work).result()


def case_in(folder: Path) -> dict:
    return json.loads((folder / "case.json").read_text())


def side_of(folder: Path) -> dict:
    return json.loads((folder / "workbench.json").read_text())


def result_in(folder: Path) -> dict:
    return json.loads((folder / "result" / "result.json").read_text())
