"""The solve of a case: asked for, waiting, running, failed, cancelled, or interrupted by the end of a server."""

from typing import TYPE_CHECKING

from nicegui import ui

from screwpose.workbench.side_file import Begun

if TYPE_CHECKING:
    from screwpose.workbench.page_case import CasePage


class JobCard:
    """What stands above the answer. An element that is made anew while a hand is on its way to it is missed, so all of
    it is always there, and only shown or not."""

    def __init__(self, page: "CasePage") -> None:
        self._page = page

    def build(self) -> None:
        """Make its elements."""
        session = self._page.session
        with ui.element("section").classes("card running").props('role="status"') as self._running:
            self._title = ui.label().classes("heading")
            self._bar = ui.linear_progress(value=0.0, show_value=False).props('aria-label="Progress"')
            self._what = ui.label().classes("small")
            self._left = ui.label().classes("muted small")
            self._cancel = ui.button("Cancel", on_click=session.cancel).props("outline no-caps dense")
        self._failed = ui.label().classes("problem").props('role="alert"')
        self._cancelled = ui.label("The solve was cancelled; what was found before stays.").classes("muted")
        with ui.element("section").classes("card interrupted").props('role="alert"') as self._interrupted:
            ui.label("A solve was interrupted").classes("heading")
            ui.label("The workbench ended while it ran. Nothing else was lost.").classes("small")
            with ui.row().classes("actions"):
                self._again = ui.button("Solve again", on_click=self._solve_again).props("no-caps dense")
                self._leave = ui.button("Leave it", on_click=lambda: session.change_side(job=None))
                self._leave.props("flat no-caps dense")
        self._state = ui.label().classes("stale")
        self._solve = ui.button("Solve", on_click=lambda: session.solve(Begun())).props("no-caps").classes("wide")

    def _solve_again(self) -> None:
        asked = self._page.session.store.side.job
        if asked is not None:
            self._page.session.solve(asked)

    def refresh(self) -> None:
        """Show how far it is."""
        session, may_edit = self._page.session, self._page.may_edit
        job = session.job
        is_open = job is not None and job.is_open
        is_there = session.store.side.job is not None and not session.may_write
        is_interrupted = session.store.side.job is not None and not is_open and not is_there
        self._running.set_visibility(is_open)
        self._cancel.set_enabled(may_edit)
        self._failed.set_visibility(job is not None and job.state == "failed")
        self._cancelled.set_visibility(job is not None and job.state == "cancelled")
        self._interrupted.set_visibility(is_interrupted)
        self._again.set_enabled(may_edit)
        self._leave.set_enabled(may_edit)
        asks = not is_open and not is_interrupted and not is_there and (not session.is_solved or session.is_stale)
        self._state.set_visibility(asks or is_there)
        self._state.set_text(
            "The other workbench is solving it."
            if is_there
            else "The case was changed since it was solved."
            if session.is_solved
            else "Not solved yet."
        )
        self._solve.set_visibility(asks)
        self._solve.set_enabled(bool(session.known.get("is_ready")) and may_edit)
        if job is not None:
            left = job.left_s
            self._title.set_text("Solving" if job.state == "running" else "In the queue")
            self._bar.set_value(round(job.fraction, 3))
            self._what.set_text(job.what[:1].upper() + job.what[1:])
            self._left.set_text("" if left is None else f"about {max(left, 1.0):.0f} s left")
            self._failed.set_text(f"The solve failed: {job.problem}")
