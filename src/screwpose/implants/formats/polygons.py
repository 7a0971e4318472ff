"""Polygons to triangles, whatever their number of corners."""

import numpy as np

from screwpose._types import FloatArray, IntArray


def triangulated(vertices: FloatArray, corners: IntArray, counts: IntArray) -> IntArray:
    """Split polygons into triangles that keep their winding.

    Concave ones stay concave: a fan would fill a notch (a rod channel drawn as one U-shaped face) with metal.

    Parameters
    ----------
    vertices : (N, 3)
    corners : (sum of counts,), vertex indices of all polygons, one after the other.
    counts : (P,), corners of each polygon; below three is dropped (points and lines).

    Returns
    -------
    (F, 3), in the order of the polygons within triangles, then quads, then larger ones.
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64) if len(counts) else counts
    found = [corners[starts[counts == 3][:, None] + np.arange(3)].reshape(-1, 3)]
    found.append(_split_quads(vertices, corners[starts[counts == 4][:, None] + np.arange(4)].reshape(-1, 4)))
    for i in np.flatnonzero(counts > 4):
        found.append(_split_polygon(vertices, corners[starts[i] : starts[i] + counts[i]]))  # noqa: PERF401  (reads as three steps)
    return np.concatenate(found).astype(np.int64)


def strip_triangles(strip: IntArray) -> IntArray:
    """(n,) corners of a triangle strip to (n - 2, 3) triangles, every second one turned back."""
    faces = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
    faces[1::2] = faces[1::2][:, [1, 0, 2]]
    return faces


def _split_quads(vertices: FloatArray, quads: IntArray) -> IntArray:
    a, b, c, d = (vertices[quads[:, k]] for k in range(4))
    agree = np.einsum("ij,ij->i", np.cross(b - a, c - a), np.cross(c - a, d - a)) >= 0.0
    by_ac, by_bd = quads[:, [0, 1, 2, 0, 2, 3]], quads[:, [0, 1, 3, 1, 2, 3]]  # the diagonal that lies inside
    return np.where(agree[:, None], by_ac, by_bd).reshape(-1, 3)


def _split_polygon(vertices: FloatArray, polygon: IntArray) -> IntArray:
    points = vertices[polygon] - vertices[polygon[0]]
    area = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)  # Newell: twice the area vector
    size = float(np.linalg.norm(area))
    fan = np.stack([np.zeros(len(polygon) - 2), np.arange(1, len(polygon) - 1), np.arange(2, len(polygon))], axis=1)
    if size == 0.0:
        return polygon[fan.astype(np.int64)]
    normal = area / size
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    flat = np.stack([points @ across, points @ np.cross(normal, across)], axis=1)
    turns = np.cross(np.roll(points, -1, axis=0) - points, np.roll(points, -2, axis=0) - np.roll(points, -1, axis=0))
    if np.all(turns @ normal >= 0.0):
        return polygon[fan.astype(np.int64)]
    import manifold3d

    return polygon[np.asarray(manifold3d.triangulate([flat]), dtype=np.int64).reshape(-1, 3)]
