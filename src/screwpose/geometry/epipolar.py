"""How far is a point from the ray that another view saw it on? Epipolar distances between calibrated views."""

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera


def fundamental_matrix(first: Camera, second: Camera) -> FloatArray:
    """The matrix F (3, 3) with ``[u v 1]_second F [u v 1]_first^T = 0`` for the images of one point.

    ``F = [e]_x P_second P_first^+``, e the image of the first source in the second view; of Frobenius norm 1.

    References
    ----------
    Hartley & Zisserman (2004), Multiple View Geometry, eq. 9.1.
    """
    source = np.append(first.center_in_world_mm, 1.0)
    e = second.projection @ source
    cross = np.array([[0.0, -e[2], e[1]], [e[2], 0.0, -e[0]], [-e[1], e[0], 0.0]])
    F = cross @ second.projection @ np.linalg.pinv(first.projection)
    return np.asarray(F / np.linalg.norm(F))


def epipolar_distances_px(
    first: Camera, second: Camera, points_in_first_px: FloatArray, points_in_second_px: FloatArray
) -> FloatArray:
    """Distance of every point in one view from the epipolar line of every point in the other, mean of both ways.

    Parameters
    ----------
    points_in_first_px, points_in_second_px : (N, 2) and (M, 2), px, (u, v).

    Returns
    -------
    (N, M), px.
    """
    F = fundamental_matrix(first, second)
    a = np.column_stack([points_in_first_px, np.ones(len(points_in_first_px))])
    b = np.column_stack([points_in_second_px, np.ones(len(points_in_second_px))])
    in_second, in_first = a @ F.T, b @ F  # lines (N, 3) and (M, 3)
    off = np.abs(in_second @ b.T)
    return np.asarray(
        0.5 * (off / np.linalg.norm(in_second[:, :2], axis=1)[:, None] + off / np.linalg.norm(in_first[:, :2], axis=1))
    )
