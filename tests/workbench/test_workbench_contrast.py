"""What is read can be read: measured contrasts on every page, in both themes, and a focus that is seen."""

import pytest

from tests.workbench.driving import case_in

# Every element with words of its own, with the ratio of WCAG 2 between them and what lies behind: the backgrounds above
# it in the tree, laid over each other as far as the first opaque one. Opacity counts; what is disabled does not.
MEASURED = """() => {
  const canvas = document.createElement("canvas"); canvas.width = canvas.height = 1;
  const pen = canvas.getContext("2d", { willReadFrequently: true });
  const parsed = (text) => {
    pen.clearRect(0, 0, 1, 1); pen.fillStyle = text; pen.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = pen.getImageData(0, 0, 1, 1).data;
    return { rgb: [r, g, b], a: a / 255 };
  };
  const over = (top, a, below) => top.map((x, k) => a * x + (1 - a) * below[k]);
  const light = (rgb) => rgb.map((x) => x / 255).map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4))
    .reduce((sum, x, k) => sum + [0.2126, 0.7152, 0.0722][k] * x, 0);
  const behind = (element) => {
    const layers = [];
    for (let one = element; one; one = one.parentElement) {
      const own = parsed(getComputedStyle(one).backgroundColor);
      layers.push(own);
      if (own.a === 1) break;
    }
    return layers.reverse().reduce((below, { rgb, a }) => over(rgb, a, below), [255, 255, 255]);
  };
  const found = [];
  for (const element of document.querySelectorAll("body *")) {
    const own = [...element.childNodes].filter((one) => one.nodeType === 3).map((one) => one.data.trim());
    const words = own.join(" ").trim() || (element.matches("input, textarea") ? element.value : "");
    const style = getComputedStyle(element), box = element.getBoundingClientRect();
    const seen = element.checkVisibility({ opacityProperty: true, visibilityProperty: true }) && box.width > 1;
    if (!words || !seen) continue;
    if (element.closest(":disabled, [aria-disabled=true], .disabled, .xray, .scene, script, style, .q-icon")) continue;
    let opacity = 1;
    for (let one = element; one; one = one.parentElement) opacity *= Number(getComputedStyle(one).opacity);
    const back = behind(element), { rgb, a } = parsed(style.color), front = over(rgb, a * opacity, back);
    const [low, high] = [light(front), light(back)].sort((x, y) => x - y), ratio = (high + 0.05) / (low + 0.05);
    const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
    found.push({ words: words.slice(0, 40), ratio, wanted: large ? 3 : 4.5, size });
  }
  return found;
}"""
OUTLINE = """() => {
  const one = document.activeElement;
  window.reached ??= new Set();
  if (one === document.body || window.reached.has(one)) return null;
  window.reached.add(one);
  const style = getComputedStyle(one);
  const what = one.getAttribute("aria-label") || one.innerText || one.outerHTML.slice(0, 200);
  return { what, wide: style.outlineStyle === "none" ? 0 : parseFloat(style.outlineWidth) };
}"""


def unread(tab, at_least: int) -> list[str]:
    """The words whose contrast is too small; there must be so many of them all in all."""
    # A Quasar's transition shows a colour between two for a third of a second.
    tab.page.evaluate("() => Promise.all(document.getAnimations().map((one) => one.finished.catch(() => null)))")
    found = tab.page.evaluate(MEASURED)
    assert len(found) >= at_least, found
    assert min(one["size"] for one in found) >= 10.5  # px, at 1280 x 720
    return [f"{one['words']}: {one['ratio']:.2f}" for one in found if one["ratio"] < one["wanted"]]


def test_the_measure_sees_what_cannot_be_read(workspace, serve, open_tab):
    tab = open_tab(serve(workspace).address)
    tab.text("Recent cases").wait_for()
    assert unread(tab, 8) == []
    tab.page.evaluate("document.querySelector('.case-name').style.color = '#555'")
    (one,) = unread(tab, 8)
    assert one.startswith("demo: 2.")
    tab.page.evaluate("document.querySelector('.case-name').style = 'color: white; opacity: 0.3'")
    assert unread(tab, 8)[0].startswith("demo: ")


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_all_words_of_all_pages_can_be_read(workspace, serve, open_tab, theme):
    server = serve(workspace)
    tab = open_tab(server.base)
    tab.page.context.add_cookies([{"name": "screwpose-theme", "value": theme, "url": server.base}])
    tab.page.reload()
    tab.text("Recent cases").wait_for()
    assert tab.page.evaluate("document.body.classList.contains('body--dark')") == (theme == "dark")
    assert unread(tab, 8) == []
    tab.page.goto(f"{server.base}/case/demo")
    tab.text("Calibrated").wait_for()
    assert unread(tab, 20) == []
    tab.go("Mark")
    tab.see_xrays()
    tab.text("Suggested pairs").wait_for()
    tab.page.locator(".mark").first.click()
    assert unread(tab, 20) == []
    tab.go("Solve & review")
    tab.button("Solve").click()
    tab.solved()
    tab.page.locator(".screw").first.click()
    tab.page.locator(".screw.on").wait_for()
    tab.page.get_by_text("Overlay", exact=True).click()
    tab.page.get_by_text("Before registration").wait_for()
    tab.page.wait_for_timeout(500)  # the expansion has no end that a page can wait for
    assert unread(tab, 40) == []
    tab.go("3D")
    tab.page.locator(".screw").first.wait_for()
    assert unread(tab, 10) == []
    tab.go("Export")
    tab.text("Get result.json").wait_for()
    assert unread(tab, 10) == []
    tab.page.keyboard.press("?")
    tab.text("the screw before, the next one").wait_for()
    tab.page.wait_for_timeout(500)
    assert unread(tab, 40) == []


# The words of fields that stick out of their field.
OUTSIDE = """() => {
const words = ".q-field__native span, .q-field input, .q-field__label";
return [...document.querySelectorAll(words)].filter((one) => {
  const words = one.getBoundingClientRect(), field = one.closest(".q-field__control").getBoundingClientRect();
  return words.height && (words.top < field.top - 2 || words.bottom > field.bottom + 2);
}).map((one) => one.innerText || one.value); }"""


@pytest.mark.parametrize(("size", "smallest_px"), [((1280, 720), 10.5), ((3840, 2160), 19.0)])
def test_words_grow_with_the_screen_and_stay_in_their_fields(workspace, serve, open_tab, size, smallest_px):
    tab = open_tab(serve(workspace / "demo").address)
    tab.page.set_viewport_size({"width": size[0], "height": size[1]})
    tab.page.wait_for_function("document.querySelectorAll('.preview').length === 2")
    for stage in ("Images", "Mark"):
        tab.go(stage)
        tab.page.wait_for_timeout(500)
        found = tab.page.evaluate(MEASURED)
        assert len(found) > 20
        # Labels of fields are shown at three quarters, which a transformation does.
        assert min(one["size"] for one in found) >= smallest_px
        assert tab.page.evaluate("document.querySelectorAll('.q-field').length") > 3
        assert tab.page.evaluate(OUTSIDE) == []
        over = "document.documentElement.scrollWidth > document.documentElement.clientWidth"
        assert not tab.page.evaluate(over)


def focused(tab, least: int) -> list[str]:
    """What the Tab key reaches that shows no outline."""
    count, bare = 0, []
    tab.page.evaluate("() => { document.activeElement.blur(); window.reached = undefined; }")
    for _ in range(120):
        tab.page.keyboard.press("Tab")
        one = tab.page.evaluate(OUTLINE)
        if one is None:
            break
        count += 1
        if one["wide"] < 2:
            bare.append(one["what"])
    assert count >= least
    return bare


def test_the_focus_is_seen_wherever_it_is(workspace, serve, open_tab):
    server = serve(workspace)
    tab = open_tab(server.base)
    tab.text("Recent cases").wait_for()
    assert focused(tab, 4) == []
    tab.page.goto(f"{server.base}/case/demo")
    tab.page.wait_for_function("document.querySelectorAll('.preview').length === 2")  # it is made anew with them
    assert focused(tab, 12) == []
    tab.go("Mark")
    tab.see_xrays()
    tab.text("Suggested pairs").wait_for()
    assert focused(tab, 15) == []
    assert len(case_in(workspace / "demo")["annotations"]["AP"]) == 2  # to go round changes nothing
