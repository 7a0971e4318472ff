"""Which pose explains the images best? (floor 4)"""

from screwpose._progress import Progress
from screwpose.registration.basin import FarFit, FarXrays, Xray, prepare_far, register_from
from screwpose.registration.drawing import drawn_losses, search_window, search_windows
from screwpose.registration.initial import AxialSearch, align, axial_search, turned
from screwpose.registration.search import (
    Registered,
    SceneLosses,
    SearchOptions,
    SearchResult,
    moved,
    moved_by_each,
    register,
)

__all__ = [
    "AxialSearch",
    "FarFit",
    "FarXrays",
    "Progress",
    "Registered",
    "SceneLosses",
    "SearchOptions",
    "SearchResult",
    "Xray",
    "align",
    "axial_search",
    "drawn_losses",
    "moved",
    "moved_by_each",
    "prepare_far",
    "register",
    "register_from",
    "search_window",
    "search_windows",
    "turned",
]
