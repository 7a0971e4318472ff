"""What is not as it should be: one dial each, and what each of them does.

A dial at 0 does nothing. What it does follows from the case's seed and from streams of its own, so that turning one
leaves everything else of the case as it is: directions and signs are drawn whether they are used or not.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import InputError
from screwpose.geometry.camera import Camera
from screwpose.geometry.rigid import exp_rotation, from_rotation_about
from screwpose.simulation.streams import stream

_MOVED_VIEW = "LAT"


@dataclass(frozen=True)
class Imperfections:
    """One dial each. Amounts are exact; signs and directions are drawn.

    Parameters
    ----------
    landmark_noise_px : standard deviation of the marks, in u and in v, Gaussian.
    tip_bias_mm, center_bias_mm : how far towards the head the tip and the centre are marked, along the screw's axis;
        negative beyond the tip.
    focal_error_percent : of the focal length of each reported P, too long or too short.
    principal_error_px : of the principal point of each reported P.
    rotation_error_deg, translation_error_mm : of the LAT view against the AP view in the reported P: by how much LAT is
        turned about its isocentre, and moved. AP is exact.
    pincushion, s_distortion_deg : of the image, as a share of the radius and as an angle at half the shorter side. P
        stays that of the image without distortion; the marks are made in the image as it is.
    cad_length_mm, cad_diameter_mm : how much longer and thicker the shank of the given CAD is than what was X-rayed.
        Tip and CAD frame stay: the truth is the pose of the X-rayed implant's tip and axis.
    motion_deg, motion_mm : how much the patient turns about LAT's isocentre and moves between AP and LAT. The truth is
        that of AP.

    Raises
    ------
    InputError
        A dial that is not finite, or negative where only the direction could be; names the field.
    """

    landmark_noise_px: float = 1.5
    tip_bias_mm: float = 0.0
    center_bias_mm: float = 0.0
    focal_error_percent: float = 0.0
    principal_error_px: float = 0.0
    rotation_error_deg: float = 0.0
    translation_error_mm: float = 0.0
    pincushion: float = 0.0
    s_distortion_deg: float = 0.0
    cad_length_mm: float = 0.0
    cad_diameter_mm: float = 0.0
    motion_deg: float = 0.0
    motion_mm: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least, most = _BOUNDS[field.name]
            if not math.isfinite(value) or not least <= value <= most:
                raise InputError(f"{value:g} is out of range", field=field.name, expected=f"from {least:g} to {most:g}")


_BOUNDS = {
    "landmark_noise_px": (0.0, 100.0),
    "tip_bias_mm": (-20.0, 20.0),
    "center_bias_mm": (-20.0, 20.0),
    "focal_error_percent": (0.0, 30.0),
    "principal_error_px": (0.0, 500.0),
    "rotation_error_deg": (0.0, 45.0),
    "translation_error_mm": (0.0, 200.0),
    "pincushion": (-0.1, 0.2),
    "s_distortion_deg": (-20.0, 20.0),
    "cad_length_mm": (-15.0, 15.0),
    "cad_diameter_mm": (-2.0, 2.0),
    "motion_deg": (0.0, 45.0),
    "motion_mm": (0.0, 100.0),
}


def true_cameras(
    cameras: Mapping[str, Camera], isocenters: Mapping[str, FloatArray], imperfections: Imperfections, seed: int
) -> dict[str, Camera]:
    """What images are made with: cameras of the patient as he lay for AP.

    A patient who moves for LAT, with all that is in him, is the same as a C-arm that moves the other way.
    """
    motion = _motion(seed, "motion", imperfections.motion_deg, imperfections.motion_mm, isocenters[_MOVED_VIEW])
    moved = {
        name: camera.projection @ motion if name == _MOVED_VIEW else camera.projection
        for name, camera in cameras.items()
    }
    return {name: Camera(projection, cameras[name].image_size) for name, projection in moved.items()}


def reported_cameras(
    cameras: Mapping[str, Camera], isocenters: Mapping[str, FloatArray], imperfections: Imperfections, seed: int
) -> dict[str, Camera]:
    """What the case says that the cameras were: with the errors of P, and not knowing of the patient's motion."""
    turn = _motion(
        seed,
        "relative pose",
        imperfections.rotation_error_deg,
        imperfections.translation_error_mm,
        isocenters[_MOVED_VIEW],
    )
    rng = stream(seed, "intrinsics")
    reported = {}
    for name, camera in cameras.items():
        sign = 1.0 if rng.random() < 0.5 else -1.0
        scale = 1.0 + 0.01 * sign * imperfections.focal_error_percent
        angle = rng.uniform(-np.pi, np.pi)
        u, v = imperfections.principal_error_px * np.array([np.cos(angle), np.sin(angle)])
        K = camera.intrinsics
        wrong = K * [[scale, scale, 1.0], [1.0, scale, 1.0], [1.0, 1.0, 1.0]] + [[0, 0, u], [0, 0, v], [0, 0, 0]]
        # As it stands where nothing is wrong: not a bit of P is to change then.
        is_exact = imperfections.focal_error_percent == 0.0 and imperfections.principal_error_px == 0.0
        projection = camera.projection if is_exact else wrong @ np.linalg.solve(K, camera.projection)
        if name == _MOVED_VIEW:
            projection = projection @ turn
        reported[name] = Camera(projection, camera.image_size)
    return reported


def _motion(seed: int, name: str, angle_deg: float, shift_mm: float, center_mm: FloatArray) -> FloatArray:
    """A rigid motion (4, 4): a turn about an axis through a point, and a shift, both in drawn directions."""
    axis, direction = stream(seed, name).normal(size=(2, 3))
    motion = from_rotation_about(exp_rotation(np.radians(angle_deg) * axis / np.linalg.norm(axis)), center_mm)
    motion[:3, 3] += shift_mm * direction / np.linalg.norm(direction)
    return motion if angle_deg or shift_mm else np.eye(4)
