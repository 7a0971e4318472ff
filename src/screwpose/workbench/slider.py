"""A slider that keeps every step of a key that is held down."""

from nicegui import ui


class Slider(ui.slider):
    """NiceGUI's own is told each value back by the server, late: that takes back the steps that were made meanwhile."""

    LOOPBACK = False
