"""The folder that holds the cases, and what `screwpose open` was given."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from urllib.parse import quote

from screwpose.errors import CaseError

_MOST_LISTED = 200


@dataclass(frozen=True)
class Listed:
    """A case of the workspace: its key is its folder's name."""

    key: str
    changed: datetime
    is_solved: bool


@dataclass(frozen=True)
class Workspace:
    """Where cases are; `first` is the key of the one to open."""

    folder: Path
    first: str | None = None

    def cases(self) -> list[Listed]:
        """The cases, the one that was changed last first."""
        found = []
        for file in self.folder.glob("*/case.json"):
            times = [one.stat().st_mtime for one in (file, file.with_name("workbench.json")) if one.exists()]
            when = datetime.fromtimestamp(max(times)).astimezone()
            found.append(Listed(file.parent.name, when, (file.parent / "result" / "result.json").exists()))
        return sorted(found, key=lambda one: one.changed, reverse=True)[:_MOST_LISTED]

    def folder_of(self, key: str) -> Path:
        """The folder of a case.

        Raises
        ------
        CaseError
            The workspace has no case of this name: a key is a name among those that are there, never a path.
        """
        if key in {file.parent.name for file in self.folder.glob("*/case.json")}:
            return self.folder / key
        raise CaseError(
            f"there is no case of the name {key[:80]!r} here", remedy="The start page lists those there are."
        )


def address_of(key: str, export: str | None = None) -> str:
    """The path of a case's page, or of one of its exports: a folder's name may have characters that end a path."""
    name = quote(key, safe="")
    return f"/case/{name}" if export is None else f"/export/{name}/{export}"


def workspace_of(path: Path | None) -> Workspace:
    """What a path means: a case (its folder, or its case.json), or a folder of cases; none: a folder of the user's own.

    Raises
    ------
    CaseError
        There is nothing of the kind.
    """
    if path is None:
        return Workspace(Path.home() / "screwpose-cases")
    place = path.resolve()
    if place.is_file():
        if place.name != "case.json":
            raise CaseError("the workbench opens a folder with a case.json in it", file=path)
        place = place.parent
    if (place / "case.json").is_file():
        return Workspace(place.parent, place.name)
    if place.exists() and not place.is_dir():
        raise CaseError("it is neither a case nor a folder", file=path)
    return Workspace(place)
