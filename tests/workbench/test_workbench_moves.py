"""A screw is moved by hand only where it is seen: the panel of the review without a browser, and in one."""

import asyncio
import json
from types import SimpleNamespace

import pytest

from screwpose.workbench.panel_review import ReviewPanel
from screwpose.workbench.tasks import TASKS
from tests.workbench.driving import awaited, case_in, side_of

NAMES = ("AP 1 / LAT a", "AP 2 / LAT b")


class Session:
    """A session that keeps what it is asked."""

    def __init__(self):
        self.reviewed = {"chosen": 1, "can_move": True, "screws": [{"name": name} for name in NAMES]}
        self.live, self.poses_now, self.moved, self.saved = None, ["first", "second"], [], 0

    async def ask(self, task, **asked):
        assert task == "nudge"
        await asyncio.sleep(0.01)
        self.moved.append((asked["index"], asked["move"]))
        return {"poses": asked["poses"], "dice": 0.9, "loss": -0.5, "views": {}}

    def put_by_hand(self, _poses):
        self.saved += 1


@pytest.fixture
def panel():
    session = Session()
    page = SimpleNamespace(session=session, screw=0, may_edit=True, viewers={})
    made = ReviewPanel(page)
    made.refresh, made._live = (lambda: None), SimpleNamespace(set_text=lambda _words: None)
    return made


def nudged(panel, name, u=1.0):
    return panel._nudged("AP", SimpleNamespace(args={"name": name, "u": u, "v": 0.0, "done": True}))


def turned(panel, name):
    return panel._turned("AP", SimpleNamespace(args={"name": name, "key": "r", "back": False}))


def test_what_is_dragged_or_turned_in_the_answer_is_moved_and_saved(panel):
    session = panel._page.session
    awaited(nudged(panel, NAMES[1]))
    awaited(turned(panel, NAMES[0]))
    assert session.moved == [(1, {"u": 1.0, "v": 0.0}), (0, {"roll": 1.0})]
    assert session.saved == 2


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("another combination", NAMES[0]),
        ("before registration", NAMES[0]),
        ("the answer", "AP 1 / LAT b"),
        ("the answer", None),
        ("an answer whose marks are gone", NAMES[0]),
        ("another tab's", NAMES[0]),
    ],
)
def test_what_is_not_seen_of_the_answer_is_not_moved(panel, what, name):
    page = panel._page
    if what == "another combination":
        panel._shown = 2
    page.session.reviewed["can_move"] = what != "an answer whose marks are gone"
    page.may_edit = what != "another tab's"
    panel._before = what == "before registration"
    awaited(nudged(panel, name))
    awaited(turned(panel, name))
    assert not page.session.moved
    assert not page.session.saved


def test_a_move_is_of_the_screw_that_was_chosen_when_it_was_asked_for(panel):
    async def together():
        first = asyncio.create_task(turned(panel, NAMES[0]))
        await asyncio.sleep(0.001)
        second = asyncio.create_task(turned(panel, NAMES[1]))
        await asyncio.sleep(0.001)
        panel._page.screw = 0
        await asyncio.gather(first, second)

    awaited(together())
    assert [index for index, _ in panel._page.session.moved] == [0, 1]


def test_another_combination_stands_still_and_an_old_result_is_neither_chosen_nor_refined(
    workspace, simulated, tmp_path, serve, open_tab
):
    folder = workspace / "demo"
    TASKS["solve"](lambda _fraction, _what: None, str(folder), None, [], None)
    server = serve(folder)
    tab = open_tab(server.address)
    tab.go("Solve & review")
    tab.solved()
    tab.see_xrays()
    tab.page.locator(".screw").first.click()
    movable = "window.screwposeViewers?.AP?.state.selected && window.screwposeViewers.AP.state.movable === {}"
    tab.page.wait_for_function(movable.format("true"))
    tab.page.get_by_label("Show combination 2").click()
    tab.page.wait_for_function(movable.format("false"))
    place = tab.page.evaluate("window.screwposeViewers.AP.place.u")
    tab.canvas("AP").focus()
    for key in ("r", "ArrowRight"):
        tab.page.keyboard.press(key)
    assert tab.page.evaluate("window.screwposeViewers.AP.place.u") != place  # the image moves instead
    tab.page.get_by_label("Show combination 1").click()
    tab.page.wait_for_function(movable.format("true"))
    assert not side_of(folder).get("by_hand")
    tab.canvas("AP").focus()
    tab.page.keyboard.press("r")
    tab.page.wait_for_function("!document.querySelector('.hand button').disabled")
    assert side_of(folder)["by_hand"]
    server.stop()
    tab.page.close()
    # Since then a mark has another name.
    side, case = side_of(folder), case_in(folder)
    case["annotations"]["AP"][0]["label"] = "new"
    (folder / "case.json").write_text(json.dumps(case))
    (folder / "workbench.json").write_text(json.dumps({**side, "solved_from": "another", "stage": "review"}))
    tab = open_tab(serve(folder).address)
    tab.solved()
    tab.text("To choose another one: solve again first").wait_for()
    assert tab.page.get_by_role("button", name="Choose", exact=True).first.is_disabled()
    tab.page.locator(".screw").first.click()
    tab.text("To refine: solve again first").wait_for()
    assert tab.button("Refine from here").is_disabled()
    tab.page.wait_for_function(movable.format("false"))
    assert not tab.page.locator(".problem").first.is_visible()
