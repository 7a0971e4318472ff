"""The combinations of a result as a table: each can be looked at, and chosen in place of the solver's."""

from collections.abc import Callable
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import ui

if TYPE_CHECKING:
    from screwpose.workbench.page_case import CasePage

_STAGES = (("pre", "before"), ("post", "after"))
SOLVE_FIRST = "solve again first: the case was changed since it was solved."


class CombinationTable:
    """Two lines a combination: before and after registration.

    Parameters
    ----------
    show : called with the number of the combination that is to lie over the X-rays.
    """

    def __init__(self, page: "CasePage", show: Callable[[int], None]) -> None:
        self._page = page
        self._show = show

    def build(self) -> None:
        """Make its elements."""
        self._place = ui.element("div").classes("combinations")

    def refresh(self, data: dict[str, Any], shown: int | None) -> None:
        """Show the combinations of a result; `shown` is the one that lies over the X-rays."""
        keys = [one["key"] for one in data["columns"]]
        self._place.clear()
        with self._place:
            if not data["combinations"]:
                return
            ui.label("Combinations (upper line before, lower line after registration)").classes("group")
            if self._page.may_edit and self._page.session.is_stale:
                ui.label(f"To choose another one: {SOLVE_FIRST}").classes("warning small")
            with ui.element("table").props('aria-label="Combinations"'):
                losses = [f"{view} loss" for view in self._page.viewers]
                with ui.element("thead"), ui.element("tr"):
                    for words in ("", "Pairs", "Prob.", "Dice", "Loss", *losses, ""):
                        with ui.element("th").props("scope=col"):
                            ui.label(words)
                for one in data["combinations"]:
                    cells = dict(zip(keys, one["cells"], strict=True))
                    is_chosen, is_shown = one["id"] == data["chosen"], one["id"] == shown
                    with ui.element("tbody").classes(f"{'chosen' if is_chosen else ''} {'shown' if is_shown else ''}"):
                        self._rows(one, cells, is_chosen, is_shown)

    def _rows(self, one: dict[str, Any], cells: dict[str, str], is_chosen: bool, is_shown: bool) -> None:
        for stage, words in _STAGES:
            with ui.element("tr"):
                if stage == "pre":
                    self._head(one, cells, is_shown)
                for key in ("dice", "loss", *(f"loss_{view}" for view in self._page.viewers)):
                    with ui.element("td").classes("number"):
                        ui.label(cells.get(f"{stage}_{key}", "-")).props(f'title="{words} registration"')
                if stage == "pre":
                    with ui.element("td").props("rowspan=2"):
                        self._choice(one["id"], is_chosen)

    def _head(self, one: dict[str, Any], cells: dict[str, str], is_shown: bool) -> None:
        number = one["id"]
        with ui.element("td").props("rowspan=2"):
            radio = ui.radio({number: ""}, value=number if is_shown else None, on_change=partial(self._show, number))
            radio.props(f'dense aria-label="Show combination {number}"')
        with ui.element("td").props("rowspan=2"):
            for pair in one["pairs"]:
                ui.label(" = ".join(pair.values())).classes("pair-words")
        with ui.element("td").props("rowspan=2"):
            ui.label(cells.get("probability", "-"))

    def _choice(self, number: int, is_chosen: bool) -> None:
        if is_chosen:
            is_own = self._page.session.store.side.choice is not None
            ui.label("yours" if is_own else "chosen").classes("badge")
        elif self._page.may_edit:
            button = ui.button("Choose", on_click=partial(self._ask_reason, number)).props("outline dense no-caps")
            button.set_enabled(not self._page.session.is_stale)

    def _ask_reason(self, number: int) -> None:
        with ui.dialog(value=True) as dialog, ui.card().classes("dialog"):
            ui.label(f"Choose combination {number}").classes("heading")
            ui.label("It is registered anew, and kept as your choice. Why is it right?").classes("muted small")
            reason = ui.input("Reason").props("outlined autofocus maxlength=500").classes("wide")

            def choose() -> None:
                words = str(reason.value or "").strip()
                if not words:
                    ui.notify("A word of reason is needed: others will read the result.", type="negative")
                    return
                dialog.close()
                self._page.session.choose(number, words, f"{datetime.now().astimezone():%Y-%m-%d %H:%M}")

            reason.on("keydown.enter", choose)
            with ui.row().classes("actions"):
                ui.button("Cancel", on_click=dialog.close).props("flat no-caps")
                ui.button("Choose it", on_click=choose).props("no-caps")
