"""Meshes from files and to files, moved and reduced."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError, OutputError
from screwpose.implants import formats
from screwpose.implants.formats.stl import BINARY_FACET, HEADER_BYTES
from screwpose.implants.model import Mesh

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
_READERS: dict[str, Callable[[Path, bytes], tuple[FloatArray, IntArray]]] = {
    ".stl": formats.read_stl,
    ".obj": formats.read_obj,
    ".ply": formats.read_ply,
    ".vtk": formats.read_vtk,
    ".step": formats.read_step,
    ".stp": formats.read_step,
}
SUFFIXES = tuple(_READERS)


def read_mesh(path: str | Path, unit: str = "mm") -> Mesh:
    """Read a mesh: STL (binary, ASCII), OBJ, PLY, legacy VTK or STEP, chosen by the file's suffix.

    Polygons are split into triangles, vertices of equal coordinates become one, unused ones go. Nothing is repaired:
    :func:`~screwpose.implants.health.mesh_report` says what is wrong.

    Parameters
    ----------
    path : the file.
    unit : ``mm``, ``cm``, ``m`` or ``inch``: what one unit of the file is. STEP files state their own: leave ``mm``.

    Returns
    -------
    In mm, in the frame of the file.

    Raises
    ------
    MeshError
        Missing, unreadable, truncated, empty, with a coordinate that is not finite, or of an unknown suffix or unit.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise MeshError(
            f"'{path.suffix}' is no mesh format that can be read",
            file=path,
            expected=" ".join(SUFFIXES),
            remedy="Export the model as STL.",
        )
    mm_per_unit = _mm_per_unit(path, unit)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(f"the mesh cannot be read ({error.strerror})", file=path, expected="a readable file") from error
    if not data:
        raise MeshError("the mesh file is empty (0 bytes)", file=path, remedy="Export or copy it again.")
    vertices, faces = _READERS[suffix](path, data)
    if not len(faces):
        raise MeshError(
            "the mesh has no faces", file=path, expected="triangles or polygons", remedy="Export its surface."
        )
    bad = np.flatnonzero(~np.isfinite(vertices[faces]).all(axis=(1, 2)))
    if len(bad):
        raise MeshError(
            f"{len(bad)} of {len(faces)} faces have a coordinate that is not finite, the first is face {bad[0]}",
            file=path,
            remedy="Export it again: the file is damaged or its writer is.",
        )
    mesh = merged(vertices, faces)
    return Mesh(mesh.vertices_mm * mm_per_unit, mesh.faces)


def write_stl(mesh: Mesh, path: str | Path) -> None:
    """Write a binary STL in mm, in one step: a reader sees the whole file or the old one.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    corners = mesh.triangles_mm
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets = np.zeros(len(corners), dtype=BINARY_FACET)
    facets["normal"] = normals / np.where(lengths > 0.0, lengths, 1.0)
    facets["corners"] = corners
    header = b"binary STL, mm".ljust(HEADER_BYTES)  # must not begin with 'solid', the mark of ASCII
    write_bytes(Path(path), header + len(facets).to_bytes(4, "little") + facets.tobytes())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file in one step: a reader sees the whole of it or the one that was there before.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    temporary = None
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            temporary = Path(file.name)
            file.write(data)
        temporary.chmod(0o644)  # a temporary file is born private
        os.replace(temporary, path)  # noqa: PTH105  (the one call that is atomic on every platform)
    except OSError as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        raise OutputError(f"{path}: the file cannot be written ({error.strerror}).") from error


def transformed(mesh: Mesh, target_from_source: FloatArray) -> Mesh:
    """Move a mesh by a rigid (4, 4) matrix, mm; faces are shared with the source."""
    rotation, translation = target_from_source[:3, :3], target_from_source[:3, 3]
    return Mesh(mesh.vertices_mm @ rotation.T + translation, mesh.faces)


def reduced(mesh: Mesh, faces: int) -> Mesh:
    """Decimate by quadric edge collapse to at most ``faces`` triangles, for silhouettes and thickness.

    It goes in steps and stops where the next would spoil the shape (5 % of the volume, 2 % of the size): then it has
    more faces than asked. The library behind it would go on: it took a third of the volume off a knee implant of 73,000
    faces on the way to 2,000. The same input gives the same output. The result need not be watertight even where the
    input is, so a boolean operation belongs to the full mesh. A mesh that is small enough is returned itself.

    Raises
    ------
    ValueError
        ``faces`` is below 4.

    References
    ----------
    Garland & Heckbert (1997), Surface simplification using quadric error metrics.
    """
    if faces < 4:
        raise ValueError(f"faces must be 4 or more, not {faces}")
    import fast_simplification

    origin = mesh.vertices_mm.mean(axis=0)  # the collapse works in float32: keep the numbers small
    volume, extent = signed_volume_mm3(mesh), np.ptp(mesh.vertices_mm, axis=0)
    best = mesh
    while len(best.faces) > faces:
        points, kept = fast_simplification.simplify(
            (best.vertices_mm - origin).astype(np.float32),
            best.faces.astype(np.int32),
            target_count=max(faces, int(0.6 * len(best.faces))),
            agg=5,  # 7, the default, makes spikes; 3 stops at once
        )
        smaller = Mesh(np.asarray(points, dtype=np.float64) + origin, np.asarray(kept, dtype=np.int64))
        change = np.abs(np.ptp(smaller.vertices_mm, axis=0) - extent).max()
        spoilt = abs(signed_volume_mm3(smaller) - volume) > 0.05 * abs(volume) or change > 0.02 * extent.max()
        if spoilt or len(smaller.faces) >= len(best.faces):
            break
        best = smaller
    return best


def signed_volume_mm3(mesh: Mesh) -> float:
    """Volume by the divergence theorem: exact for a closed mesh, rough for an open one, negative if inside out."""
    return float(face_volumes_mm3(mesh).sum())


def face_volumes_mm3(mesh: Mesh) -> FloatArray:
    """(F,): signed volume of the tetrahedra from the middle of the bounding box to each face."""
    middle = 0.5 * (mesh.vertices_mm.min(axis=0) + mesh.vertices_mm.max(axis=0))
    a, b, c = np.moveaxis(mesh.triangles_mm - middle, 1, 0)
    return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0)


def _mm_per_unit(path: Path, unit: str) -> float:
    if unit not in MM_PER_UNIT:
        raise MeshError(f"the unit '{unit}' is not known", file=path, field="unit", expected=", ".join(MM_PER_UNIT))
    if path.suffix.lower() in (".step", ".stp") and unit != "mm":
        raise MeshError(
            f"the unit '{unit}' was given for a STEP file, which states its own",
            file=path,
            field="unit",
            remedy="Leave the unit at mm: it is read from the file.",
        )
    return MM_PER_UNIT[unit]


def merged(vertices: NDArray[np.floating], faces: IntArray) -> Mesh:
    """Make vertices of equal coordinates one, in the order in which the faces first use them."""
    used = vertices[faces.ravel()].astype(np.float64)
    order = np.lexsort(used.T)
    rows = used[order]
    is_new = np.concatenate([[True], np.any(rows[1:] != rows[:-1], axis=1)])
    group = np.empty(len(used), dtype=np.int64)
    group[order] = np.cumsum(is_new) - 1
    firsts = order[is_new]  # lexsort is stable: the first use of each
    rank = np.empty(len(firsts), dtype=np.int64)
    rank[np.argsort(firsts)] = np.arange(len(firsts))
    return Mesh(used[np.sort(firsts)], rank[group].reshape(-1, 3))
