"""What was asked and answered: case, truth, result and summary files. (floor 3)

The files' keys as models are in `screwpose.files.schema`. The names here are fetched when they are first used, so that
importing this package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from screwpose.files.atomic import (
        atomic_folder,
        ensure_can_write_folder,
        json_text,
        write_bytes,
        write_json,
        write_text,
    )
    from screwpose.files.case import Annotation, Case, View, case_file, inspect_case, read_case
    from screwpose.files.findings import Finding, errors_in, raise_first, warnings_in
    from screwpose.files.publish_schemas import schema_documents
    from screwpose.files.result import (
        CombinationScene,
        PosedImplant,
        Result,
        read_result,
        read_summary,
        write_result,
        write_summary,
    )
    from screwpose.files.strict_json import read_json
    from screwpose.files.truth import read_truth, write_truth

__all__ = [
    "Annotation",
    "Case",
    "CombinationScene",
    "Finding",
    "PosedImplant",
    "Result",
    "View",
    "atomic_folder",
    "case_file",
    "ensure_can_write_folder",
    "errors_in",
    "inspect_case",
    "json_text",
    "raise_first",
    "read_case",
    "read_json",
    "read_result",
    "read_summary",
    "read_truth",
    "schema_documents",
    "warnings_in",
    "write_bytes",
    "write_json",
    "write_result",
    "write_summary",
    "write_text",
    "write_truth",
]

_NAMES_IN = {
    "atomic": (
        "atomic_folder",
        "ensure_can_write_folder",
        "json_text",
        "write_bytes",
        "write_json",
        "write_text",
    ),
    "case": (
        "Annotation",
        "Case",
        "View",
        "case_file",
        "inspect_case",
        "read_case",
    ),
    "findings": (
        "Finding",
        "errors_in",
        "raise_first",
        "warnings_in",
    ),
    "publish_schemas": ("schema_documents",),
    "result": (
        "CombinationScene",
        "PosedImplant",
        "Result",
        "read_result",
        "read_summary",
        "write_result",
        "write_summary",
    ),
    "strict_json": ("read_json",),
    "truth": (
        "read_truth",
        "write_truth",
    ),
}
_MODULE_OF = {name: module for module, names in _NAMES_IN.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
