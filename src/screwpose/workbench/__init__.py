"""How does a person drive it? A local server, and a page in the browser. (floor 7)

The names are fetched when they are first used, so that importing this package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.workbench.server import serve

__all__ = ["serve"]

_MODULE_OF = {"serve": "server"}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
