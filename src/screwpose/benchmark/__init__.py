"""How good is it? Sets of cases, methods, runs, scoring against the truth. (floor 7)"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.benchmark.methods import METHODS, Method, get_method, register_method
    from screwpose.benchmark.request import BenchRequest, make_request
    from screwpose.benchmark.runner import BenchRun, run_bench
    from screwpose.benchmark.scoring import PoseError, compare, pairing_is_right, pose_error, screw_errors
    from screwpose.benchmark.sets import SETS, BenchmarkSet, get_set
    from screwpose.benchmark.summary import summarise

__all__ = [
    "METHODS",
    "SETS",
    "BenchRequest",
    "BenchRun",
    "BenchmarkSet",
    "Method",
    "PoseError",
    "compare",
    "get_method",
    "get_set",
    "make_request",
    "pairing_is_right",
    "pose_error",
    "register_method",
    "run_bench",
    "screw_errors",
    "summarise",
]

_MODULE_OF = {
    "METHODS": "methods",
    "SETS": "sets",
    "BenchRequest": "request",
    "BenchRun": "runner",
    "BenchmarkSet": "sets",
    "Method": "methods",
    "PoseError": "scoring",
    "compare": "scoring",
    "get_method": "methods",
    "get_set": "sets",
    "make_request": "request",
    "pairing_is_right": "scoring",
    "pose_error": "scoring",
    "register_method": "methods",
    "run_bench": "runner",
    "screw_errors": "scoring",
    "summarise": "summary",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
