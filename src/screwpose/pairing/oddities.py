"""Marks that are odd beside the others of a case: one screw marked twice, or one end far off.

These spoil no other pair, and a case that has one can be solved; what is made of the marks in question is doubtful.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np

from screwpose.errors import AnnotationError, GeometryError
from screwpose.files.case import Annotation, Case
from screwpose.files.findings import Finding
from screwpose.geometry import triangulate
from screwpose.pairing.hypotheses import Combination
from screwpose.pairing.segment import LandmarkNoise

_SAME_SIGMAS = 4.0  # two marks of one point differ by 1.4 sigma in each coordinate
_FITS_SIGMAS, _OFF_SIGMAS, _FURTHEST_SIGMAS = 3.0, 5.0, 25.0  # of a distance of two rays, in its own sigma
_LENGTH_SHARE = 0.35  # by which tip and centre may be too far apart or too near, where one of them is off
_ASSUMED_COUNTS = 4.0  # the noise that was assumed counts as so many residuals


def odd_marks(case: Case, noise: LandmarkNoise, best: Combination) -> Iterator[Finding]:
    """A warning for each mark that is odd in the best combination."""
    yield from marked_twice(case, noise, best)
    yield from one_end_off(case, noise, best)


def marked_twice(case: Case, noise: LandmarkNoise, best: Combination) -> Iterator[Finding]:
    """Marks without a partner that lie on another mark of their view."""
    for view, labels in best.unpaired.items():
        marks = case.annotations[view]
        for index, mark in enumerate(marks):
            if mark.label not in labels:
                continue
            away = [(_apart_px(mark, other), other.label) for other in marks if other.label != mark.label]
            distance_px, other = min(away, default=(np.inf, ""))
            if distance_px <= _SAME_SIGMAS * noise.sigma_px:
                yield Finding(
                    "warning",
                    f"screw {mark.label} in {view} is marked within {distance_px:.0f} px of screw {other}, and no mark "
                    "of another view is left for it: it may be the same screw twice",
                    case.path,
                    f"annotations.{view}[{index}]",
                    "each screw once in each view",
                    f"Take one of {mark.label} and {other} away, unless one screw lies behind the other.",
                    AnnotationError,
                )


def one_end_off(case: Case, noise: LandmarkNoise, best: Combination) -> Iterator[Finding]:
    """Two marks without a partner, of two views, that would be one screw but for one of their ends."""
    first, second = list(case.views)[:2]
    alone = {view: [m for m in case.annotations[view] if m.label in best.unpaired[view]] for view in (first, second)}
    cameras = [case.views[view].camera for view in (first, second)]
    sigma_px = np.sqrt(2.0) * noise.sigma_px * _scale(best.chi_square, best.degrees_of_freedom)
    for one, other in product(alone[first], alone[second]):
        models = {mark.model for mark in (one, other) if mark.model is not None}
        try:
            tip = triangulate(cameras, np.stack([one.tip_px, other.tip_px]))
            center = triangulate(cameras, np.stack([one.center_px, other.center_px]))
        except GeometryError:
            continue
        # A triangulated point is half the distance of the rays off in each view.
        apart = {"tip": 2.0 * tip.rms_px / sigma_px, "center": 2.0 * center.rms_px / sigma_px}
        worse = max(apart, key=lambda end: apart[end])
        length_mm = float(np.linalg.norm(tip.point_in_world_mm - center.point_in_world_mm))
        lengths_mm = [i.length_mm for i in case.implants.values() if len(models) == 0 or i.name in models]
        if (
            len(models) < 2
            and min(apart.values()) <= _FITS_SIGMAS
            and _OFF_SIGMAS <= apart[worse] <= _FURTHEST_SIGMAS
            and any(abs(length_mm - want) <= _LENGTH_SHARE * want for want in lengths_mm)
        ):
            yield Finding(
                "warning",
                f"{first} {one.label} and {second} {other.label} would be one screw but for the {worse}: its rays miss "
                f"each other by {apart[worse] * sigma_px:.0f} px",
                case.path,
                "annotations",
                remedy=f"Look where the {worse} of this screw is marked in both views.",
                kind=AnnotationError,
            )


def _scale(chi_square: float, degrees_of_freedom: int) -> float:
    """How much larger than assumed the noise is, by pairs that fit."""
    return float(np.sqrt((chi_square + _ASSUMED_COUNTS) / (degrees_of_freedom + _ASSUMED_COUNTS)))


def _apart_px(one: Annotation, other: Annotation) -> float:
    """The larger of the distances of tips and of centres."""
    tips, centers = np.asarray(one.tip_px) - other.tip_px, np.asarray(one.center_px) - other.center_px
    return float(max(np.linalg.norm(tips), np.linalg.norm(centers)))
