"""How good is it? Sets of cases, scoring against the truth, studies. (floor 7)"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.benchmark.scoring import PoseError, compare, pairing_is_right, pose_error, screw_errors
    from screwpose.benchmark.sets import SETS, BenchmarkSet, get_set
    from screwpose.benchmark.study import Study, run_study, summarise
    from screwpose.benchmark.writing import write_study

__all__ = [
    "SETS",
    "BenchmarkSet",
    "PoseError",
    "Study",
    "compare",
    "get_set",
    "pairing_is_right",
    "pose_error",
    "run_study",
    "screw_errors",
    "summarise",
    "write_study",
]

_MODULE_OF = {
    "SETS": "sets",
    "BenchmarkSet": "sets",
    "PoseError": "scoring",
    "Study": "study",
    "compare": "scoring",
    "get_set": "sets",
    "pairing_is_right": "scoring",
    "pose_error": "scoring",
    "run_study": "study",
    "screw_errors": "scoring",
    "summarise": "study",
    "write_study": "writing",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
