"""A case on disk as the workbench keeps it: an ordinary case folder, saved whole after every action."""

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from screwpose.errors import CaseError, OutputError
from screwpose.files.atomic import json_text, write_json, write_text
from screwpose.files.strict_json import read_json
from screwpose.files.wording import read_model
from screwpose.workbench.claim import Claim
from screwpose.workbench.draft import Draft, empty_draft
from screwpose.workbench.side_file import SIDE_FORMAT, SIDE_NAME, SideFile

RESULT_FOLDER = "result"  # what the solver found, and the person's choice of it
REPORT_FOLDER = "report"  # the same as `screwpose solve` writes it
_MOST_UNDONE = 60  # each is a whole case, some kB, and all are written with every action
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
_LONGEST_NAME = 60
# Names that Windows keeps for devices, whatever follows the point.
_DEVICES = {"con", "prn", "aux", "nul", *(f"{one}{n}" for one in ("com", "lpt") for n in range(1, 10))}


def safe_file_name(name: str, otherwise: str = "file") -> str:
    """A file name that is one on every system and leaves no folder: letters, digits, ``. _ -``, none of them first."""
    plain = _UNSAFE.sub("-", name.replace("\\", "/").rsplit("/", 1)[-1]).strip("-.")[-_LONGEST_NAME:].strip("-.")
    if not plain or plain.split(".")[0].lower() in _DEVICES:
        return f"{otherwise}-{plain}".strip("-")
    return plain


class CaseStore:
    """One case folder: its draft with what can be undone, and the side file.

    Raises
    ------
    CaseError
        There is no case.json, or it is no JSON object.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / "case.json"
        self.claim = Claim(folder)
        self.reread()

    def reread(self) -> None:
        """Go on with what is on the disk now."""
        self.draft, self.side = _read_draft(self.file), _read_side(self.folder / SIDE_NAME)
        self._on_disk = _digest_of_file(self.file)
        self._side_on_disk = _digest_of_file(self.folder / SIDE_NAME)
        self.side = self.side.model_copy(update=_found_in(self.side, self.draft))

    @classmethod
    def created(cls, workspace: Path, name: str) -> "CaseStore":
        """A new folder in the workspace with an empty case; the name gets a number where it is taken.

        Raises
        ------
        OutputError
            The folder cannot be made.
        """
        base = safe_file_name(name, "case")
        try:
            workspace.mkdir(parents=True, exist_ok=True)
            for number in range(1, 10_000):
                folder = workspace / (base if number == 1 else f"{base}-{number}")
                try:
                    folder.mkdir()
                except FileExistsError:
                    continue
                write_json(folder / "case.json", empty_draft(folder.name))
                return cls(folder)
        except OSError as error:
            raise OutputError(f"{workspace}: no case can be made here: {error.strerror}") from error
        raise OutputError(f"{workspace}: ten thousand cases of the name {base} are there already")

    @property
    def digest(self) -> str:
        """Of what the answer depends on, as it is now."""
        return hashlib.sha256(json.dumps(self.draft, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def is_stale(self) -> bool:
        """Whether the case was changed since it was solved here."""
        return self.side.solved_from not in (None, self.digest)

    @property
    def is_changed_elsewhere(self) -> bool:
        """Whether another program wrote the case, or what belongs to it, since it was read."""
        side = _digest_of_file(self.folder / SIDE_NAME)
        return _digest_of_file(self.file) != self._on_disk or side != self._side_on_disk

    @property
    def can_undo(self) -> bool:
        """Whether there is an action to take back."""
        return self.side.now > 0

    @property
    def can_redo(self) -> bool:
        """Whether there is an action to do again."""
        return self.side.now + 1 < len(self.side.history)

    def change(self, draft: Draft) -> None:
        """Save a changed case; the one before can be brought back."""
        if draft == self.draft:
            return
        history = (*self.side.history[: self.side.now + 1], draft)[-_MOST_UNDONE:]
        self._go_to(history, len(history) - 1)

    def undo(self) -> bool:
        """Bring back the case before the last action; False where there is none."""
        if not self.can_undo:
            return False
        self._go_to(self.side.history, self.side.now - 1)
        return True

    def redo(self) -> bool:
        """Do again what was undone last; False where nothing was."""
        if not self.can_redo:
            return False
        self._go_to(self.side.history, self.side.now + 1)
        return True

    def change_side(self, **changes: Any) -> None:
        """Save changed keys of the side file."""
        with self.claim.held():
            self._ensure_ours()
            self._write_side(changes)

    def _go_to(self, history: tuple[Draft, ...], now: int) -> None:
        """Save a case of the history. The history is written before it, and holds the case that the disk still has as
        well as the one to come: whichever is there after a power cut is found in it."""
        with self.claim.held():
            self._ensure_ours()
            before, text = self.side, json_text(history[now]) + "\n"
            self._write_side({"history": history, "now": now})
            try:
                write_text(self.file, text)
            except OutputError:
                self.side = before
                raise
            self._on_disk = hashlib.sha256(text.encode()).hexdigest()
            self.draft = history[now]

    def _write_side(self, changes: dict[str, Any]) -> None:
        side = self.side.model_copy(update=changes)
        write_json(self.folder / SIDE_NAME, side)
        self.side, self._side_on_disk = side, _digest_of_file(self.folder / SIDE_NAME)

    def _ensure_ours(self) -> None:
        """What another program wrote since it was read is not written over."""
        if self.is_changed_elsewhere:
            raise OutputError(
                f"{self.folder}: another program changed the case since it was opened here. Nothing was overwritten: "
                "reload the page to go on with the case as it is now."
            )


def _found_in(side: SideFile, draft: Draft) -> dict[str, Any]:
    """The history with the place that the case on the disk has in it, the nearest to the last one known; where it is
    another program's case, one that begins with it."""
    places = [place for place, one in enumerate(side.history) if one == draft]
    if not places:
        return {"history": (draft,), "now": 0}
    return {"now": min(places, key=lambda place: abs(place - side.now))}


def _read_draft(file: Path) -> Draft:
    data = read_json(file)
    if not isinstance(data, dict):
        raise CaseError("the file holds no object", file=file, expected="a case, as docs/files.md describes it")
    parts = {key: _objects(data.get(key)) for key in ("views", "models")}
    lists = data.get("annotations") if isinstance(data.get("annotations"), dict) else {}
    marks = {view: [one for one in ones if _is_mark(one)] for view, ones in (lists or {}).items() if _is_list(ones)}
    return {**data, **parts, "annotations": marks}


def _objects(value: Any) -> Draft:
    """Of named objects those that are: the rest is for `check` to name."""
    return {key: one for key, one in value.items() if isinstance(one, dict)} if isinstance(value, dict) else {}


def _is_list(value: Any) -> bool:
    return isinstance(value, list)


def _is_mark(one: Any) -> bool:
    """Whether an annotation can be drawn; what cannot is for `check` to name, and not shown."""
    try:
        return all(len([float(x) for x in one[key]]) == 2 for key in ("tip", "center")) and isinstance(
            one["label"], str
        )
    except (KeyError, TypeError, ValueError):
        return False


def _read_side(file: Path) -> SideFile:
    if not file.exists():
        return SideFile()
    return read_model(file, SideFile, SIDE_FORMAT)


def _digest_of_file(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""
