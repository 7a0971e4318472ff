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
        if mesh is not None:
            _check_mesh(mesh, f"{where}.mesh", inspection)
            _check_parts(mesh, parts, where, inspection)
        if parts and model.get("pivot", ()) is None:
            inspection.warn(
                f"{where}.pivot",
                "the key is missing, and there are parts",
                expected="the point about which they move",
                remedy="Without it the parts are held as they are.",
                kind=MeshError,
            )
        tip, center = model.get("tip"), model.get("center")
        if mesh is None or tip is None or center is None:
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


def _check_mesh(mesh: Mesh, where: str, inspection: Inspection) -> None:
    from screwpose.implants.health import mesh_report

    for problem in mesh_report(mesh).problems:
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
    for problem in check_landmarks(mesh, tip_mm, center_mm):
        inspection.warn(where, problem.rstrip("."), kind=MeshError)
    return True
