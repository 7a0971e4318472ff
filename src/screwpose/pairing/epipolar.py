"""Pairing by epipolar distances alone: the baseline that knows no CAD.

Its chi-square is that of the distances of tips and centres from each other's epipolar lines. Where two screws lie in
one epipolar plane, as the left and the right one of a level often do, it has nothing to go by.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations as choose

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import Camera, epipolar_distances_px
from screwpose.pairing.segment import LandmarkNoise, SegmentFit, triangulated_segment


def fit_epipolar(
    cameras: Sequence[Camera], tips_px: FloatArray, centers_px: FloatArray, length_mm: float, noise: LandmarkNoise
) -> SegmentFit:
    """The triangulated segment, with the chi-square of its epipolar distances.

    As `fit_segment`, but the length is not looked at. A mark and an epipolar line are both off by the noise, so a
    distance has ``sqrt(2)`` times its sigma (exactly so where the views see the plane at the same scale).

    Raises
    ------
    GeometryError
        The views are parallel, or the rays meet behind a source.

    References
    ----------
    Esfandiari et al. (2018), Int. J. CARS 13, 1269: pedicle screws paired across views by epipolar distances.
    """
    segment = triangulated_segment(cameras, tips_px, centers_px, length_mm, noise)
    squares = [
        epipolar_distances_px(cameras[i], cameras[j], marks[i : i + 1], marks[j : j + 1])[0, 0] ** 2
        for i, j in choose(range(len(cameras)), 2)
        for marks in (tips_px, centers_px)
    ]
    # Of the V (V - 1) / 2 distances of a point in V views, 2 V - 3 are free.
    free = 2 * len(cameras) - 3
    share = free / (len(squares) / 2)
    chi_square = share * float(np.sum(squares)) / (2.0 * noise.sigma_px**2)
    return replace(segment, chi_square=chi_square, degrees_of_freedom=2 * free)
