"""What a closed surface's contour is found by: the plane of every face, and which two faces meet in every edge.

Made once for a scene's meshes; `contour_kernels` use it for every pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from screwpose._types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class ClosedSurface:
    """A closed mesh, prepared.

    Parameters
    ----------
    planes : (4, F), unit normal and offset of each face: it is seen from points with ``n . x > offset``.
    edge_vertices : (E, 2), uint32, each edge from one vertex to the other.
    edge_faces : (E, 2), uint32: the face that runs along the edge, and the one that runs against it.
    """

    planes: FloatArray
    edge_vertices: NDArray[np.uint32]
    edge_faces: NDArray[np.uint32]


def closed_surface(vertices_mm: FloatArray, faces: IntArray) -> ClosedSurface | None:
    """Prepare a mesh; None where it is not closed.

    Closed: every edge belongs to as many faces one way as the other (no border, consistently wound). Where more than
    two faces share an edge, they are paired as they come: any pairing gives the same windings.

    Parameters
    ----------
    vertices_mm, faces : (N, 3) and (F, 3).
    """
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    owner = np.repeat(np.arange(len(faces)), 3)
    low, high = np.minimum(start, end), np.maximum(start, end)
    key = low * (int(faces.max(initial=0)) + 1) + high
    there, back = (np.flatnonzero(side) for side in (start < end, start > end))
    there, back = (side[np.argsort(key[side], kind="stable")] for side in (there, back))
    if not np.array_equal(key[there], key[back]):
        return None
    # Edges of faces that lie together in memory lie together too.
    order = np.argsort(np.minimum(owner[there], owner[back]), kind="stable")
    there, back = there[order], back[order]
    corners = vertices_mm[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(lengths > 0.0, lengths, 1.0)
    planes = np.concatenate([normals.T, np.sum(normals * corners[:, 0], axis=1)[None]])
    return ClosedSurface(
        np.ascontiguousarray(planes, dtype=np.float64),
        np.stack([low[there], high[there]], axis=1).astype(np.uint32),
        np.stack([owner[there], owner[back]], axis=1).astype(np.uint32),
    )


class Bodies(NamedTuple):
    """The meshes of a scene one after the other; body b has the vertices, faces and edges from start[b] to start[b+1].

    Parameters
    ----------
    boxes : (B, 2, 3), the smallest and largest coordinates of each body's vertices.
    faces : (F, 3), numbered within their body.
    is_closed : (B,); only such bodies have edges, and planes that mean something.
    planes, edge_vertices, edge_faces : as `ClosedSurface` has them.
    """

    vertices_mm: FloatArray
    vertex_start: IntArray
    boxes: FloatArray
    faces: IntArray
    face_start: IntArray
    is_closed: BoolArray
    planes: FloatArray
    edge_vertices: NDArray[np.uint32]
    edge_faces: NDArray[np.uint32]
    edge_start: IntArray


class Room(NamedTuple):
    """Where the kernels work, in blocks of 64 columns ("words"); made once, used for scene after scene.

    Parameters
    ----------
    u, v : (N,), of the largest body that has to be projected as a whole.
    source_mm : (3,); is_seen : (F,); contour : (E + 4,): of the body at hand, see `contour_kernels.find_contour`.
    lines, reach : (3, E + 4), of the contour's edges, see `lane_kernels.project_edges`.
    order : (E + 4,), which of them cross a column.
    places : (any,), which changes are to be made: twice the place in the flat array, and 1 more where it is up.
    changes : (words, rows + 1, 64), by how much the number of windings changes from the row above; 0 between scenes.
    raised : (words, 65), by how much the number of a column's changes that are up differs from that of the column
        before; 0 between scenes.
    bits : (words, rows + 1), the mask; the last row stays 0.
    ranges : (words, 2), the first row and the last (not included) that may hold a bit.
    """

    u: FloatArray
    v: FloatArray
    source_mm: FloatArray
    is_seen: NDArray[np.uint8]
    contour: NDArray[np.uint32]
    lines: FloatArray
    reach: NDArray[np.int32]
    order: NDArray[np.uint32]
    places: NDArray[np.uint32]
    changes: NDArray[np.int8]
    raised: NDArray[np.int32]
    bits: NDArray[np.uint64]
    ranges: IntArray


def packed_bodies(meshes: Sequence[tuple[FloatArray, IntArray]]) -> Bodies:
    """Vertices (N, 3), mm, and faces (F, 3) of every mesh, as the kernels want them."""
    vertices = [np.asarray(vertices_mm, dtype=np.float64) for vertices_mm, _ in meshes]
    faces = [np.asarray(of_mesh, dtype=np.int64) for _, of_mesh in meshes]
    none = np.zeros((0, 2), dtype=np.uint32)
    surfaces = [closed_surface(*mesh) for mesh in zip(vertices, faces, strict=True)]
    drawn = [
        surface or ClosedSurface(np.zeros((4, len(of_mesh))), none, none)
        for surface, of_mesh in zip(surfaces, faces, strict=True)
    ]
    return Bodies(
        np.ascontiguousarray(np.concatenate(vertices)),
        _starts(vertices),
        np.array([[one.min(axis=0), one.max(axis=0)] for one in vertices]),
        np.ascontiguousarray(np.concatenate(faces)),
        _starts(faces),
        np.array([surface is not None for surface in surfaces]),
        np.ascontiguousarray(np.concatenate([one.planes for one in drawn], axis=1)),
        np.concatenate([one.edge_vertices for one in drawn]),
        np.concatenate([one.edge_faces for one in drawn]),
        _starts([one.edge_vertices for one in drawn]),
    )


def _starts(parts: Sequence[NDArray[Any]]) -> IntArray:
    return np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
