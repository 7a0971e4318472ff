"""The paper's projection: every triangle is filled on its own, by OpenCV.

It is the baseline that later speed is measured against. OpenCV also paints the pixels that a triangle's outline passes
through, so its mask is up to about a pixel wider than `reference.silhouette`, whose rule is the pixel's centre.
"""

import numpy as np

from screwpose._types import BoolArray, FloatArray, IntArray
from screwpose.projection import reference

_SHIFT = 8  # fractional bits of OpenCV's fixed-point coordinates: 1/256 px
# Past some 2**15 px OpenCV's 16.16 edge arithmetic overflows and paints stray lines across the image.
_MAX_COORDINATE_PX = 20_000.0


def silhouette(vertices_px: FloatArray, faces: IntArray, shape: tuple[int, int]) -> BoolArray:
    """The union of projected triangles, one ``cv2.fillConvexPoly`` a triangle.

    Parameters
    ----------
    vertices_px : (N, 2), px, (u, v).
    faces : (F, 3), indices into the vertices; either winding.
    shape : (rows, columns) of the image.

    Returns
    -------
    (rows, columns), bool.
    """
    import cv2

    canvas = np.zeros(shape, dtype=np.uint8)
    rows, columns = shape
    triangles = np.asarray(vertices_px, dtype=np.float64)[faces]
    # Triangles wholly outside the image are left out; those that would overflow OpenCV are filled by the reference.
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    visible = (high >= -1.0).all(axis=1) & (low[:, 0] <= columns) & (low[:, 1] <= rows)
    fits = (np.abs(triangles) < _MAX_COORDINATE_PX).all(axis=(1, 2))
    for triangle in np.rint(triangles[visible & fits] * (1 << _SHIFT)).astype(np.int32):
        cv2.fillConvexPoly(canvas, triangle, 1, cv2.LINE_8, _SHIFT)
    mask = canvas.view(np.bool_)
    if not fits.all():
        mask |= reference.silhouette(vertices_px, np.asarray(faces)[visible & ~fits], shape)
    return mask
