"""How good is it? Sets of cases, methods, runs, scoring against the truth. (floor 7)"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.benchmark.capture import CaptureRate, capture_rates, capture_trials
    from screwpose.benchmark.gate import check_against, read_baseline
    from screwpose.benchmark.measures_file import MeasuresFile
    from screwpose.benchmark.methods import METHODS, Method, get_method, register_method
    from screwpose.benchmark.outputs import write_outputs
    from screwpose.benchmark.record import CaseRecord, failed_case, read_record, score_case
    from screwpose.benchmark.request import BenchRequest, make_request
    from screwpose.benchmark.runner import BenchRun, run_bench
    from screwpose.benchmark.scoring import PoseError, compare, pairing_is_right, pose_error, screw_errors
    from screwpose.benchmark.sets import SETS, BenchmarkSet, get_set
    from screwpose.benchmark.strata import Strata, strata_of
    from screwpose.benchmark.summary import summarise

__all__ = [
    "METHODS",
    "SETS",
    "BenchRequest",
    "BenchRun",
    "BenchmarkSet",
    "CaptureRate",
    "CaseRecord",
    "MeasuresFile",
    "Method",
    "PoseError",
    "Strata",
    "capture_rates",
    "capture_trials",
    "check_against",
    "compare",
    "failed_case",
    "get_method",
    "get_set",
    "make_request",
    "pairing_is_right",
    "pose_error",
    "read_baseline",
    "read_record",
    "register_method",
    "run_bench",
    "score_case",
    "screw_errors",
    "strata_of",
    "summarise",
    "write_outputs",
]

_MODULE_OF = {
    "METHODS": "methods",
    "SETS": "sets",
    "BenchRequest": "request",
    "BenchRun": "runner",
    "BenchmarkSet": "sets",
    "CaptureRate": "capture",
    "CaseRecord": "record",
    "MeasuresFile": "measures_file",
    "Method": "methods",
    "PoseError": "scoring",
    "Strata": "strata",
    "capture_rates": "capture",
    "capture_trials": "capture",
    "check_against": "gate",
    "compare": "scoring",
    "failed_case": "record",
    "get_method": "methods",
    "get_set": "sets",
    "make_request": "request",
    "pairing_is_right": "scoring",
    "pose_error": "scoring",
    "read_baseline": "gate",
    "read_record": "record",
    "register_method": "methods",
    "run_bench": "runner",
    "score_case": "record",
    "screw_errors": "scoring",
    "strata_of": "strata",
    "summarise": "summary",
    "write_outputs": "outputs",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
