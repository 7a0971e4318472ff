"""Why a pairing is open, in a sentence, and what would settle it.

What is asked for is tried: the best combination is taken for the truth, what another landmark, a third view, a better
known length or marks made twice would show is computed from it, and how much worse the other combination would then
fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import GeometryError
from screwpose.files.case import Case
from screwpose.geometry import Camera, rigid, triangulate
from screwpose.pairing.confidence import CONFIDENT_PROBABILITY
from screwpose.pairing.hypotheses import Combination, Hypothesis
from screwpose.pairing.overlap import rod_of
from screwpose.pairing.ranking import Ranking
from screwpose.pairing.segment import LandmarkNoise
from screwpose.pairing.segments import fit_segments

_KNOWN_LENGTH_SIGMA_MM = 0.2  # where the centre is marked at a point that the model has, and the length is its own
_HARMLESS_MM = 0.5
_ANOTHER_MM = 1e3  # to a screw of another model: further than any; not infinite, since all of them may be


@dataclass(frozen=True)
class Remedy:
    """Something more that one could know, and the probability of the best combination if it is right and that known."""

    what: str
    probability: float


def why_open(case: Case, noise: LandmarkNoise, ranking: Ranking) -> str | None:
    """In one sentence, which screws could be others, in which view, and what would settle it.

    Parameters
    ----------
    ranking : its most probable combination is explained against the next one.

    Returns
    -------
    None where there is no other combination.
    """
    if len(ranking.combinations) < 2:
        return None
    first, second = np.argsort(-ranking.probabilities, kind="stable")[:2]
    best, other = ranking.combinations[first], ranking.combinations[second]
    words = _what_differs(best, other)
    moved_mm = _moved_mm(best, other)
    if moved_mm is not None and moved_mm < _HARMLESS_MM:
        return f"{words}; by their marks no screw would lie more than {moved_mm:.1f} mm elsewhere for it"
    log_odds = float(np.log(max(ranking.probabilities[first], 1e-300) / max(ranking.probabilities[second], 1e-300)))
    settled = remedies(case, noise, best, other, log_odds, ranking.scale)
    if not settled:
        return words
    top = max(settled, key=lambda one: one.probability)
    if top.probability >= CONFIDENT_PROBABILITY:
        return f"{words}; {top.what} would settle it"
    return f"{words}; {top.what} would tell most, and not settle it (a probability of {top.probability:.2f})"


def remedies(
    case: Case, noise: LandmarkNoise, best: Combination, other: Combination, log_odds: float, scale: float
) -> list[Remedy]:
    """What each further piece of knowledge would make of two combinations, if the first one is right.

    Parameters
    ----------
    log_odds : of the two as it is.
    scale : of the noise, as a multiple of `noise`.
    """
    ours, theirs = _only_in(best, other), _only_in(other, best)
    if not ours or not theirs:
        return []
    sigma_px = noise.sigma_px * scale
    gains = {
        "a third landmark at the far end of each implant": _gain_of_far_ends(case, ours, theirs, sigma_px),
        "a third view from between": _gain_of_view(case, ours, theirs, sigma_px),
        "the exact distance from tip to marked centre": _gain_of_length(case, ours, theirs, noise),
        "marking these screws once more": _gain_of_marks(case, ours, theirs, noise, scale),
    }
    return [
        Remedy(what, float(1.0 / (1.0 + np.exp(-np.clip(log_odds + 0.5 * gain, -500.0, 500.0)))))
        for what, gain in gains.items()
    ]


def _only_in(one: Combination, other: Combination) -> list[Hypothesis]:
    labels = {hypothesis.labels for hypothesis in other.hypotheses}
    return [hypothesis for hypothesis in one.hypotheses if hypothesis.labels not in labels]


def _what_differs(best: Combination, other: Combination) -> str:
    ours, theirs = _only_in(best, other), _only_in(other, best)
    names = " and ".join(hypothesis.name for hypothesis in ours)
    if not ours:
        return f"{' and '.join(one.name for one in theirs)} may be one screw, though taken for marks of different ones"
    if not theirs:
        return f"{names} may be marks of different screws, each shown in one view only"
    if {key for one in ours for key in one.labels} == {key for one in theirs for key in one.labels}:
        views = _swapped_views(ours, theirs)
        return f"{names} may be the other way round{f' in {views}' if views else ''}"
    others = " and ".join(hypothesis.name for hypothesis in theirs)
    return f"{names} may be {others} instead"


def _swapped_views(ours: Sequence[Hypothesis], theirs: Sequence[Hypothesis]) -> str:
    """The views in which the labels change places, the first view's held."""
    first = ours[0].labels[0][0]
    by_first = {one.by_view.get(first): one.by_view for one in theirs}
    views = {
        view
        for one in ours
        for view, label in one.labels
        if view != first and by_first.get(one.by_view.get(first), {}).get(view) != label
    }
    return " and ".join(sorted(views))


def _moved_mm(best: Combination, other: Combination) -> float | None:
    """By how much tips and centres would lie elsewhere, as sets; None where one has another number of screws."""
    from scipy.optimize import linear_sum_assignment

    ours, theirs = _only_in(best, other), _only_in(other, best)
    if len(ours) != len(theirs) or not ours:
        return None
    away = np.array([[_apart_mm(one, two) for two in theirs] for one in ours])
    rows, columns = linear_sum_assignment(away)
    return float(away[rows, columns].max())


def _apart_mm(one: Hypothesis, two: Hypothesis) -> float:
    if one.model != two.model:
        return _ANOTHER_MM
    tips, centers = one.fit.tip_mm - two.fit.tip_mm, one.fit.center_mm - two.fit.center_mm
    return float(max(np.linalg.norm(tips), np.linalg.norm(centers)))


def _far_end_mm(case: Case, hypothesis: Hypothesis) -> FloatArray:
    along = hypothesis.fit.center_mm - hypothesis.fit.tip_mm
    length_mm = rod_of(case.implants[hypothesis.model]).length_mm
    return np.asarray(hypothesis.fit.tip_mm + length_mm * along / max(float(np.linalg.norm(along)), 1e-12))


def _mark_of(
    case: Case, ours: Sequence[Hypothesis], points_mm: Sequence[FloatArray]
) -> dict[tuple[str, str], FloatArray]:
    """Where points of the screws would be marked, by view and label."""
    return {
        (view, label): case.views[view].camera.project(point)
        for one, point in zip(ours, points_mm, strict=True)
        for view, label in one.labels
    }


def _gain_of_far_ends(case: Case, ours: Sequence[Hypothesis], theirs: Sequence[Hypothesis], sigma_px: float) -> float:
    """The far ends' rays would miss each other in the other combination."""
    try:
        marks = _mark_of(case, ours, [_far_end_mm(case, one) for one in ours])
        gain = 0.0
        for one in theirs:
            if all(key in marks for key in one.labels):
                cameras = [case.views[view].camera for view, _ in one.labels]
                met = triangulate(cameras, np.array([marks[key] for key in one.labels]))
                gain += float((met.residuals_px**2).sum()) / sigma_px**2
    except GeometryError:
        return 0.0
    return gain


def _gain_of_view(case: Case, ours: Sequence[Hypothesis], theirs: Sequence[Hypothesis], sigma_px: float) -> float:
    """In a third view the other combination's screws would lie beside the marks, as sets."""
    from scipy.optimize import linear_sum_assignment

    cameras = [view.camera for view in case.views.values()]
    middle_mm = np.mean([0.5 * (one.fit.tip_mm + one.fit.center_mm) for one in ours], axis=0)
    camera = between(cameras[0], cameras[1], middle_mm)
    try:
        here = [camera.project(np.stack([one.fit.tip_mm, one.fit.center_mm])) for one in ours]
        there = [camera.project(np.stack([one.fit.tip_mm, one.fit.center_mm])) for one in theirs]
    except GeometryError:
        return 0.0
    # The mark is off, and so is the prediction from the two views that there are.
    squares = np.array([[((a - b) ** 2).sum() for b in there] for a in here]) / (2.0 * sigma_px**2)
    rows, columns = linear_sum_assignment(squares)
    return float(squares[rows, columns].sum())


def between(one: Camera, other: Camera, middle_mm: FloatArray) -> Camera:
    """A view from half way between two, the first one turned about a point; of two directions the one that is less
    than a right angle away."""
    first, second = (np.asarray(camera.viewing_axis_in_world) for camera in (one, other))
    if first @ second < 0.0:
        second = -second
    axis = np.cross(first, second)
    norm = float(np.linalg.norm(axis))
    half_rad = 0.5 * float(np.arctan2(norm, first @ second))
    turn = rigid.exp_rotation(-half_rad * axis / max(norm, 1e-12))
    moved = rigid.from_rotation_about(turn, middle_mm)
    return Camera(one.projection @ moved, one.image_size)


def _refitted(case: Case, ours: Sequence[Hypothesis], theirs: Sequence[Hypothesis], noise: LandmarkNoise) -> float:
    """The other combination's chi-square where all marks are exactly where ours would have them."""
    tips = _mark_of(case, ours, [one.fit.tip_mm for one in ours])
    centers = _mark_of(case, ours, [one.fit.center_mm for one in ours])
    total = 0.0
    for one in theirs:
        if all(key in tips for key in one.labels):
            cameras = [case.views[view].camera for view, _ in one.labels]
            at_tip, at_center = (np.array([[marks[key] for key in one.labels]]) for marks in (tips, centers))
            length_mm = np.array([case.implants[one.model].length_mm])
            (fit,) = fit_segments([cameras], at_tip, at_center, length_mm, noise)
            total += 1e6 if fit is None else fit.chi_square
    return total


def _gain_of_length(
    case: Case, ours: Sequence[Hypothesis], theirs: Sequence[Hypothesis], noise: LandmarkNoise
) -> float:
    """By how much more the other combination's lengths would contradict the models."""
    exact = LandmarkNoise(noise.sigma_px, min(_KNOWN_LENGTH_SIGMA_MM, noise.length_sigma_mm))
    return max(_refitted(case, ours, theirs, exact) - _refitted(case, ours, theirs, noise), 0.0)


def _gain_of_marks(
    case: Case, ours: Sequence[Hypothesis], theirs: Sequence[Hypothesis], noise: LandmarkNoise, scale: float
) -> float:
    """A second set of marks says as much again as one set would, were it exact."""
    return _refitted(case, ours, theirs, LandmarkNoise(noise.sigma_px * scale, noise.length_sigma_mm))
