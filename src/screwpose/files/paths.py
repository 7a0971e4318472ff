"""Paths in a case file: relative to its folder, and never out of it."""

import re
from pathlib import Path, PurePosixPath

from screwpose.errors import CaseError, InputError
from screwpose.files.wording import nearest


def path_inside(folder: Path, name: str, *, case: Path, field: str, kind: type[InputError] = CaseError) -> Path:
    """Find the file that a case names.

    Parameters
    ----------
    folder : the case file's folder.
    name : the path as it stands in the case.
    case, field : where it stands, for the message.
    kind : the error to raise where the file is missing.

    Raises
    ------
    CaseError
        The path is absolute, leaves the folder (by ``..`` or through a link), or is written in another system's way.
    InputError
        Of the given kind: there is no such file.
    """
    _refuse_foreign_spelling(name, case, field)
    given, folder = folder, folder.resolve()
    depth = 0
    for part in PurePosixPath(name).parts:
        depth += -1 if part == ".." else 1
        if depth < 0:
            raise _leaves(name, case, field)
    path = given / name  # messages name places as the caller does
    target = path.resolve()
    if not target.is_relative_to(folder):
        raise _leaves(name, case, field, f" through a link, to {target}")
    if target.is_file():
        return path
    if target.is_dir():
        raise kind(f"`{name}` is a folder", file=case, field=field, expected="a file")
    if target.exists():
        raise kind(f"`{name}` is neither a file nor a folder", file=case, field=field, expected="a file")
    raise kind(f"there is no file `{name}` in {given}", file=case, field=field, remedy=_remedy(path, given))


def _refuse_foreign_spelling(name: str, case: Path, field: str) -> None:
    expected = "a path relative to the case file's folder, with forward slashes"
    if "\0" in name:
        raise CaseError("the path holds a zero character", file=case, field=field, expected=expected)
    if re.match(r"[A-Za-z]:", name):
        remedy = "Copy the file into the case's folder, and leave out the drive."
        raise CaseError(
            f"`{name}` begins with a drive letter", file=case, field=field, expected=expected, remedy=remedy
        )
    if "\\" in name:
        raise CaseError(
            f"`{name}` holds a backslash", file=case, field=field, expected=expected, remedy="Write / instead."
        )
    if name.startswith("/"):
        remedy = "Copy the file into the case's folder, and give its path from there."
        raise CaseError(f"`{name}` is an absolute path", file=case, field=field, expected=expected, remedy=remedy)


def _leaves(name: str, case: Path, field: str, how: str = "") -> CaseError:
    return CaseError(
        f"`{name}` leaves the case's folder{how}",
        file=case,
        field=field,
        expected="a path that stays in it",
        remedy="Copy the file into the case's folder.",
    )


def _remedy(path: Path, folder: Path) -> str:
    """The name that was meant, if one in the same folder is like it."""
    if path.parent.is_dir():
        near = nearest(path.name, (entry.name for entry in path.parent.iterdir() if entry.is_file()))
        if near:
            return f"Is `{(path.parent / near).relative_to(folder)}` meant?"
    return "Paths are relative to the case file's folder."
