"""Which pixels does a posed mesh cover? The definition: plain NumPy, slow and obvious.

A pixel is covered where its centre (integer coordinates) lies inside or on the edge of the projection of any triangle.
A triangle that projects to a line or a point covers no area; its pixels belong to its neighbours.
"""

import numpy as np

from screwpose._types import BoolArray, FloatArray, IntArray


def silhouette(vertices_px: FloatArray, faces: IntArray, shape: tuple[int, int]) -> BoolArray:
    """The union of projected triangles.

    Parameters
    ----------
    vertices_px : (N, 2), px, (u, v).
    faces : (F, 3), indices into the vertices; either winding.
    shape : (rows, columns) of the image.

    Returns
    -------
    (rows, columns), bool.
    """
    rows, columns = shape
    mask = np.zeros(shape, dtype=np.bool_)
    for triangle in np.asarray(vertices_px, dtype=np.float64)[faces]:
        first = np.maximum(np.ceil(triangle.min(axis=0)), 0).astype(np.int64)
        last = np.minimum(np.floor(triangle.max(axis=0)), [columns - 1, rows - 1]).astype(np.int64)
        if (first > last).any():
            continue
        u, v = np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1))
        mask[first[1] : last[1] + 1, first[0] : last[0] + 1] |= inside_triangle(triangle, u, v)
    return mask


def inside_triangle(triangle_px: FloatArray, u: IntArray, v: IntArray) -> BoolArray:
    """Whether points (u, v) lie inside or on the edge of a triangle (3, 2): on the inner side of all three edges."""
    a, b, c = triangle_px
    # Coordinates relative to a corner before they are multiplied: the products then keep their digits.
    doubled_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if doubled_area == 0:
        return np.zeros(np.shape(u), dtype=np.bool_)
    inside = np.ones(np.shape(u), dtype=np.bool_)
    for start, end in ((a, b), (b, c), (c, a)):
        side = (end[0] - start[0]) * (v - start[1]) - (end[1] - start[1]) * (u - start[0])
        inside &= side * np.sign(doubled_area) >= 0
    return inside
