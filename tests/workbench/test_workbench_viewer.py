"""The X-rays on the screen: what is seen, and what wheel, hand, finger and keys do to it."""

import json
import time

import imagecodecs
import numpy as np

from screwpose.files.case import read_case
from screwpose.images import read_mask
from tests.workbench.driving import case_in

ZOOM = "window.screwposeViewers.AP.place.zoom"


def seen(tab, view="AP"):
    """The pixels of a view on the screen, RGB, 0 to 255, and a function from image points to them."""
    box = tab.canvas(view).bounding_box()
    picture = imagecodecs.png_decode(tab.page.screenshot(clip=box))[..., :3].astype(float)

    def at(point, reach=3):
        x, y = tab.place_of(view, point)
        column, row = round(x - box["x"]), round(y - box["y"])
        return picture[row - reach : row + reach + 1, column - reach : column + reach + 1].mean()

    return picture, at


def seen_once(tab, holds, view="AP"):
    """The pixels as soon as they are such; it fails after a minute. On a loaded machine what was drawn reaches the
    screen frames later."""
    end = time.monotonic() + 60.0
    while True:
        settled(tab)
        picture, _ = seen(tab, view)
        if holds(picture):
            return picture
        assert time.monotonic() < end, f"the screen never showed it, but {colourful(picture)} coloured pixels"


def colourful(picture):
    """How many pixels are not grey."""
    return int((np.ptp(picture, axis=2) > 40).sum())


def settled(tab):
    """Two frames later."""
    tab.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def test_it_shows_the_pixels_windowed_inverted_and_near(workspace, serve, open_tab):
    tab = open_tab(serve(workspace / "demo").address)
    tab.go("Mark")
    tab.see_xrays()
    press = tab.page.keyboard.press
    pixels = 1.0 - read_case(workspace / "demo").views["AP"].radiograph.pixels
    rng = np.random.default_rng(4)
    marked = [one[key] for one in case_in(workspace / "demo")["annotations"]["AP"] for key in ("tip", "center")]
    points = [
        p for p in rng.integers(20, 300, (60, 2)).tolist() if min(np.hypot(*np.subtract(p, m)) for m in marked) > 40
    ]

    def compared():
        settled(tab)
        _, at = seen(tab)
        around = [pixels[v - 2 : v + 3, u - 2 : u + 3].mean() for u, v in points]
        return np.corrcoef([at(p) for p in points], around)[0, 1]

    tab.canvas("AP").focus()
    press("o")  # no loupe in the way
    press("2")  # the full range: grey is proportional to the pixels
    assert compared() > 0.98
    press("i")
    assert compared() < -0.98
    press("i")
    _, at = seen(tab)
    before = np.array([at(p) for p in points])
    x, y = tab.place_of("AP", (160, 20))
    tab.page.mouse.move(x, y)
    tab.page.mouse.down(button="right")
    tab.page.mouse.move(x, y - 80, steps=3)
    tab.page.mouse.up(button="right")
    settled(tab)
    _, at = seen(tab)
    assert np.mean([at(p) for p in points] - before) > 10  # a lower level is brighter
    press("1")
    # The wheel keeps what is under the cursor where it is.
    x, y = (round(one) for one in tab.place_of("AP", (200.0, 100.0)))  # a wheel tells whole pixels of the screen
    here = tab.page.evaluate("([x, y]) => window.screwposeViewers.AP.toImage({ clientX: x, clientY: y })", [x, y])
    tab.page.mouse.move(x, y)
    zoom = tab.page.evaluate(ZOOM)
    for _ in range(6):
        tab.page.mouse.wheel(0, -120)
        settled(tab)
    assert tab.page.evaluate(ZOOM) > 2 * zoom
    np.testing.assert_allclose(tab.place_of("AP", here), (x, y), atol=0.01)
    tab.page.mouse.down()
    tab.page.mouse.move(x + 50, y + 30, steps=3)
    tab.page.mouse.up()
    np.testing.assert_allclose(tab.place_of("AP", here), (x + 50, y + 30), atol=0.01)
    assert case_in(workspace / "demo")["annotations"]["AP"][0]["tip"] == marked[0]  # moving the image marks nothing
    press("0")
    settled(tab)
    assert tab.page.evaluate(ZOOM) == zoom


def test_two_fingers_zoom(workspace, serve, open_tab):
    tab = open_tab(serve(workspace / "demo").address)
    tab.go("Mark")
    tab.see_xrays()
    x, y = tab.place_of("AP", (160.0, 160.0))
    zoom = tab.page.evaluate(ZOOM)
    fingers = tab.page.context.new_cdp_session(tab.page)

    def touch(kind, *points):
        listed = [{"x": one, "y": y, "id": number} for number, one in enumerate(points)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": listed})

    touch("touchStart", x - 20, x + 20)
    for apart in (25, 30, 40):
        touch("touchMove", x - apart, x + apart)
    touch("touchEnd")
    settled(tab)
    np.testing.assert_allclose(tab.page.evaluate(ZOOM), 2 * zoom, rtol=0.02)
    np.testing.assert_allclose(tab.place_of("AP", (160.0, 160.0)), (x, y), atol=1.5)
    assert case_in(workspace / "demo")["annotations"]["AP"] == case_in(workspace / "demo")["annotations"]["AP"][:2]


def test_the_epipolar_line_runs_through_the_other_views_mark(workspace, serve, open_tab):
    folder = workspace / "demo"
    tab = open_tab(serve(folder).address)
    tab.go("Mark")
    tab.see_xrays()
    tab.page.wait_for_function("Object.keys(window.screwposeViewers.LAT.state.epipolar).length")
    truth = json.loads((folder / "truth.json").read_text())["screws"][0]
    marks = {view: {one["label"]: one for one in case_in(folder)["annotations"][view]} for view in ("AP", "LAT")}
    ends = [marks[view][truth["labels"][view]]["center"] for view in ("AP", "LAT")]
    tab.canvas("LAT").focus()
    tab.page.keyboard.press("3")
    before, _ = seen(tab, "LAT")
    tab.page.mouse.move(*tab.place_of("AP", ends[0]))
    settled(tab)
    after, _ = seen(tab, "LAT")
    changed = np.abs(after - before).max(axis=2) > 40
    box = tab.canvas("LAT").bounding_box()
    x, y = (round(a - b) for a, b in zip(tab.place_of("LAT", ends[1]), (box["x"], box["y"]), strict=True))
    assert changed.any(axis=0).mean() > 0.8  # it runs across the view
    assert changed[y - 12 : y + 13, x - 12 : x + 13].any()
    assert not changed[: y - 150].any()


def test_what_does_not_count_is_painted(workspace, serve, open_tab):
    folder = workspace / "demo"
    tab = open_tab(serve(folder).address)
    tab.go("Mark")
    tab.see_xrays()
    tab.page.get_by_role("switch", name="Paint what does not count").click()
    tab.page.wait_for_function("window.screwposeViewers.AP.state.mode === 'paint'")
    tab.drag_point("AP", (60.0, 40.0), (120.0, 40.0))
    tab.page.wait_for_function("!document.querySelector('[aria-label^=\"Undo\"]').disabled")
    name = case_in(folder)["views"]["AP"]["mask"]
    mask = read_mask(folder / name, (320, 320))
    assert not mask[40, 60:120].any()
    assert mask[160, 160]
    tab.page.wait_for_function("window.screwposeViewers.AP.state.outside.length >= 2")
    tab.page.keyboard.press("Control+z")
    tab.page.wait_for_function("document.querySelector('[aria-label^=\"Undo\"]').disabled")
    assert "mask" not in case_in(folder)["views"]["AP"]


def test_overlays_can_be_made_fainter_and_differ(workspace, serve, open_tab):
    tab = open_tab(serve(workspace / "demo").address)
    tab.go("Solve & review")
    tab.button("Solve").click()
    tab.solved()
    tab.see_xrays()
    tab.page.wait_for_function("window.screwposeViewers.AP.state.outlines.length === 2")
    plain = colourful(seen_once(tab, lambda p: 200 < colourful(p) < 0.3 * p[..., 0].size))
    tab.page.get_by_text("Overlay", exact=True).click()
    for words, key in (("Outline", "outline"), ("Sigma", "ellipses")):
        tab.page.get_by_role("checkbox", name=words, exact=True).click()
        tab.page.wait_for_function(f"window.screwposeViewers.AP.state.layers.{key} === false")
    slider = tab.page.get_by_role("slider").bounding_box()
    tab.page.mouse.click(slider["x"] + 1, slider["y"] + slider["height"] / 2)
    tab.page.wait_for_function("window.screwposeViewers.AP.state.layers.opacity < 0.01")
    bare = colourful(seen_once(tab, lambda p: colourful(p) < 0.05 * plain))
    tab.page.get_by_role("checkbox", name="Difference", exact=True).click()
    tab.page.wait_for_function("window.screwposeViewers.AP.state.layers.difference === true")
    # A registered model covers its metal: what differs is a rim, which nothing else here draws.
    seen_once(tab, lambda p: bare < colourful(p) < 0.5 * plain)


def test_a_case_file_with_wrong_values_is_shown_with_what_is_wrong(workspace, serve, open_tab):
    folder = workspace / "demo"
    given = case_in(folder)
    given["views"]["AP"]["polarity"] = "metal-drak"
    next(iter(given["models"].values()))["unit"] = "furlong"
    given["annotations"]["LAT"][0]["model"] = "no such model"
    given["views"]["third"] = 3
    (folder / "case.json").write_text(json.dumps(given))
    tab = open_tab(serve(folder).address)
    for words in ("metal-drak", "furlong"):
        tab.text(words).wait_for()
    tab.go("Mark")
    tab.see_xrays()
    tab.text("no such model").wait_for()
    assert tab.page.evaluate("document.querySelector('.next button').disabled")
    assert case_in(folder) == given
