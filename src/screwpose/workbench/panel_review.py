"""Solve and review: the job, the combinations, the screws, and what lies over the X-rays."""

from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import events, ui

from screwpose.workbench.panel_combinations import SOLVE_FIRST, CombinationTable
from screwpose.workbench.panel_job import JobCard
from screwpose.workbench.panel_mark import window_controls
from screwpose.workbench.screw_buttons import screw_buttons
from screwpose.workbench.slider import Slider

if TYPE_CHECKING:
    from screwpose.workbench.page_case import CasePage

_STATUS_ICONS = {
    "ok": "check_circle",
    "check": "help",
    "failed": "cancel",
    "confident": "check_circle",
    "ambiguous": "help",
    "refused": "cancel",
}
# What a key does to the chosen screw: `reviewing.nudge`'s move.
_TURNS = {"r": ("roll", 1.0), "t": ("tilt", 0.2), "a": ("along", 0.1), "d": ("away", 0.1)}
_TIMES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_ELLIPSE_PX = 14.0  # about how large an ellipse is drawn: an error of a hundredth of a mm is no pixel wide


class ReviewPanel:
    """The third stage."""

    def __init__(self, page: "CasePage") -> None:
        self._page = page
        self._shown: int | None = None
        self._before = False
        self._layers: dict[str, Any] = {
            "opacity": 0.3,
            "outline": True,
            "blink": False,
            "difference": False,
            "marks": False,
            "ellipses": True,
            "mask": False,
        }
        self._start: list[Any] | None = None
        self._waiting: list[dict[str, Any]] = []
        self._busy = False
        self._job = JobCard(page)
        self._table = CombinationTable(page, self._show)

    # ---- the page
    def build(self) -> None:
        """Make its elements."""
        for view, viewer in self._page.viewers.items():
            viewer.set(mode="pose", pairs=[], begun=None, selected=None, layers=dict(self._layers))
            viewer.on("picked", self._picked)
            viewer.on("nudged", partial(self._nudged, view))
            viewer.on("turned", partial(self._turned, view))
            viewer.on("stepped", self._stepped)
        self._job.build()
        self._answer = ui.element("div").classes("answer")
        with ui.expansion("Overlay", icon="layers", value=False).classes("wide layers").props("dense"):
            with ui.row().classes("tools"):
                for key, words in (
                    ("outline", "Outline"),
                    ("blink", "Blink"),
                    ("difference", "Difference"),
                    ("marks", "Marks"),
                    ("ellipses", "Sigma"),
                    ("mask", "Mask"),
                ):
                    ui.checkbox(words, value=self._layers[key], on_change=partial(self._layer, key)).props("dense")
                ui.checkbox("Before registration", value=self._before, on_change=self._stage).props("dense")
            with ui.row().classes("tools nowrap"):
                ui.label("Opacity").classes("small")
                Slider(
                    min=0, max=1, step=0.05, value=self._layers["opacity"], on_change=partial(self._layer, "opacity")
                ).props('aria-label="Opacity of the overlay"')
            window_controls(self._page)
        self._screws = ui.element("div").classes("screws")
        self._build_hand()
        self._table.build()
        self._more = ui.element("div").classes("more")
        self._timer = ui.timer(0.25, self._tick)
        self._seen: Any = None

    def refresh(self) -> None:
        """Show the result as it is now."""
        self._job.refresh()
        data = self._page.session.reviewed
        stamp = (
            id(data),
            self._page.may_edit,
            self._page.session.is_stale,
            self._page.screw,
            self._shown,
            self._page.session.store.side.choice,
        )
        if data is not None and stamp != self._seen:
            if self._seen is None or self._seen[0] != stamp[0]:
                self._shown = None
            self._seen = stamp
            self._show_answer(data)
            self._show_screws(data)
            self._table.refresh(data, self._shown or data["chosen"])
        self._show_hand()
        self._overlay()

    def _tick(self) -> None:
        if self._page.session.job is not None:
            self._job.refresh()

    # ---- the answer
    def _show_answer(self, data: dict[str, Any]) -> None:
        choice = self._page.session.store.side.choice
        self._answer.clear()
        with self._answer, ui.element("section").classes(f"card status {data['status']}"):
            with ui.row().classes("card-head"):
                ui.icon(_STATUS_ICONS[data["status"]])
                ui.label(data["status"].capitalize()).classes("heading grow")
                if data["probability"] is not None:
                    ui.label(f"pairing {data['probability']}").classes("small")
            ui.label(data["meaning"]).classes("small")
            if choice is not None:
                ui.label(f"The pairing is yours, not the solver's ({choice.when}): {choice.reason}").classes(
                    "small strong"
                )
            for warning in data["warnings"]:
                ui.label(warning[:1].upper() + warning[1:]).classes("warning small")

    def _show_screws(self, data: dict[str, Any]) -> None:
        self._screws.clear()
        with self._screws:
            if data["screws"]:
                ui.label("Screws").classes("group")
            screw_buttons(self._page, data["screws"], self._screw_status, self._screw_error)

    def _screw_status(self, screw: dict[str, Any]) -> None:
        ui.icon(_STATUS_ICONS[screw["status"]]).classes(screw["status"])
        ui.label(screw["words"]).classes("small")

    def _screw_error(self, screw: dict[str, Any]) -> None:
        ui.label(f"Expected error: {screw['sigma'] or 'not estimated'}").classes("muted small")
        for doubt in screw["doubts"]:
            ui.label(doubt.split(": ", 1)[-1].capitalize()).classes("warning small")

    def _build_hand(self) -> None:
        """What can be done by hand with the chosen screw."""
        with ui.element("div").classes("hand") as self._hand:
            ui.label("Drag the screw in a view, or use the keys (press ?).").classes("muted small")
            self._stale = ui.label(f"To refine: {SOLVE_FIRST}").classes("warning small")
            self._live = ui.label().classes("live").props('role="status"')
            with ui.row().classes("actions"):
                self._refine_button = ui.button("Refine from here", on_click=self._refine).props("no-caps dense")
                self._reset_button = ui.button("Back to the result", on_click=self._reset).props("flat no-caps dense")

    def _show_hand(self) -> None:
        page = self._page
        self._hand.set_visibility(page.screw is not None and page.may_edit and page.session.reviewed is not None)
        self._live.set_text(self._live_words())
        is_moved, is_stale = bool(page.session.store.side.by_hand), page.session.is_stale
        self._stale.set_visibility(is_stale)
        self._refine_button.set_enabled(is_moved and not is_stale)
        self._reset_button.set_enabled(is_moved)

    def _live_words(self) -> str:
        live = self._page.session.live
        if live is None:
            return ""
        views = ", ".join(f"{name} {one['dice']:.3f} / {one['loss']:.3f}" for name, one in live["views"].items())
        return f"By hand: Dice {live['dice']:.3f}, loss {live['loss']:.3f} ({views})"

    def _show(self, number: int) -> None:
        self._shown = number
        self.refresh()

    def _picked(self, event: events.GenericEventArguments) -> None:
        data = self._page.session.reviewed or {"screws": []}
        names = [one["name"] for one in data["screws"]]
        if event.args["name"] in names:
            self._page.screw = names.index(event.args["name"])
            self.refresh()

    def _stepped(self, event: events.GenericEventArguments) -> None:
        count = len((self._page.session.reviewed or {"screws": []})["screws"])
        if count:
            now = -1 if self._page.screw is None else self._page.screw
            self._page.screw = (now + int(event.args["by"])) % count
            self.refresh()

    # ---- what lies over the X-rays
    @property
    def _shows_answer(self) -> bool:
        """Whether it is the answer, registered, and not another combination or where it began."""
        data = self._page.session.reviewed
        return data is not None and not self._before and self._shown in (None, data["chosen"])

    @property
    def _may_move(self) -> bool:
        """Whether a hand may move screws: nobody moves what is not seen."""
        data = self._page.session.reviewed
        return self._page.may_edit and self._shows_answer and data is not None and bool(data["can_move"])

    def _overlay(self) -> None:
        session, page = self._page.session, self._page
        data = session.reviewed
        if data is None:
            return
        number = self._shown or data["chosen"]
        is_answer = self._shows_answer
        name = None if page.screw is None or page.screw >= len(data["screws"]) else data["screws"][page.screw]["name"]
        for view, viewer in page.viewers.items():
            shadows = data["shadows"].get(
                f"{number}-{'pre' if self._before else 'post'}-{view}", data["shadows"].get(f"{number}-pre-{view}", [])
            )
            if is_answer and session.live is not None:
                shadows = session.live["shadows"].get(view, [])
            ellipses = [] if not is_answer or session.live else _ellipses(data["screws"], view, shadows)
            marked = session.store.draft["annotations"].get(view, [])
            viewer.set(
                outlines=[{key: one[key] for key in ("name", "color", "dash", "paths")} for one in shadows],
                metal=data["metal"].get(view, []),
                ellipses=ellipses,
                marks=[{**{k: one[k] for k in ("label", "tip", "center")}, "color": "#ffffff"} for one in marked],
                selected=name,
                movable=self._may_move,
                layers=dict(self._layers),
            )

    def _layer(self, key: str, event: events.ValueChangeEventArguments[Any]) -> None:
        self._layers[key] = event.value
        self._overlay()

    def _stage(self, event: events.ValueChangeEventArguments[Any]) -> None:
        self._before = bool(event.value)
        self._overlay()

    # ---- by hand
    async def _nudged(self, view: str, event: events.GenericEventArguments) -> None:
        self._picked(event)
        move = {"u": float(event.args["u"]), "v": float(event.args["v"])}
        await self._move(event.args["name"], view, move, bool(event.args["done"]))

    async def _turned(self, view: str, event: events.GenericEventArguments) -> None:
        key, step = _TURNS[str(event.args["key"])]
        await self._move(event.args["name"], view, {key: -step if event.args["back"] else step}, True)

    async def _move(self, name: str | None, view: str, move: dict[str, float], done: bool) -> None:
        """Move a screw. A drag is told from where it began, so that of its moves only the last one counts."""
        names = [one["name"] for one in (self._page.session.reviewed or {"screws": []})["screws"]]
        if name not in names or not self._may_move:
            return
        if self._waiting and not self._waiting[-1]["done"]:
            self._waiting.pop()
        self._waiting.append({"index": names.index(name), "view": view, "move": move, "done": done})
        if self._busy:
            return
        self._busy = True
        try:
            while self._waiting:
                await self._moved(self._waiting.pop(0))
        finally:
            self._busy = False

    async def _moved(self, asked: dict[str, Any]) -> None:
        session, done = self._page.session, asked.pop("done")
        self._start = self._start or session.poses_now
        moved = await session.ask("nudge", poses=self._start, **asked)
        if done:
            self._start = None
        if moved is None:
            return
        session.live = moved
        if done and not self._waiting:
            session.put_by_hand(moved["poses"])  # which has every tab refreshed
        else:
            self._live.set_text(self._live_words())
            self._overlay()

    def _refine(self) -> None:
        self._page.session.refine_from_here()

    def _reset(self) -> None:
        self._page.session.live = None
        self._page.session.change_side(by_hand=())


def _ellipses(screws: list[dict[str, Any]], view: str, shadows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The tips' ellipses where their models' tips are seen, all enlarged alike until the largest can be seen."""
    tips = {one["name"]: one["tip"] for one in shadows}
    seen = [one for one in screws if view in one["ellipses"] and tips.get(one["name"]) is not None]
    largest = max((abs(x) for one in seen for x in one["ellipses"][view]), default=1.0)
    times = next((n for n in _TIMES if n * largest >= _ELLIPSE_PX), _TIMES[-1])
    return [
        {"path": one["ellipses"][view], "at": tips[one["name"]], "times": times, "color": one["color"]} for one in seen
    ]
