"""The package and the program start quickly: slow libraries are imported where they are used."""

import subprocess
import sys

import pytest

SLOW = (
    "trimesh",
    "cv2",
    "matplotlib",
    "scipy.optimize",
    "scipy.stats",
    "pydicom",
    "manifold3d",
    "tifffile",
    "cascadio",
    "numpy",
    "numba",
    "llvmlite",
    "jinja2",
    "fast_simplification",
    "asyncio",
)
_LIST = f"import sys; print([name for name in {SLOW!r} if name in sys.modules])"


def python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return done.stdout


def test_the_list_can_see_a_slow_import() -> None:
    assert python(f"import scipy.optimize; {_LIST}").strip() == "['scipy.optimize', 'numpy']"


def test_importing_the_package_imports_nothing_slow() -> None:
    assert python(f"import screwpose; {_LIST}").strip() == "[]"


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["solve", "--help"]])
def test_help_imports_nothing_slow(arguments: list[str]) -> None:
    code = f"""
from screwpose.cli import app
try:
    app({arguments!r})
except SystemExit as leaving:
    assert leaving.code == 0, leaving.code
{_LIST}
"""
    assert python(code).splitlines()[-1] == "[]"
