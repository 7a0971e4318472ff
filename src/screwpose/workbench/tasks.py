"""What a child process can be asked to do; each task is ``task(tell, **arguments)``, all of it as JSON."""

import base64
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from screwpose.errors import CaseError, InputError
from screwpose.workbench import store
from screwpose.workbench.looking import look
from screwpose.workbench.reviewing import nudge, review

Tell = Callable[[float, str], None]

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".stp", ".step")
TEXT_SUFFIXES = (".json", ".txt", ".csv", ".dat")
IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".dcm", ".ima", ".dicom", "")


def identify(_tell: Tell, path: str, name: str, unit: str) -> dict[str, Any]:
    """Read an uploaded file for the first time: an X-ray, a CAD model (with a proposal of its landmarks), or a text."""
    suffix = Path(name).suffix.lower()
    try:
        if suffix in MESH_SUFFIXES:
            return _mesh(Path(path), unit)
        if suffix in TEXT_SUFFIXES:
            return {"kind": "text", "text": _text(Path(path))}
        if suffix not in IMAGE_SUFFIXES:
            raise InputError(
                f"`{suffix}` is no kind of file that a case has",
                expected=", ".join(one for one in IMAGE_SUFFIXES + MESH_SUFFIXES + TEXT_SUFFIXES if one),
            )
        return _image(Path(path))
    except InputError as error:
        error.file = None  # the file's own name is said by who asked
        raise InputError(str(error).rstrip(".")) from error


def _image(path: Path) -> dict[str, Any]:
    from screwpose.images import read_radiograph

    width, height = read_radiograph(path).size
    return {"kind": "image", "width": width, "height": height}


def _mesh(path: Path, unit: str) -> dict[str, Any]:
    from screwpose.implants import mesh_report, propose_landmarks, read_mesh

    mesh = read_mesh(path, unit)
    proposal = propose_landmarks(mesh)
    tip, center = proposal.tip_mm, proposal.center_mm
    return {
        "kind": "mesh",
        "tip": None if tip is None else [round(float(x), 4) for x in tip],
        "center": None if center is None else [round(float(x), 4) for x in center],
        "confidence": proposal.confidence,
        "notes": list(proposal.notes),
        "faces": mesh_report(mesh).faces,
    }


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise CaseError("it is no text in UTF-8") from error


def solve_case(
    tell: Tell, folder: str, pairs: list[dict[str, str]] | None, poses: list[dict[str, Any]], reason: str | None
) -> dict[str, Any]:
    """Solve a case as `screwpose solve` does, with its defaults; the result goes into the case's folder.

    Parameters
    ----------
    pairs : the pairing that a person holds to; None: the solver's own.
    poses : where screws begin, ``{"labels": ..., "world_from_cad": ...}``.
    reason : why that pairing was chosen.
    """
    from screwpose.files.atomic import atomic_folder
    from screwpose.files.case import read_case
    from screwpose.files.scenes import read_solved, write_solved
    from screwpose.jobs import saying_that_it_compiles
    from screwpose.pairing.holding import HeldScrew
    from screwpose.pairing.merging import beside_others
    from screwpose.solve import SolveOptions, solve

    tell(0.0, "reading the case")
    case = read_case(folder)
    place = Path(folder) / store.RESULT_FOLDER
    is_stale = store.CaseStore(Path(folder)).is_stale  # what was scored then cannot stand beside what is scored now
    held = before = None
    if pairs is not None:
        before = read_solved(place) if (place / "result.json").exists() else None
        models = {} if before is None else {_key(one.labels): one.model for one in before.answer.screws}
        begun = {_key(one["labels"]): np.array(one["world_from_cad"]) for one in poses}
        # A pose by hand is of the model that the result has there.
        held = tuple(
            HeldScrew(one, begun.get(_key(one)), models.get(_key(one)) if _key(one) in begun else None) for one in pairs
        )
    result = solve(case, SolveOptions(held=held), saying_that_it_compiles(tell))
    if held is not None and result.answer.status != "refused":
        result = beside_others(result, None if is_stale else before, reason)
    with atomic_folder(place) as partial:
        write_solved(partial, result)
    return {"status": result.answer.status}


def _key(labels: Mapping[str, str]) -> frozenset[tuple[str, str]]:
    return frozenset(labels.items())


def simulate(tell: Tell, workspace: str, seed: int) -> str:
    """Make the demo case; its folder's name is returned."""
    from screwpose.simulation.scenes import two_screw_scene
    from screwpose.simulation.writing import write_case

    tell(0.1, "X-raying a simulated patient with two pedicle screws")
    scene = two_screw_scene(seed, landmark_noise_px=1.5, image_size=(1024, 1024))
    names = ("demo" if number == 1 else f"demo-{number}" for number in range(1, 10_000))
    folder = next(place for place in (Path(workspace) / name for name in names) if not place.exists())
    tell(0.9, "writing the case")
    write_case(scene, folder)
    return folder.name


def paint_mask(_tell: Tell, folder: str, view: str, strokes: list[dict[str, Any]], name: str) -> str:
    """Paint what does not count into the view's mask M_bg, or erase from it; the new mask's path in the case.

    Parameters
    ----------
    strokes : ``{"points": [[u, v], ...], "radius": px, "counts": whether what is painted counts from now on}``.
    name : of the file in ``masks/``.
    """
    import cv2

    from screwpose.files.atomic import write_bytes
    from screwpose.files.strict_json import read_json
    from screwpose.images import encode_png, field_of_view, read_mask, read_radiograph

    entry = read_json(Path(folder) / "case.json")["views"][view]
    radiograph = read_radiograph(Path(folder) / entry["image"], entry.get("polarity", "auto"))
    given = entry.get("mask")
    mask = field_of_view(radiograph) if given is None else read_mask(Path(folder) / given, radiograph.size)
    painted = mask.astype(np.uint8)
    for stroke in strokes:
        points = np.rint(np.array(stroke["points"], dtype=np.float64) * 16).astype(np.int32).reshape(-1, 1, 2)
        width = max(1, round(2 * float(stroke["radius"])))
        value = int(bool(stroke["counts"]))
        cv2.polylines(painted, [points], False, value, width, cv2.LINE_8, 4)
        for point in (points[0, 0], points[-1, 0]):
            cv2.circle(painted, [int(x) for x in point], width * 8, value, -1, cv2.LINE_8, 4)
    if not painted.any():
        raise InputError("nothing of the X-ray would count any more", remedy="Erase less.")
    path = Path(folder) / "masks" / name
    path.parent.mkdir(exist_ok=True)
    write_bytes(path, encode_png(painted.astype(np.bool_)))
    return f"masks/{name}"


def export(tell: Tell, folder: str) -> list[str]:
    """Write the report's folder as `screwpose solve` writes it; the names of its files are returned."""
    from screwpose.files.atomic import atomic_folder
    from screwpose.files.case import read_case
    from screwpose.files.scenes import read_solved
    from screwpose.report import write_report

    place = Path(folder) / store.REPORT_FOLDER
    case, result = read_case(folder), read_solved(Path(folder) / store.RESULT_FOLDER)
    with atomic_folder(place) as partial:
        write_report(partial, case, result, None, tell)
        if (partial / "meshes").is_dir():
            shutil.make_archive(str(partial / "meshes"), "zip", partial, "meshes")
    return sorted(path.relative_to(place).as_posix() for path in place.rglob("*") if path.is_file())


def spend(_tell: Tell, megabytes: int) -> int:
    """Ask for memory, for the test of the limit."""
    return len(base64.b64encode(bytes(megabytes * 2**20)))


TASKS: dict[str, Callable[..., Any]] = {
    "identify": identify,
    "look": look,
    "solve": solve_case,
    "review": review,
    "nudge": nudge,
    "simulate": simulate,
    "paint": paint_mask,
    "export": export,
    "spend": spend,
}
