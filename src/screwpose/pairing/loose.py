"""A pair of marks in cameras that are not exact: how well they are one screw, whatever the cameras may have been."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import Camera
from screwpose.geometry.correction import CameraSigma
from screwpose.pairing.segment import LandmarkNoise, SegmentFit
from screwpose.registration.bundle import MarkedSegment, adjust

_HOPELESS_CHI_SQUARE = 1e5
_EXACT = CameraSigma(0.0, 0.0, 0.0, 0.0)


def loosened(
    fit: SegmentFit,
    cameras: Sequence[Camera],
    sigmas: Sequence[CameraSigma | None],
    tips_px: FloatArray,
    centers_px: FloatArray,
    length_mm: float,
    noise: LandmarkNoise,
) -> SegmentFit:
    """A segment's fit with the cameras' sigmas in its chi-square.

    Each pair has the cameras to itself: that all screws share them is left to registration. The degrees of freedom stay
    the same, since what a correction gains it also costs.

    Parameters
    ----------
    fit : in the reported cameras.
    sigmas : of each of the V cameras; None for one that is exact.
    """
    if fit.chi_square >= _HOPELESS_CHI_SQUARE or all(sigma is None for sigma in sigmas):
        return fit
    segment = MarkedSegment(tuple(range(len(cameras))), np.asarray(tips_px), np.asarray(centers_px), length_mm)
    middle_mm = 0.5 * (fit.tip_mm + fit.center_mm)
    found = adjust(
        cameras, [sigma or _EXACT for sigma in sigmas], [segment], middle_mm, noise.sigma_px, noise.length_sigma_mm
    )
    return replace(fit, chi_square=min(found.chi_square, fit.chi_square))
