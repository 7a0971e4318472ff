"""How the pages look: the style sheet, the theme that a browser chose last, and small parts that all pages have."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from nicegui import ui

from screwpose.report.words import DISCLAIMER

_COOKIE = "screwpose-theme"


class Theme:
    """Dark, as X-rays are read, unless this browser chose light; `listeners` are told when it changes."""

    def __init__(self) -> None:
        ui.add_head_html('<link rel="stylesheet" href="/static/workbench.css">')
        ui.colors(primary="#0b7285", secondary="#46525e", negative="#b3382c", warning="#9a6700", positive="#1a7f4b")
        request = ui.context.client.request
        self.is_light = request is not None and request.cookies.get(_COOKIE) == "light"
        self._mode = ui.dark_mode(not self.is_light)
        self.listeners: list[Callable[[], None]] = []

    def toggle(self) -> None:
        """The other one, remembered by the browser."""
        self.is_light = not self.is_light
        self._mode.value = not self.is_light
        name = "light" if self.is_light else "dark"
        ui.run_javascript(f"document.cookie = '{_COOKIE}={name}; path=/; max-age=31536000; samesite=strict'")
        for listener in self.listeners:
            listener()

    def button(self) -> None:
        """To change it."""
        icon_button("contrast", "Dark or light", self.toggle)


def icon_button(icon: str, words: str, act: Callable[..., Any]) -> ui.button:
    """A button that is a picture, with its words for who points at it or listens."""
    with named(ui.button(icon=icon, on_click=act).props("flat dense round").classes("quiet"), words) as button:
        ui.tooltip(words)
    return button


_Kind = TypeVar("_Kind", bound=ui.element)


def named(element: _Kind, words: str) -> _Kind:
    """Say what an element is to who listens. Words may be a label that somebody typed, so they are no text of props."""
    element.props["aria-label"] = words
    return element


def notes(found: Sequence[dict[str, str]]) -> None:
    """What `check` found, each with a sign and a word beside the colour."""
    for one in found:
        word, icon = ("Error", "error") if one["level"] == "error" else ("Note", "info")
        with ui.row().classes(f"finding {one['level']}").props('role="note"'):
            ui.icon(icon)
            ui.label(f"{word}: {one['text']}")


def footer() -> None:
    """What it is not."""
    ui.label(DISCLAIMER).classes("disclaimer")
