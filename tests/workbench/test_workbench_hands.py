"""What a hand does that other tests leave out: the demo, fingers, the loupe, overlays by keys, a click in 3D."""

import shutil

import numpy as np
import pytest

from screwpose.files.case import read_case
from screwpose.workbench.tasks import TASKS
from tests.workbench.driving import case_in
from tests.workbench.test_workbench_viewer import ZOOM, colourful, seen, seen_once, settled


@pytest.fixture(scope="module")
def solved(simulated, tmp_path_factory):
    """The folder of a case that is solved, to be copied."""
    folder = tmp_path_factory.mktemp("solved") / "demo"
    shutil.copytree(simulated, folder)
    TASKS["solve"](lambda _fraction, _what: None, str(folder), None, [], None)
    return folder


@pytest.fixture
def reviewed(solved, tmp_path, serve, open_tab):
    """A tab on a case that is solved."""
    shutil.copytree(solved, tmp_path / "cases" / "demo")
    return open_tab(serve(tmp_path / "cases" / "demo").address)


def test_the_demo_is_one_click_away(tmp_path, serve, open_tab):
    tab = open_tab(serve(tmp_path / "cases").address)
    tab.button("Try the demo case").click()
    tab.page.wait_for_url("**/case/demo")
    tab.button("Mark the screws").wait_for()
    tab.page.wait_for_function("document.querySelectorAll('.preview').length === 2")
    tab.button("Mark the screws").click()
    tab.see_xrays()
    assert [len(ones) for ones in case_in(tmp_path / "cases" / "demo")["annotations"].values()] == [2, 2]
    tab.page.wait_for_function("!document.querySelector('.next button').disabled")  # ready to solve


class Fingers:
    """Fingers on the screen."""

    def __init__(self, tab) -> None:
        self.session = tab.page.context.new_cdp_session(tab.page)

    def touch(self, kind: str, *points) -> None:
        listed = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        self.session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": listed})


def test_fingers_pan_zoom_and_mark(workspace, serve, open_tab):
    folder = workspace / "demo"
    tab = open_tab(serve(folder).address)
    tab.go("Mark")
    tab.see_xrays()
    tab.page.wait_for_function("window.screwposeViewers.AP.state.editable")
    fingers, zoom = Fingers(tab), tab.page.evaluate(ZOOM)
    here = (160.0, 30.0)
    x, y = tab.place_of("AP", here)
    fingers.touch("touchStart", (x, y))
    for far in (10, 20, 40):
        fingers.touch("touchMove", (x + far, y + far / 2))
    fingers.touch("touchEnd")
    settled(tab)
    np.testing.assert_allclose(tab.place_of("AP", here), (x + 40, y + 20), atol=0.01)
    assert tab.page.evaluate(ZOOM) == zoom
    x, y = tab.place_of("AP", here)
    fingers.touch("touchStart", (x - 20, y), (x + 20, y))
    for apart in (30, 40):  # and both go down together
        fingers.touch("touchMove", (x - apart, y + apart - 20), (x + apart, y + apart - 20))
    fingers.touch("touchEnd")
    settled(tab)
    np.testing.assert_allclose(tab.page.evaluate(ZOOM), 2 * zoom, rtol=0.02)
    np.testing.assert_allclose(tab.place_of("AP", here), (x, y + 20), atol=1.5)
    assert not tab.page.evaluate("window.screwposeViewers.AP.state.begun")  # to move and to zoom marks nothing
    fingers.touch("touchStart", tab.place_of("AP", here))
    fingers.touch("touchEnd")
    tab.text("now click the centre").wait_for()
    np.testing.assert_allclose(tab.page.evaluate("window.screwposeViewers.AP.state.begun.tip"), here, atol=0.6)


def test_the_loupe_shows_what_is_under_the_cursor_six_times_as_large(workspace, serve, open_tab):
    tab = open_tab(serve(workspace / "demo").address)
    tab.go("Mark")
    tab.see_xrays()
    tab.page.mouse.move(*tab.place_of("LAT", (160.0, 160.0)))
    settled(tab)
    before, _ = seen(tab)
    box = tab.canvas("AP").bounding_box()
    # A place where much is to be seen, and no mark, which is no larger in the loupe.
    marked = [one[key] for one in case_in(workspace / "demo")["annotations"]["AP"] for key in ("tip", "center")]
    pixels = read_case(workspace / "demo").views["AP"].radiograph.pixels
    places = [(u, v) for u in range(60, 261, 10) for v in range(60, 151, 10)]
    free = [p for p in places if min(np.hypot(*np.subtract(p, mark)) for mark in marked) > 45]
    point = max(free, key=lambda p: np.std(pixels[p[1] - 10 : p[1] + 11, p[0] - 10 : p[0] + 11]))
    x, y = (round(one) for one in tab.place_of("AP", point))
    tab.page.mouse.move(x, y)
    settled(tab)
    after, _ = seen(tab)
    changed = np.abs(after - before).max(axis=2) > 2
    x, y = x - round(box["x"]), y - round(box["y"])
    on_the_right = x < changed.shape[1] / 2  # it is where the hand is not
    corner = np.s_[-200:-10, -200:-10] if on_the_right else np.s_[-200:-10, 10:200]
    assert changed[corner].mean() > 0.9
    # The middle of the loupe is the place under the cursor, 31 pixels of the screen as 186.
    near = before[y - 15 : y + 16, x - 15 : x + 16].mean(axis=2)
    large = after[corner][2:188, 2:188].mean(axis=2).reshape(31, 6, 31, 6).mean(axis=(1, 3))
    assert np.corrcoef(near.ravel(), large.ravel())[0, 1] > 0.8
    tab.page.mouse.move(box["x"] + 40, box["y"] + 60)
    settled(tab)
    elsewhere, _ = seen(tab)
    assert np.abs(elsewhere - after)[corner].max() > 30
    tab.page.mouse.click(*tab.place_of("LAT", (5.0, 5.0)), button="right")
    tab.canvas("AP").focus()
    tab.page.keyboard.press("o")
    tab.page.mouse.move(box["x"] + x, box["y"] + y)
    settled(tab)
    without, _ = seen(tab)
    assert (np.abs(without - before)[corner] > 2).mean() < 0.05


def test_overlays_by_keys_alone(reviewed):
    tab = reviewed
    press = tab.page.keyboard.press
    tab.button("Solve & review").wait_for()
    tab.page.wait_for_timeout(500)

    def tab_to(found: str) -> None:
        for _ in range(60):
            if tab.page.evaluate(f"(() => {{ const one = document.activeElement; return {found}; }})()"):
                return
            press("Tab")
        raise AssertionError(f"{found} was not reached by the Tab key")

    def state(key: str, value: str) -> None:
        tab.page.wait_for_function(f"window.screwposeViewers.AP.state.layers.{key} {value}")

    tab_to("one.innerText?.trim() === 'Solve & review'")
    press("Enter")
    tab.solved()
    tab.see_xrays()
    tab.page.wait_for_function("window.screwposeViewers.AP.state.outlines.length === 2")
    plain = colourful(seen_once(tab, lambda p: colourful(p) > 200))
    tab_to("one.closest('.layers')")
    press("Enter")
    tab.page.get_by_role("checkbox", name="Blink", exact=True).wait_for()
    for name, key in (("Outline", "outline"), ("Sigma", "ellipses")):
        tab_to(f"one.getAttribute('aria-label') === '{name}' || one.innerText?.trim() === '{name}'")
        press("Space")
        state(key, "=== false")
    tab_to("one.closest('.q-slider')")
    for _ in range(6):
        press("ArrowLeft")
    state("opacity", "< 0.01")
    bare = colourful(seen_once(tab, lambda p: colourful(p) < 0.05 * plain))
    for _ in range(20):
        press("ArrowRight")
    state("opacity", "> 0.99")
    seen_once(tab, lambda p: colourful(p) > 0.8 * plain)
    tab.page.evaluate("document.activeElement.blur()")
    tab_to("one.innerText?.trim() === 'Blink' || one.getAttribute('aria-label') === 'Blink'")
    press("Space")
    state("blink", "=== true")
    for shown in ("false", "true", "false"):  # there, and gone, and there again, all by itself
        tab.page.wait_for_function(f"window.screwposeViewers.AP.blink === {shown}")
    # A picture takes about as long as a blink does: held, so that not always the same half of it is seen.
    tab.page.evaluate("clearInterval(window.screwposeViewers.AP.blinker)")
    hold = "(shown) => { window.screwposeViewers.AP.blink = shown; window.screwposeViewers.AP.ask(); }"
    tab.page.evaluate(hold, False)
    seen_once(tab, lambda p: colourful(p) <= bare + 50)
    tab.page.evaluate(hold, True)
    seen_once(tab, lambda p: colourful(p) > 0.8 * plain)
    press("Space")
    state("blink", "=== false")
    tab_to("one.innerText?.trim() === 'Difference' || one.getAttribute('aria-label') === 'Difference'")
    press("Space")
    state("difference", "=== true")
    seen_once(tab, lambda p: bare < colourful(p) < 0.5 * plain)


def test_a_click_on_a_screw_in_space_chooses_it_everywhere(reviewed):
    tab = reviewed
    tab.button("Solve & review").wait_for()
    tab.page.wait_for_timeout(500)
    tab.go("3D")
    tab.page.locator(".scene canvas").wait_for()
    box = tab.page.locator(".scene").bounding_box()
    # The place of each screw's middle on the screen, from the camera that draws it.
    middles = """() => {
      const scene = getElement(document.querySelector('.scene').id.slice(1)), found = {};
      for (const { mesh } of scene.objects.values()) {
        if (!mesh.name?.startsWith('screw:')) continue;
        mesh.traverse((one) => {
          if (!one.geometry) return;
          one.geometry.computeBoundingBox();
          const at = one.geometry.boundingBox.min.clone().add(one.geometry.boundingBox.max).multiplyScalar(0.5);
          one.localToWorld(at).project(scene.camera);
          found[mesh.name.slice(6)] = [(at.x + 1) / 2, (1 - at.y) / 2];
        });
      }
      return found;
    }"""
    tab.page.wait_for_function(f"Object.keys(({middles})()).length === 2")
    tab.page.wait_for_timeout(1000)
    found = tab.page.evaluate(middles)
    for name, (x, y) in found.items():
        tab.page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        tab.page.locator(".screw.on", has_text=name).wait_for(timeout=20_000)
    chosen = list(found)[-1]
    assert tab.page.locator(".screw[aria-pressed=true]").count() == 1
    tab.go("Solve & review")
    tab.solved()
    tab.page.wait_for_function(
        "(name) => ['AP', 'LAT'].every((view) => window.screwposeViewers[view]?.state.selected === name)", arg=chosen
    )
    assert chosen in tab.page.locator(".screw.on").inner_text()
