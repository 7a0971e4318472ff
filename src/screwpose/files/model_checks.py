"""The CAD models of a case: read, and checked with their landmarks."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import MeshError
from screwpose.files.inspection import Inspection
from screwpose.files.schema_case import PartFile
from screwpose.implants.model import Implant, Mesh, Part

# Parts are cut out of the whole, or fit into one another with some play: their common box is the whole's to this.
_PARTS_TOLERANCE_MM = 2.0
_POSSIBLE_MM = (2.0, 1000.0)  # from a marker's ball to a whole construct; what is beyond is in another unit


def read_implants(models: Mapping[str, Mapping[str, Any]], inspection: Inspection) -> dict[str, Implant]:
    """Read the meshes of every model; one that cannot be used is left out, with an error noted.

    Parameters
    ----------
    models : the valid keys of each model of the case file.
    """
    found = {}
    for name, model in models.items():
        where = f"models.{name}"
        mesh = _mesh(model.get("mesh"), model.get("unit"), where, where, inspection)
        parts = _parts(model, where, inspection)
        tip, center = model.get("tip"), model.get("center")
        if mesh is not None:
            landmarks = {name: np.array(at) for name, at in (("tip", tip), ("center", center)) if at is not None}
            fits = _check_scale(mesh, str(model.get("unit")), landmarks, where, inspection)
            _check_mesh(mesh, f"{where}.mesh", fits, inspection)
            _check_parts(mesh, parts, where, inspection)
        if parts and model.get("pivot", ()) is None:
            inspection.warn(
                f"{where}.pivot",
                "the key is missing, and there are parts",
                expected="the point about which they move",
                remedy="Without it the parts are held as they are.",
                kind=MeshError,
            )
        if mesh is None or tip is None or center is None or not fits:
            continue
        tip_mm, center_mm = np.array(tip), np.array(center)
        if _check_landmarks(mesh, tip_mm, center_mm, where, inspection):
            pivot = model.get("pivot")
            found[name] = Implant(name, mesh, tip_mm, center_mm, parts, None if pivot is None else np.array(pivot))
    return found


def _mesh(file: str | None, unit: str | None, where: str, model: str, inspection: Inspection) -> Mesh | None:
    from screwpose.implants.mesh import read_mesh

    path = inspection.file(file, f"{where}.mesh", MeshError)
    if path is None or unit is None:
        return None
    return inspection.attempt(lambda: read_mesh(path, unit), f"{where}.mesh", model)


def _parts(model: Mapping[str, Any], where: str, inspection: Inspection) -> tuple[Part, ...]:
    entries: tuple[PartFile, ...] = model.get("parts") or ()
    names = [part.name for part in entries]
    for index, name in enumerate(names):
        if name in names[:index]:
            inspection.error(
                f"{where}.parts[{index}].name",
                f'"{name}" is the name of another part of this model',
                expected="each name once",
                remedy="Rename one of them.",
            )
    parts = []
    for index, part in enumerate(entries):
        mesh = _mesh(part.mesh, model.get("unit"), f"{where}.parts[{index}]", where, inspection)
        if mesh is not None:
            parts.append(Part(part.name, mesh))
    return tuple(parts)


def _check_scale(
    mesh: Mesh, unit: str, landmarks: Mapping[str, FloatArray], where: str, inspection: Inspection
) -> bool:
    """Whether the mesh can be an implant's at all, and its landmarks be on it; if not, the unit is the usual reason."""
    from screwpose.implants.health import SCREW_MM, principal_length_mm
    from screwpose.implants.mesh import MM_PER_UNIT

    length_mm = principal_length_mm(mesh)
    low, high = mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)
    off_mm = {name: np.linalg.norm(np.maximum(0, np.maximum(low - at, at - high))) for name, at in landmarks.items()}
    farthest = max(off_mm, key=lambda name: off_mm[name], default="")
    said = f"the mesh is {length_mm:.4g} mm long, read as `{unit}`"
    # A landmark a little off the mesh may be a guess; one further off than the mesh is long is of another scale.
    if farthest and off_mm[farthest] > max(length_mm, 1.0):
        said += f", and the {farthest} {landmarks[farthest].tolist()} lies {off_mm[farthest]:.4g} mm outside of it"
    elif _POSSIBLE_MM[0] <= length_mm <= _POSSIBLE_MM[1]:
        return True
    length = length_mm / MM_PER_UNIT[unit]
    others = [
        f"as `{other}` it would be {length * mm:.4g} mm long"
        for other, mm in MM_PER_UNIT.items()
        if other != unit and SCREW_MM[0] <= length * mm <= SCREW_MM[1]
    ]
    fits = SCREW_MM[0] <= length_mm <= SCREW_MM[1]
    if fits and farthest:
        remedy = f"Give tip and center in mm, in the frame of the mesh: it spans {_box(low)} to {_box(high)}."
    elif others:
        remedy = f"Set the mesh's unit: {', '.join(others)}. Tip and center stand in mm, whatever it is."
    else:
        remedy = "Is it the right file?"
    inspection.error(
        f"{where}.{farthest if fits and farthest else 'unit'}",
        said,
        expected=f"a screw of {SCREW_MM[0]:g} to {SCREW_MM[1]:g} mm, and landmarks on it",
        remedy=remedy,
        kind=MeshError,
    )
    return False


def _box(corner: FloatArray) -> str:
    return "[" + ", ".join(f"{x:.4g}" for x in corner) + "]"


def _check_mesh(mesh: Mesh, where: str, is_of_scale: bool, inspection: Inspection) -> None:
    """Note what is wrong with the mesh; its size only where that has not been refused."""
    from screwpose.implants.health import mesh_report, scale_problems

    report = mesh_report(mesh)
    for problem in report.problems:
        if is_of_scale or problem not in scale_problems(report.length_mm):
            inspection.warn(where, str(problem).rstrip("."), kind=MeshError)


def _check_parts(mesh: Mesh, parts: tuple[Part, ...], where: str, inspection: Inspection) -> None:
    if not parts:
        return
    corners = np.vstack([part.mesh.vertices_mm for part in parts])
    apart = max(
        float(np.abs(corners.min(axis=0) - mesh.vertices_mm.min(axis=0)).max()),
        float(np.abs(corners.max(axis=0) - mesh.vertices_mm.max(axis=0)).max()),
    )
    if apart > _PARTS_TOLERANCE_MM:
        inspection.warn(
            f"{where}.parts",
            f"the parts together and the whole mesh differ by up to {apart:.3g} mm in where they begin and end",
            expected=f"at most {_PARTS_TOLERANCE_MM:g} mm",
            remedy="Are all parts there, in the CAD frame and the unit of the whole mesh?",
            kind=MeshError,
        )


def _check_landmarks(mesh: Mesh, tip_mm: FloatArray, center_mm: FloatArray, where: str, inspection: Inspection) -> bool:
    """Whether the landmarks can be used."""
    from screwpose.implants.landmarks import check_landmarks

    if not np.linalg.norm(center_mm - tip_mm) > 0:
        inspection.error(
            f"{where}.center",
            f"it is the same point as the tip, {tip_mm.tolist()}",
            expected="two points on the screw's axis",
            remedy="`screwpose model inspect FILE` proposes landmarks for a mesh.",
            kind=MeshError,
        )
        return False
    if _is_upside_down(mesh, tip_mm, center_mm):
        inspection.error(
            f"{where}.tip",
            f"tip {tip_mm.tolist()} and center {center_mm.tolist()} look swapped: the mesh ends at the center, and "
            "goes on beyond the tip",
            expected="the tip at the pointed end, the center in the middle of the shank",
            remedy="Let them change places.",
            kind=MeshError,
        )
        return False
    for problem in check_landmarks(mesh, tip_mm, center_mm):
        inspection.warn(where, problem.rstrip("."), kind=MeshError)
    return True


def _is_upside_down(mesh: Mesh, tip_mm: FloatArray, center_mm: FloatArray) -> bool:
    """Whether the centre is an end of the mesh and the tip is not, by more than any guess of a tip is off."""
    length_mm = float(np.linalg.norm(center_mm - tip_mm))
    along_mm = (mesh.vertices_mm - tip_mm) @ (center_mm - tip_mm) / length_mm
    before_mm, behind_mm = -float(along_mm.min()), float(along_mm.max()) - length_mm
    return before_mm > 0.5 * length_mm and behind_mm < 0.1 * length_mm
