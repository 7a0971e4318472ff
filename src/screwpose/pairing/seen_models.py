"""Which model is a screw, where its landmarks leave that open? The X-rays are asked.

Landmarks tell models apart by their length alone; thickness, head and tower show in the images. Each model that is
left is laid where the first one was registered, at the roll that explains most, and fitted while the other screws
stand still; then the images compare the two.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose._progress import Progress
from screwpose._types import FloatArray
from screwpose.files.case import Case
from screwpose.geometry import rigid
from screwpose.pairing.hypotheses import Hypothesis
from screwpose.pairing.thickness import Thickness, body_of
from screwpose.registration import align, turned
from screwpose.registration.checks import preference
from screwpose.registration.thickness_fit import Body, energies_of_candidates, fit_at_scale, standing

_ROLLS_RAD = np.radians(np.arange(0.0, 360.0, 15.0))
_FEW = 2  # rolls that are fitted: often half a turn apart
_MOST_MODELS = 6


@dataclass(frozen=True, eq=False)
class _Candidate:
    hypothesis: Hypothesis
    body: Body
    pose: FloatArray

    @property
    def model(self) -> str:
        return self.hypothesis.model


def seen_models(
    case: Case,
    thickness: Thickness,
    hypotheses: Sequence[Hypothesis],
    poses: Sequence[FloatArray],
    progress: Progress,
) -> tuple[list[Hypothesis], list[FloatArray]]:
    """The screws with the models that landmarks and X-rays together say they are, and their poses (4, 4).

    The margin of a model over the next best is the difference of their chi-squares, and the square of the standard
    deviations by which the images prefer it.

    Parameters
    ----------
    poses : (4, 4) each, registered.
    progress : told before each screw that is asked about; what it raises stops the work.
    """
    found, best = list(hypotheses), list(poses)
    for index, hypothesis in enumerate(hypotheses):
        if hypothesis.open_models:
            progress(index / len(hypotheses), f"comparing models of screw {hypothesis.name}")
            found[index], best[index] = _of_one(case, thickness, found, best, index)
    return found, best


def _of_one(
    case: Case, thickness: Thickness, hypotheses: Sequence[Hypothesis], poses: Sequence[FloatArray], index: int
) -> tuple[Hypothesis, FloatArray]:
    bodies = [body_of(case, thickness, one) for one in hypotheses]
    first, implant, start = hypotheses[index], bodies[index].implant, poses[index]
    candidates = [_Candidate(first, bodies[index], _fitted(thickness, bodies, poses, index, start))]
    ends_mm = rigid.transform(start, np.stack([implant.tip_mm, implant.center_mm]))
    for name, fit in first.open_models[:_MOST_MODELS]:
        other = replace(first, model=name, fit=fit)
        own = body_of(case, thickness, other)
        others = [*bodies[:index], own, *bodies[index + 1 :]]
        rolled = _best_rolls(thickness, others, poses, index, align(own.implant, *ends_mm))
        fitted = [_fitted(thickness, others, poses, index, pose) for pose in rolled]
        candidates += [_Candidate(other, own, pose) for pose in fitted]
    finest = thickness.targets[thickness.stages[-1][0]]
    fixed = standing(finest, bodies, poses, index)

    def margin(one: _Candidate, other: _Candidate) -> float:
        by = preference(finest, [one.body], [one.pose], [other.pose], fixed, [other.body])
        return other.hypothesis.fit.chi_square - one.hypothesis.fit.chi_square + by * abs(by)

    best = candidates[0]
    for candidate in candidates[1:]:
        if margin(candidate, best) > 0.0:
            best = candidate
    margins = [(margin(best, one), one.model) for one in candidates if one.model != best.model]
    least, runner_up = min(margins, default=(np.inf, None))
    known = replace(best.hypothesis, runner_up=runner_up, runner_up_margin=least, open_models=())
    return known, start if best is candidates[0] else best.pose


def _best_rolls(
    thickness: Thickness, bodies: Sequence[Body], poses: Sequence[FloatArray], index: int, laid: FloatArray
) -> list[FloatArray]:
    """The body at the rolls that explain most and more than those beside them, on the coarsest images."""
    views = thickness.targets[thickness.stages[0][0]]
    trials = [turned(bodies[index].implant, laid, float(angle)) for angle in _ROLLS_RAD]
    energies = np.array(
        energies_of_candidates(views, bodies, [*poses[:index], laid, *poses[index + 1 :]], index, trials)
    )
    is_peak = (energies >= np.roll(energies, 1)) & (energies >= np.roll(energies, -1))
    order = [int(place) for place in np.argsort(-energies, kind="stable") if is_peak[place]]
    return [trials[place] for place in order[:_FEW]]


def _fitted(
    thickness: Thickness, bodies: Sequence[Body], poses: Sequence[FloatArray], index: int, start: FloatArray
) -> FloatArray:
    """One body's pose through all scales, the others as they stand."""
    for scale, stage in thickness.stages:
        views = thickness.targets[scale]
        fixed = standing(views, bodies, [*poses[:index], start, *poses[index + 1 :]], index)
        fit = fit_at_scale(
            views, [bodies[index]], [start], stage.mark_sigma_px, stage.iterations, stage.enough_mm, fixed
        )
        start = fit.world_from_cad[0]
    return start
