"""How do people read it? Overlays, tables, placed meshes, and one page that holds them all. (floor 4)

The names are fetched when they are first used, so that importing this package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.report.comparison import Comparison, ScrewComparison
    from screwpose.report.meshes import write_meshes
    from screwpose.report.overlays import crop_around, overlay
    from screwpose.report.palette import Palette
    from screwpose.report.tables import Table, combination_table, pairing_table
    from screwpose.report.writing import write_report

__all__ = [
    "Comparison",
    "Palette",
    "ScrewComparison",
    "Table",
    "combination_table",
    "crop_around",
    "overlay",
    "pairing_table",
    "write_meshes",
    "write_report",
]

_MODULE_OF = {
    "Comparison": "comparison",
    "Palette": "palette",
    "ScrewComparison": "comparison",
    "Table": "tables",
    "combination_table": "tables",
    "crop_around": "overlays",
    "overlay": "overlays",
    "pairing_table": "tables",
    "write_meshes": "meshes",
    "write_report": "writing",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
