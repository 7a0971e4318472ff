"""The package's door: its names, and that it opens quickly."""

import subprocess
import sys

import pytest

import screwpose.files


def test_every_public_name_is_there():
    assert sorted(screwpose.files.__all__) == [
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
    for name in screwpose.files.__all__:
        assert getattr(screwpose.files, name).__name__ == name


def test_other_names_are_refused():
    with pytest.raises(AttributeError, match=r"module 'screwpose\.files' has no attribute 'nothing'"):
        _ = screwpose.files.nothing


def test_importing_it_loads_nothing_slow():
    program = "import sys, screwpose.files; print([m for m in ('pydantic', 'numpy', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_reading_modules_leave_the_slow_libraries_for_later():
    program = "import sys, screwpose.files.case; print([m for m in ('trimesh', 'cv2', 'pydicom') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
