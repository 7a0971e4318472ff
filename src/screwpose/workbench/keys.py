"""The keys, listed under ``?``."""

from nicegui import ui

KEYS = (
    ("X-ray", (
        ("Wheel, two fingers, + and -", "zoom"),
        ("Drag, arrows with no point chosen", "move the image"),
        ("Right button or Shift + drag", "window and level"),
        ("1  2  3  4", "window: automatic, full range, metal, bone"),
        ("i", "invert"),
        ("o", "loupe on or off"),
        ("0", "whole image"),
    )),
    ("Mark", (
        ("Click", "tip, then centre of the screw's body"),
        ("n", "a point in the middle of the view"),
        ("Enter", "the centre of the screw that is begun"),
        ("Drag a point", "correct it"),
        ("Arrows", "move the chosen point by 0.1 px; Shift 1 px, Alt 10 px"),
        ("t  c", "choose its tip, its centre"),
        ("[  ]", "the screw before, the next one"),
        ("Delete", "remove the chosen screw"),
        ("Escape", "leave off"),
    )),
    ("Review", (
        ("Drag a screw", "move it in the view (Alt + drag moves the image)"),
        ("Arrows", "move the chosen screw by 0.1 px; Shift 1 px, Alt 10 px"),
        ("r  R", "turn it about its axis by 1 degree, and back"),
        ("t  T", "tilt it in the view by 0.2 degrees, and back"),
        ("a  A", "along its axis by 0.1 mm, and back"),
        ("d  D", "away along the ray by 0.1 mm, and back"),
        ("[  ]", "the screw before, the next one"),
    )),
    ("3D", (
        ("Drag, arrows", "turn"),
        ("Right button + drag, Shift + arrows", "move"),
        ("Wheel, + and -", "zoom"),
    )),
    ("Everywhere", (
        ("Ctrl + Z", "undo"),
        ("Ctrl + Shift + Z", "redo"),
        ("Tab", "the next control"),
        ("?", "these keys"),
    )),
)  # fmt: skip


def keys_dialog() -> ui.dialog:
    """The dialog, closed."""
    with ui.dialog() as dialog, ui.card().classes("keys"):
        ui.label("Keys").classes("heading").props('role="heading" aria-level="2"')
        with ui.element("div").classes("key-groups"):
            for group, lines in KEYS:
                with ui.element("div"):
                    ui.label(group).classes("group")
                    with ui.element("dl"):
                        for key, words in lines:
                            with ui.element("dt"):
                                ui.label(key)
                            with ui.element("dd"):
                                ui.label(words)
        ui.button("Close", on_click=dialog.close).props("no-caps autofocus")
    return dialog
