"""Mark: tips and centres clicked in both X-rays; the pair that is suggested, projected back; the mask M_bg."""

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import events, ui

from screwpose.report.palette import Ink, ink_of
from screwpose.workbench import draft as drafts
from screwpose.workbench.side_file import Begun, BegunMark
from screwpose.workbench.slider import Slider
from screwpose.workbench.theme import icon_button, named, notes

if TYPE_CHECKING:
    from screwpose.workbench.page_case import CasePage

_LANDMARKS = ("tip", "center")


class MarkPanel:
    """The second stage."""

    def __init__(self, page: "CasePage") -> None:
        self._page = page
        self._painting = False
        self._stroke = asyncio.Lock()

    # ---- the page
    def build(self) -> None:
        """Make its elements."""
        self._painting = False
        page = self._page
        for view, viewer in page.viewers.items():
            viewer.set(mode="mark", layers={"marks": True, "mask": True}, outlines=[], ellipses=[], metal=[])
            for name, act in (
                ("placed", self._placed),
                ("moved", self._moved),
                ("selected", self._selected),
                ("removed", self._removed),
                ("entered", self._entered),
                ("stepped", self._stepped),
                ("escaped", self._escaped),
                ("painted", self._painted),
            ):
                viewer.on(name, partial(act, view))
        self._hint = ui.label().classes("hint").props('role="status" aria-live="polite"')
        window_controls(page)
        with ui.row().classes("tools"):
            self._paint = ui.switch("Paint what does not count", on_change=self._mode).props("dense")
            self._erase = ui.switch("Counts again", on_change=self._mode).props("dense")
        self._brush = Slider(min=4, max=120, value=24, on_change=self._mode).props('label aria-label="Brush, px"')
        self._list = ui.element("div").classes("lists")
        with ui.element("div").classes("next"):
            self._solve_button = ui.button("Solve", on_click=self._solve).props("no-caps").classes("wide")
            self._mend = ui.label().classes("muted small")
        self._shown: Any = None

    def refresh(self) -> None:
        """Show the case as it is now."""
        page, session = self._page, self._page.session
        pairs = session.known.get("pairs", [])
        for view, viewer in page.viewers.items():
            begun = session.store.side.begun.get(view)
            viewer.set(
                marks=[
                    {**{key: one[key] for key in ("label", *_LANDMARKS)}, "color": self._ink(view, one["label"]).color}
                    for one in drafts.marks_of(session.store.draft, view)
                ],
                begun=None if begun is None else {"label": begun.label, "tip": list(begun.tip)},
                pairs=[
                    {"points": pair["points"][view], "color": self._ink_of_pair(pair).color}
                    for pair in pairs
                    if view in pair["points"]
                ],
                epipolar={
                    other: of_view[view]
                    for other, of_view in session.known.get("epipolar", {}).items()
                    if view in of_view
                },
                selected=page.selected.get(view),
            )
        self._hint.set_text(self._what_next())
        self._brush.set_visibility(self._painting)
        self._erase.set_visibility(self._painting)
        self._paint.set_enabled(page.may_edit)
        self._show_lists(pairs)
        self._show_next()

    def _what_next(self) -> str:
        session = self._page.session
        if self._painting:
            return "Paint over what must not count: other metal, hands, the collimator's edge."
        begun = session.store.side.begun
        if begun:
            view, one = next(iter(begun.items()))
            return f"{view} {one.label}: now click the centre of its body."
        counts = [len(drafts.marks_of(session.store.draft, view)) for view in session.store.draft["views"]]
        if not any(counts):
            return (
                "Click the tip of a screw, then the centre of its body. "
                "Order and names need not agree between the views."
            )
        return (
            "Click the next tip, or drag a point to correct it. "
            "The other view shows the line on which the point must lie."
        )

    def _show_lists(self, pairs: list[dict[str, Any]]) -> None:
        session, page = self._page.session, self._page
        findings = session.known.get("findings", [])
        models = list(session.store.draft["models"])
        shown = (session.store.draft, session.known, dict(page.selected), page.may_edit)
        if shown == self._shown:
            return
        self._shown = shown
        self._list.clear()
        with self._list:
            for view in session.store.draft["views"]:
                marks = drafts.marks_of(session.store.draft, view)
                ui.label(f"{view}: {len(marks)} screw{'' if len(marks) == 1 else 's'}").classes("group")
                for one in marks:
                    on = page.selected.get(view, {}).get("label") == one["label"]
                    row = ui.row().classes(f"mark {'on' if on else ''}")
                    with row.on("click", partial(self._choose, view, one["label"])):
                        ui.element("span").classes("swatch").style(f"background:{self._ink(view, one['label']).color}")
                        label = (
                            ui.input(value=one["label"]).props("dense borderless maxlength=40").classes("label-input")
                        )
                        named(label, f"Label of a screw in {view}").set_enabled(page.may_edit)
                        label.on("change", partial(self._rename, view, one["label"]))
                        model = ui.select(
                            {None: "any model", **{name: name for name in models}},
                            value=one.get("model") if one.get("model") in models else None,
                            on_change=partial(self._set_model, view, one["label"]),
                        )
                        named(model.props("dense borderless").classes("grow"), f"Model of {view} {one['label']}")
                        model.set_enabled(page.may_edit)
                        if page.may_edit:
                            icon_button(
                                "close", f"Remove {view} {one['label']}", partial(self._remove, view, one["label"])
                            )
            if pairs:
                ui.label("Suggested pairs").classes("group")
                for pair in pairs:
                    with ui.row().classes("pair"):
                        ui.element("span").classes("swatch").style(f"background:{self._ink_of_pair(pair).color}")
                        ui.label(" = ".join(f"{view} {label}" for view, label in pair["labels"].items())).classes(
                            "grow"
                        )
                        ui.label(f"{100 * pair['probability']:.1f} %").classes("muted small")
            about = [one for one in findings if one["field"].startswith("annotations") or not one["field"]]
            if any(drafts.marks_of(session.store.draft, view) for view in session.store.draft["views"]):
                notes(about)

    def _show_next(self) -> None:
        session = self._page.session
        ready = bool(session.known.get("is_ready")) and self._page.may_edit
        errors = sum(one["level"] == "error" for one in session.known.get("findings", []))
        self._solve_button.set_enabled(ready)
        self._mend.set_text(f"{errors} error{'' if errors == 1 else 's'} to mend before solving." if errors else "")

    def _solve(self) -> None:
        self._page.session.solve(Begun())
        self._page.go("review")

    # ---- colours: the first view's screws have theirs, those of other views the colour of the one they pair with
    def _ink(self, view: str, label: str) -> Ink:
        for pair in self._page.session.known.get("pairs", []):
            if pair["labels"].get(view) == label:
                return self._ink_of_pair(pair)
        return self._own_ink(view, label)

    def _ink_of_pair(self, pair: dict[str, Any]) -> Ink:
        view, label = next(iter(pair["labels"].items()))
        return self._own_ink(view, label)

    def _own_ink(self, view: str, label: str) -> Ink:
        draft = self._page.session.store.draft
        keys = [(name, one["label"]) for name in draft["views"] for one in drafts.marks_of(draft, name)]
        return ink_of(keys.index((view, label)) if (view, label) in keys else 0)

    # ---- what a hand did
    def _placed(self, view: str, event: events.GenericEventArguments) -> None:
        self._put(view, _point(event))

    def _put(self, view: str, point: tuple[float, float]) -> None:
        page, session = self._page, self._page.session
        if not page.may_edit:
            return
        begun = dict(session.store.side.begun)
        if view not in begun:
            label = drafts.next_label(session.store.draft, view)
            page.selected = {view: {"label": label, "which": "tip"}}
            session.change_side(begun={**begun, view: BegunMark(label=label, tip=point)})
            return
        one = begun.pop(view)
        page.selected = {view: {"label": one.label, "which": "center"}}
        session.change(drafts.with_mark(session.store.draft, view, one.label, one.tip, point))
        session.change_side(begun=begun)

    def _entered(self, view: str, event: events.GenericEventArguments) -> None:
        """By keys: the centre begins beside the tip, and is moved from there."""
        begun = self._page.session.store.side.begun.get(view)
        if begun is not None:
            self._put(view, (begun.tip[0] + 10.0, begun.tip[1] - 10.0))
        else:
            self._put(view, _point(event))

    def _moved(self, view: str, event: events.GenericEventArguments) -> None:
        page, session = self._page, self._page.session
        if "turn" in event.args and view in page.viewers:
            page.viewers[view].set(heard=int(event.args["turn"]))
        if not page.may_edit:
            return
        label, which = str(event.args["label"]), "tip" if event.args["which"] == "tip" else "center"
        begun = session.store.side.begun
        if view in begun and begun[view].label == label:
            session.change_side(begun={**begun, view: BegunMark(label=label, tip=_point(event))})
        else:
            session.change(drafts.with_landmark(session.store.draft, view, label, which, _point(event)))  # type: ignore[arg-type]

    def _selected(self, view: str, event: events.GenericEventArguments) -> None:
        self._page.selected = {view: {"label": str(event.args["label"]), "which": str(event.args["which"])}}
        self.refresh()

    def _choose(self, view: str, label: str) -> None:
        self._page.selected = {view: {"label": label, "which": "tip"}}
        self.refresh()

    def _stepped(self, view: str, event: events.GenericEventArguments) -> None:
        labels = [one["label"] for one in drafts.marks_of(self._page.session.store.draft, view)]
        if labels:
            now = self._page.selected.get(view, {}).get("label")
            index = labels.index(now) + int(event.args["by"]) if now in labels else 0
            self._choose(view, labels[index % len(labels)])

    def _escaped(self, view: str) -> None:
        page, session = self._page, self._page.session
        page.selected = {}
        if page.may_edit and view in session.store.side.begun:
            session.change_side(begun={name: one for name, one in session.store.side.begun.items() if name != view})
        else:
            self.refresh()

    def _removed(self, view: str) -> None:
        label = self._page.selected.get(view, {}).get("label")
        if label is not None:
            self._remove(view, label)

    def _remove(self, view: str, label: str) -> None:
        page, session = self._page, self._page.session
        if not page.may_edit:
            return
        page.selected = {}
        begun = session.store.side.begun
        if view in begun and begun[view].label == label:
            session.change_side(begun={name: one for name, one in begun.items() if name != view})
        else:
            session.change(drafts.without_mark(session.store.draft, view, label))

    def _rename(self, view: str, label: str, event: events.GenericEventArguments) -> None:
        session, new = self._page.session, str(event.sender.value).strip()[:40]  # type: ignore[attr-defined]
        taken = {one["label"] for one in drafts.marks_of(session.store.draft, view)} - {label}
        if not new or new in taken:
            ui.notify("A label is needed, and each once in a view.", type="negative")
            self.refresh()
        elif self._page.may_edit:
            session.change(drafts.with_label(session.store.draft, view, label, new))

    def _set_model(self, view: str, label: str, event: events.ValueChangeEventArguments[Any]) -> None:
        if self._page.may_edit:
            session = self._page.session
            session.change(drafts.with_mark_model(session.store.draft, view, label, event.value))

    # ---- the mask
    def _mode(self) -> None:
        self._painting = bool(self._paint.value)
        for viewer in self._page.viewers.values():
            viewer.set(
                mode="paint" if self._painting else "mark", brush=self._brush.value, counts=bool(self._erase.value)
            )
        self.refresh()

    async def _painted(self, view: str, event: events.GenericEventArguments) -> None:
        session = self._page.session
        stroke = {"points": event.args["points"], "radius": self._brush.value, "counts": bool(self._erase.value)}
        async with self._stroke:  # each begins with the mask of the one before, and has a file of its own
            if not self._page.may_edit:
                return
            folder = session.store.folder / "masks"
            number = next(n for n in range(1, 10_000) if not (folder / f"{_plain(view)}-{n}.png").exists())
            name = await session.ask("paint", view=view, strokes=[stroke], name=f"{_plain(view)}-{number}.png")
            if name is not None:
                session.change(drafts.with_view_key(session.store.draft, view, "mask", name))


def window_controls(page: "CasePage") -> None:
    """Presets of the window, for all X-rays of the page."""
    with ui.row().classes("tools window-tools").props('aria-label="Window"'):
        for name, words in (("auto", "Auto"), ("full", "Full"), ("metal", "Metal"), ("bone", "Bone")):
            ui.button(words, on_click=partial(_each, page, "preset", name)).props("flat dense no-caps")
        icon_button("invert_colors", "Invert", partial(_each, page, "invert"))
        icon_button("zoom_out_map", "Whole image", partial(_each, page, "fit"))
        icon_button("search", "Loupe", partial(_each, page, "toggleLoupe"))


def _each(page: "CasePage", method: str, *arguments: Any) -> None:
    for viewer in page.viewers.values():
        viewer.run_method(method, *arguments)


def _point(event: events.GenericEventArguments) -> tuple[float, float]:
    return round(float(event.args["u"]), 2), round(float(event.args["v"]), 2)


def _plain(view: str) -> str:
    return "".join(one for one in view if one.isalnum()) or "view"
