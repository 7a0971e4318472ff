"""Which pose explains the images best? (floor 4)"""

from screwpose.registration.initial import AxialSearch, align, axial_search, turned
from screwpose.registration.search import Progress, SearchOptions, SearchResult, moved, register, search_window

__all__ = [
    "AxialSearch",
    "Progress",
    "SearchOptions",
    "SearchResult",
    "align",
    "axial_search",
    "moved",
    "register",
    "search_window",
    "turned",
]
