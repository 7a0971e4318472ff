"""How a calibrated camera may be wrong, and a camera that was put right: pose, focal length, principal point.

The pose is corrected by a motion of the world as the camera sees it, about a pivot near what was X-rayed: a rotation
there does not move what is looked at, so that "2 degrees" and "5 mm" can be said one without the other.
"""

from dataclasses import dataclass, field

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import CalibrationError
from screwpose.geometry import rigid
from screwpose.geometry.camera import Camera

PARAMETERS = 9
"""Of a camera's correction: a rotation vector and a shift, 3 each, the focal length, and the principal point, 2."""


@dataclass(frozen=True)
class CameraSigma:
    """How exactly a view was calibrated: standard deviations, 0 for what is exact.

    Parameters
    ----------
    rotation_deg : of the view about the screws, about each axis.
    translation_mm : of the view against the world, along each axis, at the screws.
    focal_percent : of the focal length.
    principal_point_px : of the principal point, in u and in v.
    """

    rotation_deg: float
    translation_mm: float
    focal_percent: float
    principal_point_px: float

    def __post_init__(self) -> None:
        values = (self.rotation_deg, self.translation_mm, self.focal_percent, self.principal_point_px)
        if not all(np.isfinite(value) and value >= 0.0 for value in values):
            raise CalibrationError(f"standard deviations {values}", expected="four numbers that are not negative")

    @property
    def by_parameter(self) -> FloatArray:
        """(9,), in the units of `CameraCorrection.parameters`: rad, mm, share, px."""
        return np.repeat(
            [np.radians(self.rotation_deg), self.translation_mm, 0.01 * self.focal_percent, self.principal_point_px],
            [3, 3, 1, 2],
        )


@dataclass(frozen=True, eq=False)
class CameraCorrection:
    """What must be done to a reported camera so that it is right.

    Parameters
    ----------
    rotation : (3, 3), of the world as the camera sees it, about the pivot.
    shift_mm : (3,), of it, in world.
    log_focal : natural logarithm of the factor of the focal length.
    principal_point_px : (2,), by how much the principal point is further to the right and down.
    """

    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    shift_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    log_focal: float = 0.0
    principal_point_px: FloatArray = field(default_factory=lambda: np.zeros(2))

    @classmethod
    def from_parameters(cls, parameters: FloatArray) -> "CameraCorrection":
        """From (9,): rotation vector in rad, shift in mm, logarithm of the focal length's factor, px."""
        return cls(rigid.exp_rotation(parameters[:3]), parameters[3:6], float(parameters[6]), parameters[7:9])

    @property
    def parameters(self) -> FloatArray:
        """(9,): rotation vector in rad, shift in mm, logarithm of the focal length's factor, px."""
        return np.concatenate(
            [rigid.log_rotation(self.rotation), self.shift_mm, [self.log_focal], self.principal_point_px]
        )

    def then(self, step: FloatArray) -> "CameraCorrection":
        """With one more small step (9,) of the world as the corrected camera sees it; intrinsics add up."""
        return CameraCorrection(
            self.rotation @ rigid.exp_rotation(step[:3]),
            self.shift_mm + self.rotation @ step[3:6],
            self.log_focal + float(step[6]),
            self.principal_point_px + step[7:9],
        )

    def by_step(self) -> FloatArray:
        """How `parameters` change with a small step of `then`, (9, 9), to the second order of the rotation."""
        slope = np.eye(PARAMETERS)
        half = rigid.skew(0.5 * rigid.log_rotation(self.rotation))
        slope[:3, :3] += half + half @ half / 3.0
        slope[3:6, 3:6] = self.rotation
        return slope

    def motion_about(self, pivot_mm: FloatArray) -> FloatArray:
        """The motion (4, 4) of the world as the camera sees it, about a pivot (3,) in world."""
        motion = rigid.from_rotation_about(self.rotation, pivot_mm)
        motion[:3, 3] += self.shift_mm
        return motion

    def applied(self, camera: Camera, pivot_mm: FloatArray) -> Camera:
        """The corrected camera; the pivot (3,) is in world."""
        K = camera.intrinsics
        right = K.copy()
        right[:2, :2] *= np.exp(self.log_focal)
        right[:2, 2] += self.principal_point_px
        pixels_from_pixels = right @ np.linalg.inv(K)
        return Camera(pixels_from_pixels @ camera.projection @ self.motion_about(pivot_mm), camera.image_size)


def points_by_correction(camera: Camera, points_in_world_mm: FloatArray, pivot_mm: FloatArray) -> FloatArray:
    """How the projections of points change with a step of the correction of a camera: (N, 2, 9), px.

    Parameters
    ----------
    camera : as corrected so far.
    points_in_world_mm : (N, 3).
    pivot_mm : (3,), in world.
    """
    homogeneous = points_in_world_mm @ camera.projection[:, :3].T + camera.projection[:, 3]
    pixels = homogeneous[:, :2] / homogeneous[:, 2:]
    slopes = np.zeros((len(pixels), 2, PARAMETERS))
    for slope, point, pixel, depth in zip(slopes, points_in_world_mm, pixels, homogeneous[:, 2], strict=True):
        by_point = (camera.projection[:2, :3] - pixel[:, None] * camera.projection[2, :3]) / depth
        slope[:, :3] = by_point @ -rigid.skew(point - pivot_mm)
        slope[:, 3:6] = by_point
        slope[:, 6] = pixel - camera.intrinsics[:2, 2]
        slope[:, 7:9] = np.eye(2)
    return slopes
