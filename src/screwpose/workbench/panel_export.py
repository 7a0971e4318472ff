"""Export: what `screwpose solve` writes, and the case itself."""

from functools import partial
from typing import TYPE_CHECKING

from nicegui import ui

from screwpose.workbench.workspace import address_of

if TYPE_CHECKING:
    from screwpose.workbench.page_case import CasePage

_FILES = (
    ("result.json", "Result", "pairing, poses and expected errors, for programs"),
    ("report.html", "Report", "one page with overlays, tables and the 3D view; needs no internet"),
    ("meshes.zip", "Meshes", "every screw as STL, in world coordinates, mm"),
    ("combinations.csv", "Table", "the scores of every combination"),
    ("case.zip", "Case folder", "to go on with on another computer: unpack it, and screwpose open it"),
)


class ExportPanel:
    """The last stage."""

    def __init__(self, page: "CasePage") -> None:
        self._page = page

    def build(self) -> None:
        """Make its elements."""
        self._place = ui.element("div").classes("export-stage")

    def refresh(self) -> None:
        """Show what can be fetched."""
        session = self._page.session
        written = session.store.folder / "report" / "result.json"
        own = session.store.folder / "result" / "result.json"
        is_written = own.exists() and written.exists() and written.stat().st_mtime >= own.stat().st_mtime
        self._place.clear()
        with self._place, ui.element("section").classes("card"):
            ui.label("Export").classes("heading").props('role="heading" aria-level="1"')
            if not session.is_solved:
                ui.label("There is no result yet. The case folder can be taken along as it is.").classes("muted")
            elif session.is_stale:
                ui.label("The result is older than the case: solve again before you rely on it.").classes("warning")
            if session.store.side.by_hand:
                ui.label("Screws moved by hand are not in the result until you refine from there.").classes("warning")
            if session.is_solved and not is_written:
                button = ui.button("Write the report").props("no-caps")
                button.on_click(partial(self._write, button))
                button.set_enabled(self._page.may_edit)
            for name, title, words in _FILES:
                ready = name == "case.zip" or (session.is_solved and (is_written or name == "result.json"))
                with ui.row().classes("export"):
                    with ui.column().classes("grow tight"):
                        ui.label(title).classes("strong")
                        ui.label(words).classes("muted small")
                    if ready:
                        ui.link(f"Get {name}", address_of(session.key, name), new_tab=name == "report.html").classes(
                            "get"
                        )
                    else:
                        ui.label("not written yet").classes("muted small")

    async def _write(self, button: ui.button) -> None:
        if not self._page.may_edit:  # the case was taken over since
            return
        button.props("loading")
        await self._page.session.ask("export")
        self._page.session.tell()
