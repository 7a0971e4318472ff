"""The start page: the cases that are there, a new one, and the demo."""

from datetime import datetime
from functools import partial
from typing import Any

from nicegui import ui

from screwpose.errors import ScrewposeError
from screwpose.workbench.intake import take_in
from screwpose.workbench.sessions import Sessions
from screwpose.workbench.store import CaseStore
from screwpose.workbench.theme import Theme, footer
from screwpose.workbench.uploading import uploader
from screwpose.workbench.workspace import address_of


def start_page(sessions: Sessions) -> None:
    """Build the page for one browser."""
    theme = Theme()
    with ui.element("header").classes("bar"):
        ui.label("screwpose").classes("brand")
        ui.label("Where are the screws?").classes("muted grow")
        theme.button()
    with ui.element("main").classes("start"):
        with ui.element("section").classes("card"):
            ui.label("New case").classes("heading").props('role="heading" aria-level="1"')
            ui.label("Drop two X-rays, their calibration and the CAD model here, or choose files.").classes("muted")
            problem = ui.label().classes("problem").props('role="alert"')
            problem.set_visibility(False)
            new = _New(sessions, problem)
            uploader(sessions, new.take, "Drop files to begin a case")
            ui.label("PNG, TIFF or DICOM; STL, OBJ, PLY, VTK or STEP; calibration as JSON or text.").classes(
                "muted small"
            )
            with ui.row().classes("actions"):
                ui.button("Empty case", on_click=new.empty).props("outline no-caps")
                demo = ui.button("Try the demo case").props("no-caps")
                demo.on_click(partial(_demo, sessions, demo, problem))
            ui.label(
                "Two screws in a simulated patient, marked and ready to solve. It takes some seconds to make."
            ).classes("muted small")
        with ui.element("section").classes("card"):
            ui.label("Recent cases").classes("heading").props('role="heading" aria-level="2"')
            _recent(sessions)
    footer()


class _New:
    """The case that files are dropped for: made with the first of them, shown once all are in."""

    def __init__(self, sessions: Sessions, problem: ui.label) -> None:
        self._sessions = sessions
        self._problem = problem
        self._store: CaseStore | None = None

    def empty(self) -> None:
        """A case without files."""
        store = self._made()
        if store is not None:
            ui.navigate.to(address_of(store.folder.name))

    async def take(self, files: list[Any]) -> None:
        """Files that came in together."""
        store = self._made()
        if store is None:
            return
        session = self._sessions.get(store.folder.name)
        session.told_of_files = await take_in(self._sessions, session, files)
        ui.navigate.to(address_of(store.folder.name))

    def _made(self) -> CaseStore | None:
        try:
            self._store = self._store or CaseStore.created(
                self._sessions.workspace.folder, f"case-{datetime.now().astimezone():%Y-%m-%d-%H%M}"
            )
        except ScrewposeError as error:
            self._problem.set_text(str(error))
            self._problem.set_visibility(True)
        return self._store


async def _demo(sessions: Sessions, button: ui.button, problem: ui.label) -> None:
    button.props("loading")
    try:
        sessions.workspace.folder.mkdir(parents=True, exist_ok=True)
        arguments: dict[str, object] = {"workspace": str(sessions.workspace.folder), "seed": 7}
        key = await sessions.helped("simulate", arguments, quiet_s=300.0)
        ui.navigate.to(address_of(str(key)))
    except (ScrewposeError, OSError) as error:
        problem.set_text(str(error))
        problem.set_visibility(True)
    finally:
        button.props(remove="loading")


def _recent(sessions: Sessions) -> None:
    cases = sessions.workspace.cases()
    if not cases:
        ui.label("None yet.").classes("muted")
    with ui.element("ul").classes("recent"):
        for one in cases:
            with ui.element("li"), ui.link(target=address_of(one.key)).classes("case-link"):
                ui.label(one.key).classes("case-name")
                ui.label("solved" if one.is_solved else "not solved").classes("muted small")
                ui.label(f"{one.changed:%d %b %Y, %H:%M}").classes("muted small")
