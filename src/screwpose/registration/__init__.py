"""Which pose explains the images best? (floor 4)"""

from screwpose.registration.drawing import drawn_losses, search_window, search_windows
from screwpose.registration.initial import AxialSearch, align, axial_search, turned
from screwpose.registration.search import (
    Progress,
    SceneLosses,
    SearchOptions,
    SearchResult,
    moved,
    moved_by_each,
    register,
)

__all__ = [
    "AxialSearch",
    "Progress",
    "SceneLosses",
    "SearchOptions",
    "SearchResult",
    "align",
    "axial_search",
    "drawn_losses",
    "moved",
    "moved_by_each",
    "register",
    "search_window",
    "search_windows",
    "turned",
]
