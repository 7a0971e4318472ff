"""The screws of a result as buttons: a click chooses one everywhere, another one leaves it."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import ui

if TYPE_CHECKING:
    from screwpose.workbench.page_case import CasePage


def screw_buttons(
    page: "CasePage",
    screws: list[dict[str, Any]],
    head: Callable[[dict[str, Any]], None],
    below: Callable[[dict[str, Any]], None],
) -> None:
    """Make them.

    Parameters
    ----------
    head, below : add to a screw's line, beside its name, and to what stands under it.
    """
    for index, screw in enumerate(screws):
        on = index == page.screw
        with (
            ui.element("button")
            .classes(f"screw {'on' if on else ''}")
            .props(f'type="button" aria-pressed={"true" if on else "false"}')
            .on("click", partial(page.choose_screw, index))
        ):
            with ui.row().classes("card-head"):
                ui.element("span").classes("swatch").style(f"background:{screw['color']}")
                ui.label(screw["name"]).classes("strong grow")
                head(screw)
            below(screw)
