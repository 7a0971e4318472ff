"""What is wrong with a mesh, in numbers and in words."""

from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.implants.mesh import face_volumes_mm3, signed_volume_mm3
from screwpose.implants.model import Mesh

SCREW_MM = (20.0, 250.0)  # a pedicle screw alone, up to one with an extension tower
_TOO_LARGE_MM = 400.0
_FLAT = 1e-7  # a height below this share of the mesh's size is the rounding of float32, not a shape


@dataclass(frozen=True)
class MeshReport:
    """What :func:`mesh_report` found.

    Parameters
    ----------
    vertices, faces, bodies : how many; a body is what hangs together by shared vertices.
    watertight : every edge belongs to exactly two faces.
    open_edges, non_manifold_edges : edges of one face, and of three or more.
    inconsistent_edges : edges that two faces run through in the same direction: their windings disagree.
    inverted_bodies : bodies that are inside out (hollows inside another body are not counted).
    degenerate_faces, duplicate_faces : without area; made of the corners of an earlier face.
    volume_mm3 : by the divergence theorem: exact if watertight, rough if not, negative if inside out.
    extent_mm : size of the bounding box along the axes of the CAD frame.
    length_mm : size along the mesh's own principal axis.
    problems : each in words with its remedy; empty for a sound mesh.
    """

    vertices: int
    faces: int
    bodies: int
    watertight: bool
    open_edges: int
    non_manifold_edges: int
    inconsistent_edges: int
    inverted_bodies: int
    degenerate_faces: int
    duplicate_faces: int
    volume_mm3: float
    extent_mm: tuple[float, float, float]
    length_mm: float
    problems: tuple[str, ...]


def mesh_report(mesh: Mesh) -> MeshReport:
    """Examine a mesh: holes, winding, degenerate and duplicate faces, size."""
    points, faces = mesh.vertices_mm, mesh.faces
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    collapsed = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    open_edges, crowded, inconsistent = _edges(faces[~collapsed], len(points))
    label = _bodies(faces, len(points))
    facts = {
        "vertices": len(points),
        "faces": len(faces),
        "bodies": int(label.max()) + 1,
        "open_edges": open_edges,
        "non_manifold_edges": crowded,
        "inconsistent_edges": inconsistent,
        "inverted_bodies": _inverted(mesh, label),
        "degenerate_faces": int(np.count_nonzero(collapsed | (_heights(mesh) <= _FLAT * size))),
        "duplicate_faces": _duplicates(faces),
    }
    length = principal_length_mm(mesh)
    return MeshReport(
        **facts,
        watertight=open_edges == 0 and crowded == 0,
        volume_mm3=signed_volume_mm3(mesh),
        extent_mm=(float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2])),
        length_mm=length,
        problems=(*_defects(facts), *scale_problems(length)),
    )


def scale_problems(length_mm: float) -> tuple[str, ...]:
    """Whether a length is that of a spine implant, and which unit it may be in if not."""
    low, high = SCREW_MM
    if low <= length_mm <= high:
        return ()
    said = f"It is {length_mm:.3g} mm long, where screws measure {low:g} to {high:g} mm"
    guesses = [
        f"in {unit} it would be {length_mm * factor:.3g} mm"
        for unit, factor in (("metres", 1000.0), ("inches", 25.4), ("centimetres", 10.0))
        if low <= length_mm * factor <= high
    ]
    if guesses:
        unit = guesses[0].split()[1]
        return (f"{said}: is it in {unit}? ({'; '.join(guesses)}.) State its unit.",)
    if length_mm > _TOO_LARGE_MM:
        return (f"{said}: it is too large. Was its unit given as one that is too long, or is it in micrometres?",)
    short = "short" if length_mm < low else "long"
    return (f"{said}: it is too {short} for a screw. Check that it is the right model, whole and alone, and its unit.",)


def principal_length_mm(mesh: Mesh) -> float:
    """Extent along the axis of the vertices' largest spread."""
    centred = mesh.vertices_mm - mesh.vertices_mm.mean(axis=0)
    along = centred @ np.linalg.eigh(centred.T @ centred)[1][:, 2]
    return float(np.ptp(along))


def _edges(faces: IntArray, count: int) -> tuple[int, int, int]:
    """How many edges belong to one face, to more than two, and to two faces of opposite winding."""
    start = faces.ravel()
    end = np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(start, end) * count + np.maximum(start, end)
    order = np.argsort(key)
    key, forward = key[order], (start < end)[order]
    first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])) if len(key) else np.empty(0, dtype=np.int64)
    members = np.diff(np.append(first, len(key)))
    balance = np.add.reduceat(np.where(forward, 1, -1), first) if len(first) else first
    pairs = members == 2
    return (
        int(np.count_nonzero(members == 1)),
        int(np.count_nonzero(members > 2)),
        int(np.count_nonzero(balance[pairs])),
    )


def _bodies(faces: IntArray, count: int) -> IntArray:
    """(F,): the number of the body to which each face belongs."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    row, column = faces[:, [0, 1]].T.ravel(), faces[:, [1, 2]].T.ravel()
    joined = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(count, count))
    label = connected_components(joined, directed=False)[1][faces[:, 0]]
    return np.unique(label, return_inverse=True)[1].astype(np.int64)


def _inverted(mesh: Mesh, label: IntArray) -> int:
    """Count bodies of negative volume, save those whose box lies in that of another one: hollows."""
    volume = np.bincount(label, weights=face_volumes_mm3(mesh))
    negative = np.flatnonzero(volume < 0.0)
    if not len(negative):
        return 0
    corners = mesh.triangles_mm
    order = np.argsort(label, kind="stable")
    first = np.searchsorted(label[order], np.arange(len(volume)))
    low = np.minimum.reduceat(corners.min(axis=1)[order], first)
    high = np.maximum.reduceat(corners.max(axis=1)[order], first)
    around = volume > 0.0
    hollow = [np.any(around & (low <= low[i]).all(axis=1) & (high >= high[i]).all(axis=1)) for i in negative]
    return len(negative) - int(np.count_nonzero(hollow))


def _heights(mesh: Mesh) -> FloatArray:
    """(F,): the smallest height of each triangle, 0 for one without area."""
    a, b, c = np.moveaxis(mesh.triangles_mm, 1, 0)
    longest = np.sqrt(np.max([((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1), ((a - c) ** 2).sum(1)], axis=0))
    area2 = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.asarray(np.divide(area2, longest, out=np.zeros_like(area2), where=longest > 0.0))


def _duplicates(faces: IntArray) -> int:
    """How many faces have the corners of another, in any order."""
    corners = np.sort(faces, axis=1)
    rows = corners[np.lexsort(corners.T)]
    return int(np.count_nonzero((rows[1:] == rows[:-1]).all(axis=1)))


def _defects(facts: dict[str, int]) -> list[str]:
    found = []
    if facts["open_edges"]:
        found.append(
            f"It is not closed: {facts['open_edges']} open edges. Silhouettes can still be drawn, but the "
            "length of metal along a ray is wrong at the holes. Close them in the CAD program or a mesh repair tool."
        )
    if facts["non_manifold_edges"]:
        found.append(
            f"{facts['non_manifold_edges']} edges belong to more than two faces: bodies that touch, or walls without "
            "thickness. Unite the bodies in the CAD program before exporting."
        )
    if facts["inverted_bodies"]:
        found.append(
            f"{facts['inverted_bodies']} of {facts['bodies']} bodies inside out (negative volume): the faces' "
            "winding is inverted. Flip the normals."
        )
    if facts["inconsistent_edges"]:
        found.append(
            f"At {facts['inconsistent_edges']} edges the neighbouring faces disagree about which side is outside. Make "
            "the normals consistent in a mesh tool."
        )
    if facts["degenerate_faces"]:
        found.append(f"{facts['degenerate_faces']} faces have no area. They do no harm by themselves; remove them.")
    if facts["duplicate_faces"]:
        found.append(f"{facts['duplicate_faces']} faces are there twice: metal would count double. Remove them.")
    return found
