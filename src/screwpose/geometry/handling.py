"""Moving what is seen in a view, and how a spread in space looks there."""

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera


def shift_in_view(camera: Camera, point_in_world_mm: FloatArray, shift_px: FloatArray) -> FloatArray:
    """The shift (3,), mm, that moves a point's image by (2,) px and leaves its depth in the view as it is."""
    depth_mm = float(camera.depth_mm(point_in_world_mm)[0])
    pixel = camera.project(point_in_world_mm) + np.asarray(shift_px, dtype=np.float64)
    P = camera.projection
    moved = np.linalg.solve(P[:, :3], depth_mm * np.append(pixel, 1.0) - P[:, 3])
    return np.asarray(moved - point_in_world_mm, dtype=np.float64)


def ellipse_in_view(
    camera: Camera, point_in_world_mm: FloatArray, covariance_mm2: FloatArray, points: int = 48
) -> FloatArray:
    """The one-sigma ellipse (points, 2), px, about (0, 0), of a point whose covariance (3, 3) is known in the world.

    References
    ----------
    Hartley & Zisserman (2004), section 5.2.1: forward propagation, with the projection's derivative at the point.
    """
    P = camera.projection
    pixel, depth_mm = camera.project(point_in_world_mm), float(camera.depth_mm(point_in_world_mm)[0])
    by_point = (P[:2, :3] - pixel[:, None] * P[2, :3]) / depth_mm
    values, vectors = np.linalg.eigh(by_point @ covariance_mm2 @ by_point.T)
    angles = np.linspace(0.0, 2.0 * np.pi, points, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    return np.asarray((vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * circle)).T, dtype=np.float64)
