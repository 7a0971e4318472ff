"""Where do the rays of two or more views meet?

The linear least-squares system of the paper (arXiv 2511.05702): with P in rows ``p1, p2, p3`` and a pixel (u, v),

    X (p11 - u p31) + Y (p12 - u p32) + Z (p13 - u p33) = u p34 - p14

and the same with v and row 2; two rows a view, three unknowns. It is the inhomogeneous linear method of
Hartley & Sturm (1997). Each P is normalised to depths in mm, so that a row's residual is an error of a pixel
times a depth and views at like distances count alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import CalibrationError, ParallelViewsError
from screwpose.geometry.camera import Camera

_MIN_RAY_ANGLE_DEG = 3.0  # 0.3 mm of noise across the rays is 6 mm along them


@dataclass(frozen=True, eq=False)
class Triangulation:
    """A point and how well the views agree on it.

    Parameters
    ----------
    point_in_world_mm : (3,).
    residuals_px : (V, 2), the point's projection minus what was marked, for each view.
    ray_distances_mm : (V,), distance of the point from each view's ray.
    ray_angle_deg : the largest angle between any two of the rays: 90 is best, below 3 is refused.
    condition : condition number of the least-squares system with its columns in world axes.
    """

    point_in_world_mm: FloatArray
    residuals_px: FloatArray
    ray_distances_mm: FloatArray
    ray_angle_deg: float
    condition: float

    @property
    def rms_px(self) -> float:
        """Root mean square over the views of the residual's length, px."""
        return float(np.sqrt(np.mean(np.sum(self.residuals_px**2, axis=1))))


def linear_system(cameras: Sequence[Camera], pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The paper's system ``A [X Y Z] = b``: A is (2 V, 3), b is (2 V,), for pixels (V, 2)."""
    rows, right = [], []
    for camera, (u, v) in zip(cameras, pixels, strict=True):
        P = camera.projection
        rows += [P[0, :3] - u * P[2, :3], P[1, :3] - v * P[2, :3]]
        right += [u * P[2, 3] - P[0, 3], v * P[2, 3] - P[1, 3]]
    return np.array(rows), np.array(right)


def triangulate(cameras: Sequence[Camera], pixels: FloatArray) -> Triangulation:
    """Find the 3D point that two or more views see at the given pixels.

    Parameters
    ----------
    cameras : V >= 2 views.
    pixels : (V, 2), px, (u, v): the same point in each view.

    Raises
    ------
    ParallelViewsError
        No two rays differ by 3 degrees or more: the depth would be a guess.
    BehindSourceError
        The rays meet behind a source.
    CalibrationError
        Fewer than two views, or pixels that are not finite.

    References
    ----------
    Hartley & Sturm (1997), "Triangulation", section 5.1 (Linear-LS); arXiv 2511.05702, equation of step 1.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    if len(cameras) < 2 or pixels.shape != (len(cameras), 2) or not np.isfinite(pixels).all():
        raise CalibrationError(
            f"{len(cameras)} views and pixels of shape {pixels.shape} to triangulate",
            expected="two views or more, and one finite (u, v) for each",
        )
    directions = np.vstack(
        [camera.ray_directions_in_world(pixel) for camera, pixel in zip(cameras, pixels, strict=True)]
    )
    angle_deg = _largest_angle_deg(directions)
    if angle_deg < _MIN_RAY_ANGLE_DEG:
        raise ParallelViewsError(
            f"the rays of the views differ by {angle_deg:.2g} degrees at most, {_MIN_RAY_ANGLE_DEG:g} are needed: "
            "the depth cannot be known. Take the views from directions 60 to 120 degrees apart."
        )
    A, b = linear_system(cameras, pixels)
    solution, _, _, singular_values = np.linalg.lstsq(A, b, rcond=None)
    point = np.asarray(solution, dtype=np.float64)
    # A ray is a line here: its perpendicular distance does not ask in which direction it runs.
    offsets = point - np.array([camera.center_in_world_mm for camera in cameras])
    across = offsets - np.sum(offsets * directions, axis=1, keepdims=True) * directions
    return Triangulation(
        point_in_world_mm=point,
        residuals_px=np.array([camera.project(point) for camera in cameras]) - pixels,
        ray_distances_mm=np.linalg.norm(across, axis=1),
        ray_angle_deg=angle_deg,
        condition=float(singular_values[0] / singular_values[-1]),
    )


def _largest_angle_deg(directions: FloatArray) -> float:
    """The largest angle between any two lines with the given unit directions (V, 3); 90 at most."""
    first, second = np.triu_indices(len(directions), k=1)
    sines = np.linalg.norm(np.cross(directions[first], directions[second]), axis=1)
    return float(np.degrees(np.arcsin(np.clip(sines.max(), 0.0, 1.0))))
