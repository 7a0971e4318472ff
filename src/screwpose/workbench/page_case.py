"""The page of a case: its stages, the X-rays, and beside them what the stage is about."""

from functools import partial
from typing import Protocol, get_args

from nicegui import Client, ui

from screwpose.errors import ScrewposeError
from screwpose.workbench.keys import keys_dialog
from screwpose.workbench.panel_export import ExportPanel
from screwpose.workbench.panel_images import ImagesPanel
from screwpose.workbench.panel_mark import MarkPanel
from screwpose.workbench.panel_review import ReviewPanel
from screwpose.workbench.panel_space import SpacePanel
from screwpose.workbench.session import Session
from screwpose.workbench.sessions import Sessions
from screwpose.workbench.side_file import Stage
from screwpose.workbench.theme import Theme, footer, icon_button
from screwpose.workbench.viewer import Viewer

STAGES: tuple[Stage, ...] = get_args(Stage)
WORDS: dict[Stage, str] = {
    "images": "Images",
    "mark": "Mark",
    "review": "Solve & review",
    "space": "3D",
    "export": "Export",
}
_WITH_XRAYS = ("mark", "review")


class Panel(Protocol):
    """What stands beside the X-rays, or in their place, in one stage."""

    def build(self) -> None:
        """Make its elements, where the page puts them."""

    def refresh(self) -> None:
        """Show the case as it is now."""


class CasePage:
    """One tab on one case."""

    def __init__(self, sessions: Sessions, session: Session, client: Client) -> None:
        self.sessions = sessions
        self.session = session
        self.client = client
        self.stage: Stage = session.store.side.stage
        self.viewers: dict[str, Viewer] = {}
        self.selected: dict[str, dict[str, str]] = {}
        self.screw: int | None = None
        self.theme = Theme()
        self._shown_views: tuple[str, ...] | None = None
        self._panels: dict[Stage, Panel] = {
            "images": ImagesPanel(self),
            "mark": MarkPanel(self),
            "review": ReviewPanel(self),
            "space": SpacePanel(self),
            "export": ExportPanel(self),
        }

    @property
    def may_edit(self) -> bool:
        """Whether this tab holds the case, and this server."""
        return self.session.owner == self.client.id and self.session.may_write

    # ---- the page
    def build(self) -> None:
        """Make the page."""
        with ui.element("header").classes("bar"):
            ui.link("screwpose", "/").classes("brand")
            ui.label(self.session.key).classes("case-title").props('title="The case folder"')
            with ui.element("nav").classes("stages").props('aria-label="Stages"'):
                self._stages = {
                    name: ui.button(WORDS[name], on_click=partial(self.go, name))
                    .props("flat no-caps")
                    .mark(f"stage-{name}")
                    for name in STAGES
                }
            self._saved = ui.label().classes("muted small saved").props('role="status"')
            self._undo = icon_button("undo", "Undo (Ctrl+Z)", self.undo)
            self._redo = icon_button("redo", "Redo (Ctrl+Shift+Z)", self.redo)
            self._keys = keys_dialog()
            icon_button("help_outline", "Keys (?)", self._keys.open)
            self.theme.button()
        with ui.row().classes("banner").props('role="alert"') as self._banner:
            self._banner_words = ui.label()
            ui.button("Take over", on_click=self.take_over).props("no-caps dense").mark("take-over")
        self._problem = ui.label().classes("problem wide").props('role="alert"')
        self._main = ui.element("main").classes("work")
        footer()
        ui.keyboard(self._key, ignore=["input", "select", "textarea"])
        self.theme.listeners.append(self.refresh)
        self.go(self.stage)

    def go(self, stage: Stage) -> None:
        """Show another stage."""
        self.stage = stage
        self._main.clear()
        self.viewers = {}
        self._shown_views = tuple(self.session.store.draft["views"]) if stage in _WITH_XRAYS else None
        self._main.classes(remove=" ".join(f"at-{name}" for name in STAGES), add=f"at-{stage}")
        with self._main:
            if stage in _WITH_XRAYS:
                with ui.element("div").classes("xrays"):
                    for name in self._shown_views or ():
                        self.viewers[name] = Viewer(name)
                with ui.element("aside").classes("side").props('aria-label="Panel"'):
                    self._panels[stage].build()
            else:
                self._panels[stage].build()
        if self.may_edit and self.session.store.side.stage != stage:
            self.session.change_side(stage=stage)  # which has every tab refreshed
        else:
            self.refresh()

    def refresh(self) -> None:
        """Show the case as it is now."""
        session = self.session
        if self._shown_views is not None and self._shown_views != tuple(session.store.draft["views"]):
            self.go(self.stage)
            return
        for stage, button in self._stages.items():
            is_on = stage == self.stage
            button.classes(add="on" if is_on else "", remove="" if is_on else "on")
            button.props(f"aria-current={'page' if is_on else 'false'}")
        self._banner.set_visibility(session.owner is not None and not self.may_edit)
        self._banner_words.set_text(self._who_has_it())
        self._problem.set_text(session.problem)
        self._problem.set_visibility(bool(session.problem))
        self._saved.set_text("" if session.problem else "Saved" if self.may_edit else "View only")
        self._undo.set_enabled(self.may_edit and session.store.can_undo)
        self._redo.set_enabled(self.may_edit and session.store.can_redo)
        for name, viewer in self.viewers.items():
            facts = session.known.get("views", {}).get(name)
            if facts is not None:
                viewer.show(facts)
                viewer.set(outside=facts["outside"])
            viewer.set(editable=self.may_edit)
        self._panels[self.stage].refresh()

    # ---- whose the case is
    def take_over(self) -> None:
        """This tab changes the case from now on; the other one, here or of another server, only looks."""
        self.session.owner = self.client.id
        self.session.keep(takes=True)
        self.session.tell()

    def _who_has_it(self) -> str:
        other = self.session.store.claim.other
        if other is None:
            return "This case is open in another tab. Here it can only be looked at."
        where = f"process {other.pid} on {other.host}"
        return f"This case is open in another workbench ({where}). Here it can only be looked at."

    def left(self) -> None:
        """The tab is gone: the next one that looks may go on."""
        self.session.listeners.pop(self.client.id, None)
        if self.session.owner == self.client.id:
            self.session.owner = next(iter(self.session.listeners), None)
            self.session.tell()

    # ---- actions of all stages
    def choose_screw(self, index: int) -> None:
        """Choose a screw of the result, or leave it if it was."""
        self.screw = None if self.screw == index else index
        self.refresh()

    def undo(self) -> None:
        """Take back the last action."""
        if self.may_edit:
            self.session.undo()

    def redo(self) -> None:
        """Do again what was taken back."""
        if self.may_edit:
            self.session.redo()

    def _key(self, event: object) -> None:
        key, action, modifiers = event.key, event.action, event.modifiers  # type: ignore[attr-defined]
        if not action.keydown:
            return
        if (modifiers.ctrl or modifiers.meta) and key.name.lower() == "z":
            act = self.redo if modifiers.shift else self.undo
            act()
        elif (modifiers.ctrl or modifiers.meta) and key.name.lower() == "y":
            self.redo()
        elif key.name == "?":
            self._keys.open()


async def case_page(sessions: Sessions, key: str) -> None:
    """Build the page of a case for one tab."""
    try:
        session = sessions.get(key)
    except ScrewposeError as error:
        Theme()
        with ui.element("main").classes("start"), ui.element("section").classes("card"):
            ui.label("This case cannot be opened").classes("heading")
            ui.label(str(error)).classes("problem")
            ui.link("To the start page", "/")
        return
    client = ui.context.client
    page = CasePage(sessions, session, client)
    ui.page_title(f"{key} - screwpose")
    page.build()
    client.on_delete(page.left)
    await client.connected(timeout=60.0)
    _hold(session, client.id)
    session.listeners[client.id] = page.refresh
    session.watch()
    if session.known:
        session.tell()
    else:
        session.look_soon()
    if session.is_solved and session.reviewed is None:
        await session.load_review()


def _hold(session: Session, client_id: str) -> None:
    """The case is this tab's, unless another one that is still there holds it."""
    owner = Client.instances.get(session.owner or "")
    if owner is None or not owner.has_socket_connection:
        session.owner = client_id
        session.tell()
