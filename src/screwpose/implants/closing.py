"""Meshes made fit for winding numbers: closed, and with their outside outside.

A ray that crosses a closed surface has a winding number all along: it rises by one where the ray enters, falls where it
leaves. CAD files are often not closed: pieces that do not join, slits, missing caps. What is missing of a surface has a
boundary that runs in closed loops, whatever the holes look like; a cone over each connected part of that boundary, to
its centroid, closes it. Where the hole is flat the cone is the missing cap; where it is a slit the cone folds onto
itself and adds nothing.
"""

import numpy as np

from screwpose._types import FloatArray, IntArray
from screwpose.errors import MeshError
from screwpose.implants.model import Mesh

# A piece that encloses less than this share of the cube of its size is a sheet: it has no inside.
_FLAT = 1e-9


def closed_mesh(mesh: Mesh) -> Mesh:
    """The mesh with every hole closed by a cone, turned where it is inside out as a whole.

    Parameters
    ----------
    mesh : in one or several pieces, that may be nested (a cavity), overlap, or not join.

    Raises
    ------
    MeshError
        No faces; coordinates that are not finite; faces that name no vertex; neighbours that disagree about the
        outside; one piece inside out while others are not; or nothing enclosed.
    """
    vertices, faces = _checked(mesh)
    rim = _rim(faces)
    if len(rim):
        # Files that list each face's corners afresh: what is one vertex has one place, to the last bit.
        vertices, faces = _merged(vertices, faces)
        rim = _rim(faces)
    if len(rim):
        _require_agreement(faces)
        vertices, faces = _coned(vertices, faces, rim)
    return Mesh(vertices, _outward(vertices, faces))


def _checked(mesh: Mesh) -> tuple[FloatArray, IntArray]:
    vertices = np.asarray(mesh.vertices_mm, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if len(faces) == 0:
        raise MeshError("a mesh without faces", expected="triangles that enclose a body")
    bad = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
    if bad:
        raise MeshError(f"{bad} of {len(vertices)} vertices are not finite", expected="coordinates in mm")
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = int(np.count_nonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1)))
        raise MeshError(
            f"{wrong} of {len(faces)} faces name a vertex that is not there",
            expected=f"indices from 0 to {len(vertices) - 1}",
        )
    return vertices, faces


def _directed_edges(faces: IntArray) -> IntArray:
    """(3F, 2): each face's edges, in its own sense."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _edge_balance(faces: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """For each edge (low, high): faces that run it upwards minus those that run it downwards, and how many in all."""
    edges = _directed_edges(faces)
    low, high = edges.min(axis=1), edges.max(axis=1)
    key = low * (int(faces.max()) + 1) + high
    order = np.argsort(key)
    begin = np.flatnonzero(np.diff(key[order], prepend=-1))
    up = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    up[low == high] = 0  # of a face that has one corner twice
    balance = np.add.reduceat(up[order], begin)
    return np.stack([low[order[begin]], high[order[begin]]], axis=1), balance, np.diff(begin, append=len(key))


def _rim(faces: IntArray) -> IntArray:
    """(E, 2): the directed edges that no face runs the other way; as often as they are missing."""
    edges, balance, _ = _edge_balance(faces)
    upward = np.repeat(edges, np.maximum(balance, 0), axis=0)
    downward = np.repeat(edges[:, ::-1], np.maximum(-balance, 0), axis=0)
    return np.concatenate([upward, downward])


def _merged(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    # Adding zero makes -0.0 and 0.0 one.
    unique, index = np.unique(vertices + 0.0, axis=0, return_inverse=True)
    joined = index.reshape(-1)[faces]
    distinct = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
    if not distinct.any():
        raise MeshError(f"all {len(faces)} faces have two corners in one place", expected="triangles")
    return np.asarray(unique, dtype=np.float64), joined[distinct]


def _require_agreement(faces: IntArray) -> None:
    """Two faces that share an edge and run it the same way see the outside on different sides."""
    _, balance, count = _edge_balance(faces)
    wrong = int(np.count_nonzero((count == 2) & (np.abs(balance) == 2)))
    if wrong:
        raise MeshError(
            f"neighbouring faces disagree about the outside at {wrong} of {len(count)} edges",
            expected="faces that are counter-clockwise seen from outside, all of them",
            remedy="Unify the faces' orientation in the CAD program.",
        )


def _coned(vertices: FloatArray, faces: IntArray, rim: IntArray) -> tuple[FloatArray, IntArray]:
    """Close each connected part of the rim by a fan of faces to its centroid."""
    part = _connected(rim, len(vertices))[rim[:, 0]]
    names, part = np.unique(part, return_inverse=True)
    length = np.linalg.norm(vertices[rim[:, 1]] - vertices[rim[:, 0]], axis=1)
    weight = np.maximum(length, 1e-300)
    middle = 0.5 * (vertices[rim[:, 0]] + vertices[rim[:, 1]])
    total = np.bincount(part, weights=weight)
    centroids = np.stack([np.bincount(part, weights=weight * middle[:, axis]) / total for axis in range(3)], axis=1)
    fan = np.column_stack([rim[:, 1], rim[:, 0], len(vertices) + part])
    assert len(centroids) == len(names)
    return np.concatenate([vertices, centroids]), np.concatenate([faces, fan])


def _connected(edges: IntArray, count: int) -> IntArray:
    """(count,): the number of the connected piece that each vertex belongs to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _outward(vertices: FloatArray, faces: IntArray) -> IntArray:
    """The faces of a closed mesh, turned round if it encloses a negative volume as a whole."""
    piece = _connected(_directed_edges(faces), len(vertices))[faces[:, 0]]
    _, piece = np.unique(piece, return_inverse=True)
    corners = vertices[faces] - vertices[faces].mean(axis=(0, 1))
    volume_mm3 = np.bincount(piece, weights=np.linalg.det(corners) / 6.0)
    size_mm3 = float(np.linalg.norm(np.ptp(vertices[faces].reshape(-1, 3), axis=0))) ** 3
    solid = np.abs(volume_mm3) > _FLAT * size_mm3
    if not solid.any():
        raise MeshError(
            f"a mesh of {len(faces)} faces that encloses no volume ({np.abs(volume_mm3).sum():.3g} mm^3)",
            expected="a body, not a sheet",
            remedy="Give the part its thickness in the CAD program.",
        )
    if volume_mm3.sum() < 0.0:
        faces, volume_mm3 = faces[:, ::-1], -volume_mm3
    for number in np.flatnonzero(solid & (volume_mm3 < 0.0)):
        own = piece == number
        # A cavity is a piece turned inwards within another one: around it the winding number is 1 or more.
        around = _winding_number(vertices[faces[~own]], vertices[faces[own]].reshape(-1, 3)[:9].mean(axis=0))
        if around < 0.5:
            raise MeshError(
                f"a piece of {np.count_nonzero(own)} of the {len(faces)} faces is inside out, the others are not",
                expected="faces that are counter-clockwise seen from outside, all of them",
                remedy="Turn that piece round in the CAD program.",
            )
    return faces


def _winding_number(triangles: FloatArray, point: FloatArray) -> float:
    """How often closed surfaces (F, 3, 3) go round a point (3,): their solid angle over 4 pi.

    References
    ----------
    Van Oosterom & Strackee (1983), IEEE Trans. Biomed. Eng. 30, 125.
    """
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    dots = la * lb * lc + np.einsum("ij,ij->i", a, b) * lc + np.einsum("ij,ij->i", b, c) * la
    dots += np.einsum("ij,ij->i", c, a) * lb
    return float(np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), dots).sum() / (2.0 * np.pi))
