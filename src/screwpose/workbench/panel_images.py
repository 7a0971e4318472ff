"""Images: X-rays with their calibration, and the CAD models; what `check` finds stands beside what it is about."""

import json
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import ui

from screwpose.errors import ScrewposeError
from screwpose.files.calibration import read_calibration
from screwpose.workbench import draft as drafts
from screwpose.workbench.intake import take_in
from screwpose.workbench.theme import icon_button, notes
from screwpose.workbench.uploading import Uploaded, uploader

if TYPE_CHECKING:
    from screwpose.workbench.page_case import CasePage

_POLARITIES = {"auto": "found out from the image", "metal-dark": "metal is dark", "metal-bright": "metal is bright"}
_UNITS = ["mm", "cm", "m", "inch"]
_FORMS = (
    "12 numbers: the 3 x 4 matrix P, row by row. Or 9 numbers (intrinsics K) and 12 or 16 (pose [R | t], world to "
    'camera, mm). Or JSON: {"projection": ...} or {"K": ..., "R": ..., "t": ...}.'
)


class ImagesPanel:
    """The first stage."""

    def __init__(self, page: "CasePage") -> None:
        self._page = page

    def build(self) -> None:
        """Make its elements."""
        with ui.element("div").classes("images-stage"):
            with ui.element("section").classes("card dropping"):
                uploader(self._page.sessions, self._take, "Drop X-rays, calibrations and CAD models here")
            self._cards = ui.element("div").classes("cards")
            # What is made anew while a hand is on its way to it is missed: what is always there stays.
            with ui.element("section").classes("card next"):
                ui.label("Case").classes("heading")
                self._rest = ui.element("div")
                self._hint = ui.label().classes("muted")
                self._on = ui.button("Mark the screws", on_click=partial(self._page.go, "mark")).props("no-caps")
        self._shown: Any = None
        self._dialog = _CalibrationDialog(self._page)

    async def _take(self, files: list[Uploaded]) -> None:
        if not self._page.may_edit:
            ui.notify("Not taken: here the case can only be looked at. Take over to go on here.", type="negative")
        else:
            session = self._page.session
            session.told_of_files = await take_in(self._page.sessions, session, files)
            session.tell()

    def refresh(self) -> None:
        """Show the case as it is now."""
        session = self._page.session
        findings = session.known.get("findings", [])
        has_all = len(session.known.get("views", {})) > 1 and any(
            "mesh" in one for one in session.store.draft["models"].values()
        )
        self._on.set_enabled(has_all)
        self._hint.set_text(
            "Next: mark each screw's tip and centre in both X-rays."
            if has_all
            else "A case needs two X-rays, a calibration for each, and a CAD model."
        )
        shown = (session.store.draft, session.known, list(session.told_of_files), self._page.may_edit)
        if shown == self._shown:
            return
        self._shown = shown
        self._cards.clear()
        with self._cards:
            for one in session.told_of_files:
                with ui.element("section").classes("card span"):
                    notes([one])
            for view in dict.fromkeys([*session.store.draft["views"], *drafts.CUSTOMARY_VIEWS]):
                if view in session.store.draft["views"] or len(session.store.draft["views"]) < 2:
                    self._view_card(view, [one for one in findings if _is_about(one, f"views.{view}")])
            self._models_card([one for one in findings if one["field"].startswith("models")])
        self._rest.clear()
        with self._rest:
            own = (*(f"views.{view}" for view in session.store.draft["views"]), "models", "annotations")
            notes([one for one in findings if not any(_is_about(one, field) for field in own)])

    def _view_card(self, view: str, findings: list[dict[str, str]]) -> None:
        session = self._page.session
        entry: dict[str, Any] = session.store.draft["views"].get(view, {})
        facts = session.known.get("views", {}).get(view)
        with ui.element("section").classes("card view-card").mark(f"view-{view}"):
            with ui.row().classes("card-head"):
                ui.label(view).classes("heading").props('role="heading" aria-level="2"')
                ui.label(f"{facts['width']} x {facts['height']} px, {facts['bits']} bit" if facts else "").classes(
                    "muted small grow"
                )
                if entry and self._page.may_edit:
                    icon_button("delete_outline", f"Remove {view}", partial(self._remove_view, view))
            if facts:
                picture = ui.image(f"/preview/{facts['key']}").classes("preview")
                picture.props["alt"] = f"Preview of the X-ray {view}"
            else:
                ui.label("No X-ray yet: drop one above." if "image" not in entry else "Reading the X-ray ...").classes(
                    "empty"
                )
            if "image" in entry:
                ui.label(str(entry["image"])).classes("muted small")
                polarity = entry.get("polarity", "auto")
                ui.select(
                    _POLARITIES, value=polarity if polarity in _POLARITIES else "auto", label="Polarity",
                    on_change=lambda e: self._edit(
                        drafts.with_view_key(session.store.draft, view, "polarity", e.value)
                    ),
                ).props("dense outlined").classes("wide").set_enabled(self._page.may_edit)  # fmt: skip
            with ui.row().classes("calibration"):
                has = "projection" in entry
                ui.icon("check_circle" if has else "radio_button_unchecked").classes("ok" if has else "muted")
                ui.label("Calibrated" if has else "Not calibrated").classes("grow")
                ui.button("Calibration", on_click=partial(self._dialog.open, view)).props(
                    "outline no-caps dense"
                ).set_enabled(self._page.may_edit)
            notes(findings)

    def _models_card(self, findings: list[dict[str, str]]) -> None:
        session = self._page.session
        with ui.element("section").classes("card models-card"):
            ui.label("CAD models").classes("heading").props('role="heading" aria-level="2"')
            models = session.store.draft["models"]
            if not models:
                ui.label("No model yet: drop an STL, OBJ, PLY, VTK or STEP file above.").classes("empty")
            for name, model in models.items():
                with ui.row().classes("model"):
                    with ui.column().classes("grow tight"):
                        ui.label(name).classes("strong")
                        ui.label(str(model.get("mesh", "its mesh is missing: drop the file"))).classes("muted small")
                    if self._page.may_edit:
                        icon_button("delete_outline", f"Remove {name}", partial(self._remove_model, name))
                with ui.row().classes("landmarks"):
                    unit = model.get("unit", "mm")
                    ui.select(
                        _UNITS, value=unit if unit in _UNITS else "mm", label="Unit",
                        on_change=lambda e, n=name: self._model_key(n, "unit", e.value),
                    ).props("dense outlined").set_enabled(self._page.may_edit)  # fmt: skip
                    for key, word in (("tip", "Tip, mm"), ("center", "Centre, mm")):
                        ui.input(word, value=_triple(model.get(key))).on(
                            "change", lambda e, n=name, k=key: self._landmark(n, k, e.sender.value)
                        ).props("dense outlined").classes("grow").set_enabled(self._page.may_edit)
                for note in session.notes_of_models.get(name, []):
                    ui.label(note).classes("muted small")
            notes(findings)

    def _edit(self, draft: drafts.Draft) -> None:
        if self._page.may_edit:
            self._page.session.change(draft)

    def _remove_view(self, view: str) -> None:
        self._edit(drafts.without_view(self._page.session.store.draft, view))

    def _remove_model(self, name: str) -> None:
        self._edit(drafts.without_model(self._page.session.store.draft, name))

    def _model_key(self, name: str, key: str, value: Any) -> None:
        draft = self._page.session.store.draft
        if draft["models"].get(name, {}).get(key) != value:
            self._edit(drafts.with_model(draft, name, {**draft["models"][name], key: value}))

    def _landmark(self, name: str, key: str, text: str) -> None:
        try:
            values = [float(one) for one in text.replace(",", " ").replace("[", " ").replace("]", " ").split()]
        except ValueError:
            values = []
        if len(values) != 3:
            ui.notify("Three numbers, in mm, are needed.", type="negative")
            self.refresh()
            return
        self._model_key(name, key, values)


class _CalibrationDialog:
    """Where a calibration is pasted."""

    def __init__(self, page: "CasePage") -> None:
        self._page = page
        self._view = ""
        with ui.dialog() as self._dialog, ui.card().classes("dialog"):
            self._title = ui.label().classes("heading")
            ui.label(_FORMS).classes("muted small")
            self._text = ui.textarea("Calibration").props("outlined autofocus input-class=mono rows=8").classes("wide")
            self._problem = ui.label().classes("problem").props('role="alert"')
            with ui.row().classes("actions"):
                ui.button("Cancel", on_click=self._dialog.close).props("flat no-caps")
                ui.button("Use it", on_click=self._use).props("no-caps")

    def open(self, view: str) -> None:
        """Ask for the calibration of a view."""
        self._view = view
        self._title.set_text(f"Calibration of {view}")
        matrix = self._page.session.store.draft["views"].get(view, {}).get("projection")
        self._text.set_value("" if matrix is None else "\n".join(" ".join(f"{x:.10g}" for x in row) for row in matrix))
        self._problem.set_visibility(False)
        self._dialog.open()

    def _use(self) -> None:
        try:
            matrix = read_calibration(self._text.value or "")
        except ScrewposeError as error:
            self._problem.set_text(str(error))
            self._problem.set_visibility(True)
            return
        if self._page.may_edit:
            self._page.session.change(drafts.with_projection(self._page.session.store.draft, self._view, matrix))
        self._dialog.close()


def _is_about(finding: dict[str, str], field: str) -> bool:
    return finding["field"] == field or finding["field"].startswith((f"{field}.", f"{field}["))


def _triple(values: Any) -> str:
    if not isinstance(values, list | tuple):
        return ""
    return " ".join(f"{x:g}" if isinstance(x, int | float) else json.dumps(x) for x in values)
