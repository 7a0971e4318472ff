"""What becomes of files that a person gives: each is read in a process of its own, and finds its place in the case."""

import itertools
import json
from pathlib import Path
from typing import Any, TypeAlias

from screwpose.errors import InputError, ScrewposeError
from screwpose.files.atomic import write_bytes
from screwpose.files.calibration import LONGEST_TEXT, read_calibration
from screwpose.files.schema import CASE_FORMAT
from screwpose.workbench import draft as drafts
from screwpose.workbench.session import Session
from screwpose.workbench.sessions import Sessions
from screwpose.workbench.store import safe_file_name
from screwpose.workbench.uploading import Uploaded

Told: TypeAlias = dict[str, str]  # level and text

_LONGEST_CASE = 2 * 2**20


async def take_in(sessions: Sessions, session: Session, files: list[Uploaded], view: str | None = None) -> list[Told]:
    """Put files into a case.

    Parameters
    ----------
    view : the view that images and calibrations are for; None: what their names say.

    Returns
    -------
    What a person must be told, as `check` tells it: what could not be used, and what was replaced.
    """
    told = []
    models: set[str] = set()
    for file in files:
        try:
            unit = _unit(session, file)
            arguments: dict[str, object] = {"path": str(file.path), "name": file.name, "unit": unit}
            found = await sessions.helped("identify", arguments)
            assert isinstance(found, dict)
            if found["kind"] == "mesh":
                _place_mesh(session, file, found, unit, models)
            else:
                notes = _place(session, file, found, view)
                told += [{"level": "warning", "text": f"{file.name}: {note}"} for note in notes]
        except ScrewposeError as error:
            told.append({"level": "error", "text": f"{file.name}: {error}"})
    return told


def _place(session: Session, file: Uploaded, found: dict[str, Any], view: str | None) -> list[str]:
    before = session.store.draft["views"]
    if found["kind"] == "image":
        name = _kept(session, file, Path(), "image")
        now = session.store.draft
        session.change(drafts.with_image(now, view or drafts.free_view(now, file.name), name))
    else:
        _place_text(session, file.name, found["text"], view)
    now = session.store.draft["views"]
    return [
        f"the calibration of {name} was replaced: is it of this view? Undo brings the one before back."
        for name, one in before.items()
        if "projection" in one and now.get(name, {}).get("projection") != one["projection"]
    ]


def _kept(session: Session, file: Uploaded, folder: Path, otherwise: str) -> str:
    """Copy a file into the case under a name that is free; its path in the case."""
    name = Path(safe_file_name(file.name, otherwise))
    data = file.path.read_bytes()
    place = session.store.folder / folder
    place.mkdir(exist_ok=True)
    for number in range(1, 1000):
        path = place / (name.name if number == 1 else f"{name.stem}-{number}{name.suffix}")
        if path.name in ("case.json", "workbench.json") or (path.exists() and path.read_bytes() != data):
            continue
        if not path.exists():
            write_bytes(path, data)
        return (folder / path.name).as_posix()
    raise InputError(f"a thousand files of the name {name} are there already")


def _place_mesh(session: Session, file: Uploaded, found: dict[str, Any], unit: str, brought: set[str]) -> None:
    """A model of the file's name, or its new mesh; those that the same drop `brought` it does not replace."""
    mesh = _kept(session, file, Path("models"), "model")
    stem, models = _model_name(file.name), session.store.draft["models"]
    names = (stem if number == 1 else f"{stem}-{number}" for number in itertools.count(1))
    name = next(
        one for one in names if models.get(one, {}).get("mesh", mesh) == mesh or (one == stem and one not in brought)
    )
    brought.add(name)
    known = models.get(name, {})
    is_other = _is_other(session.store.folder, known.get("mesh"), mesh)
    # Tip and centre of another mesh would be wrong without a word: missing ones are told.
    own = {key: value for key, value in known.items() if not (is_other and key in ("tip", "center"))}
    proposed = {key: found[key] for key in ("tip", "center") if found[key] is not None and key not in own}
    if proposed:
        session.notes_of_models[name] = [f"Landmarks proposed: {found['confidence']}.", *found["notes"]]
    elif is_other:
        session.notes_of_models[name] = list(found["notes"])
    session.change(drafts.with_model(session.store.draft, name, {**own, **proposed, "mesh": mesh, "unit": unit}))


def _model_name(file_name: str) -> str:
    return Path(safe_file_name(file_name, "model")).stem


def _unit(session: Session, file: Uploaded) -> str:
    """What one unit of a mesh is, where its model is known. A STEP file says it itself."""
    if Path(file.name).suffix.lower() in (".step", ".stp"):
        return "mm"
    return str(session.store.draft["models"].get(_model_name(file.name), {}).get("unit", "mm"))


def _is_other(folder: Path, before: Any, now: str) -> bool:
    """Whether a model had another mesh before; one that is not there any more may be the same."""
    file = folder / str(before)
    return before is not None and file.is_file() and file.read_bytes() != (folder / now).read_bytes()


def _place_text(session: Session, name: str, text: str, view: str | None) -> None:
    if CASE_FORMAT in text[:4000] and text.lstrip().startswith("{"):
        _place_case(session, text)
        return
    if len(text) > LONGEST_TEXT:
        raise InputError("the text is too long for a calibration")
    now = session.store.draft
    if view is None:
        free = [
            one for one in (*drafts.CUSTOMARY_VIEWS, *now["views"]) if "projection" not in now["views"].get(one, {})
        ]
        view = drafts.named_view(name) or (free[0] if free else drafts.CUSTOMARY_VIEWS[0])
    session.change(drafts.with_projection(now, view, read_calibration(text)))


def _place_case(session: Session, text: str) -> None:
    """The calibrations and the models' landmarks of a case file; its marks are for a person to make."""
    if len(text) > _LONGEST_CASE:
        raise InputError("the case file is too long")
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"the case file cannot be read ({error})") from error
    now = session.store.draft
    for view, entry in _objects(data.get("views")):
        if "projection" in entry:
            now = drafts.with_projection(now, str(view)[:80], read_calibration(json.dumps(entry["projection"])))
        if entry.get("polarity") in ("metal-dark", "metal-bright"):
            now = drafts.with_view_key(now, str(view)[:80], "polarity", entry["polarity"])
    for name, entry in _objects(data.get("models")):
        kept: dict[str, Any] = {key: entry[key] for key in ("unit", "tip", "center", "pivot") if key in entry}
        stem = Path(safe_file_name(str(entry.get("mesh", name)), "model")).stem
        old = now["models"].get(stem, {})
        now = drafts.with_model(now, stem, {**old, **kept})
    session.change(now)


def _objects(data: Any) -> list[tuple[str, dict[str, Any]]]:
    return [(key, one) for key, one in data.items() if isinstance(one, dict)] if isinstance(data, dict) else []
