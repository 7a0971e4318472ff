"""What the marks in the images say of the poses: residuals in units of their noise, with derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Implant


@dataclass(frozen=True, eq=False)
class MarkedScrew:
    """One screw's marks: `tips_px` and `centers_px` are (V, 2) in the views of `cameras`."""

    cameras: Sequence[Camera]
    tips_px: FloatArray
    centers_px: FloatArray


def mark_residuals(
    implant: Implant, world_from_cad: FloatArray, marks: MarkedScrew, sigma_px: float
) -> tuple[FloatArray, FloatArray]:
    """Marks minus projected landmarks, (4 V,), in sigmas, and how the projections change with the pose, (4 V, 6).

    The pose's change is a rotation vector in world about the screw's centre, then a shift in world mm.
    """
    ends = rigid.transform(world_from_cad, np.stack([implant.tip_mm, implant.center_mm]))
    residuals, slopes = [], []
    for camera, marked in zip(marks.cameras, np.stack([marks.tips_px, marks.centers_px], axis=1), strict=True):
        P = camera.projection
        for point, mark in zip(ends, marked, strict=True):
            homogeneous = P[:, :3] @ point + P[:, 3]
            pixel = homogeneous[:2] / homogeneous[2]
            by_point = (P[:2, :3] - pixel[:, None] * P[2, :3]) / homogeneous[2]
            residuals.append((mark - pixel) / sigma_px)
            slopes.append(by_point @ np.hstack([-rigid.skew(point - ends[1]), np.eye(3)]) / sigma_px)
    return np.concatenate(residuals), np.concatenate(slopes)
