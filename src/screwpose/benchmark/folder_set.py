"""A folder of one's own cases as a set: each folder in it that holds a case.json with its truth.json."""

import re
from pathlib import Path

from screwpose.benchmark.sets import BenchmarkSet
from screwpose.errors import InputError
from screwpose.files.values import FileModel, Name

_CASE_FILES = ("case.json", "truth.json")


class OwnCases(FileModel):
    """A folder of cases: its place, and the names of the case folders in it, in order."""

    folder: Name
    names: tuple[Name, ...]


def find_cases(folder: str | Path, count: int | None = None) -> OwnCases:
    """The case folders in a folder, by name, or the folder itself where it is one.

    A folder counts that has either file of a case: what is missing or wrong in it is said when it is solved, and the
    case is counted as failed.

    Parameters
    ----------
    count : the first so many; None: all.

    Raises
    ------
    InputError
        There is no such folder, or no case in it.
    """
    place = Path(folder)
    try:
        names = ["."] if _is_case(place) else sorted(one.name for one in place.iterdir() if _is_case(one))
    except OSError as error:
        raise InputError(
            f"the folder cannot be read ({error.strerror})", file=place, field="--cases", remedy="Check the path."
        ) from error
    if not names:
        raise InputError(
            "there is no case in this folder",
            file=place,
            field="--cases",
            expected="folders with a case.json and a truth.json each",
        )
    return OwnCases(folder=str(place.resolve()), names=tuple(names[:count]))


def own_set(cases: OwnCases) -> BenchmarkSet:
    """The set of these cases. They are solved where they lie: nothing is copied."""
    folder = Path(cases.folder)

    def make(_seed: int, index: int, _folder: Path) -> Path:
        return folder / cases.names[index] / "case.json"

    return BenchmarkSet(
        name=f"own-{re.sub('[^A-Za-z0-9_.-]+', '-', folder.name)[:60]}",
        version=1,
        make=make,
        size=len(cases.names),
        origin="the truth.json beside each case",
        description=f"the cases in {folder}",
    )


def _is_case(folder: Path) -> bool:
    return folder.is_dir() and any((folder / name).is_file() for name in _CASE_FILES)
