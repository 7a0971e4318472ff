"""The house: imports go only downwards, packages say what they export, and banned words stay out."""

import ast
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "screwpose"

FLOORS = {
    "errors": -1,  # below all, also below what is on floor 0 with it
    "_compiling": 0,
    "_progress": 0,
    "_threads": 0,
    "_types": 0,
    "geometry": 1,
    "projection": 1,
    "images": 1,
    "implants": 2,
    "files": 3,
    "similarity": 3,
    "registration": 4,
    "simulation": 4,
    "report": 4,
    "pairing": 5,
    "solve": 6,
    "jobs": 6,
    "benchmark": 7,
    "workbench": 7,
    "cli": 8,
    "__main__": 9,
}
# The simulator must not share its projection, or anything of the solver, with what it is to judge.
NEVER = {"simulation": {"projection", "similarity", "registration", "pairing", "solve"}}
# Floors 1 and 3 hold folders that must not know of each other; the rule below forbids every import within a floor.


def room(path: Path) -> str:
    """The folder or module directly below the package that a file belongs to."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imported_rooms(path: Path) -> set[str]:
    """The rooms that a file imports, at its top or inside its functions."""
    rooms = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import hides where it goes"
            names = [
                f"{node.module}.{alias.name}" if node.module == "screwpose" else node.module or ""
                for alias in node.names
            ]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] == "screwpose" and len(parts) > 1:
                rooms.add(parts[1])
    return rooms


FILES = sorted(SOURCE.rglob("*.py"))


def violations(path: Path, rooms: set[str]) -> list[str]:
    here = room(path)
    return sorted(
        there
        for there in rooms - {here, "__version__"}
        if FLOORS[there] >= FLOORS[here] or there in NEVER.get(here, set())
    )


def test_there_is_something_to_check() -> None:
    assert len(FILES) > 60
    assert {room(path) for path in FILES} - {"__init__"} == set(FLOORS)
    assert "geometry" in imported_rooms(SOURCE / "pairing" / "segment.py")


@pytest.mark.parametrize("path", [p for p in FILES if p.parent != SOURCE or p.stem != "__init__"], ids=str)
def test_imports_go_downwards(path: Path) -> None:
    assert violations(path, imported_rooms(path)) == []


def test_the_check_itself_sees_an_upward_and_a_forbidden_import() -> None:
    assert violations(SOURCE / "geometry" / "camera.py", {"images"}) == ["images"]
    assert violations(SOURCE / "files" / "case.py", {"solve", "geometry"}) == ["solve"]
    assert violations(SOURCE / "simulation" / "xray.py", {"projection", "geometry"}) == ["projection"]


PACKAGES = sorted(path.parent.name for path in SOURCE.glob("*/__init__.py"))


@pytest.mark.parametrize("name", PACKAGES)
def test_every_package_lists_what_it_exports_and_has_it(name: str) -> None:
    package = importlib.import_module(f"screwpose.{name}")
    assert list(package.__all__) == sorted(package.__all__, key=lambda n: (not n.isupper(), not n[0].isupper(), n))
    for exported in package.__all__:
        assert getattr(package, exported) is not None
    assert f"floor {FLOORS[name]}" in (package.__doc__ or "")


def test_no_module_has_grown_past_reading() -> None:
    too_long = {str(path): n for path in FILES if (n := len(path.read_text().splitlines())) > 400}
    assert not too_long
