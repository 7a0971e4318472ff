"""What was asked and answered: case, truth, result and summary files. (floor 3)

The names are fetched when they are first used, so that importing this package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.files.atomic import (
        atomic_folder,
        ensure_can_write_folder,
        write_bytes,
        write_json,
        write_text,
    )
    from screwpose.files.case import Annotation, Case, View
    from screwpose.files.result import CombinationScene, PosedImplant, Result

__all__ = [
    "Annotation",
    "Case",
    "CombinationScene",
    "PosedImplant",
    "Result",
    "View",
    "atomic_folder",
    "ensure_can_write_folder",
    "write_bytes",
    "write_json",
    "write_text",
]

_MODULE_OF = {
    "Annotation": "case",
    "Case": "case",
    "CombinationScene": "result",
    "PosedImplant": "result",
    "Result": "result",
    "View": "case",
    "atomic_folder": "atomic",
    "ensure_can_write_folder": "atomic",
    "write_bytes": "atomic",
    "write_json": "atomic",
    "write_text": "atomic",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
