"""Which screw in one view may be which in another? Every pair that the rays allow, and the combinations of pairs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import GeometryError
from screwpose.files.case import Annotation, Case
from screwpose.geometry import Camera
from screwpose.pairing.assignment import cheapest_assignments
from screwpose.pairing.loose import loosened
from screwpose.pairing.segment import LandmarkNoise, SegmentFit, fit_segment

# A pair so far from its landmarks (15 px in one of them at 2 px of noise) is no pair: two marks of different screws.
_NO_PAIR_CHI_SQUARE = 60.0
# Assignments with fewer pairs rank among those with all, so more are ranked than are asked for; with more than two
# views every one of them is continued, so fewer.
_RANKED_OF_TWO_VIEWS = 400
_RANKED_OF_MORE = 24
Labels = tuple[tuple[str, str], ...]
"""One screw's labels: (view, label) for each view in which it was marked, in the order of the views."""
Fit = Callable[[Sequence[Camera], FloatArray, FloatArray, float, LandmarkNoise], SegmentFit]
"""``fit(cameras, tips_px, centers_px, length_mm, noise)``: how well a pair is one screw, as `fit_segment`."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One screw: what it is called in each view, which model it is, and the segment that its marks give.

    Parameters
    ----------
    runner_up : where the annotations leave the model open, the one that fits next best.
    runner_up_margin : how much larger its chi-square is.
    """

    labels: Labels
    model: str
    fit: SegmentFit
    runner_up: str | None = None
    runner_up_margin: float = np.inf

    @property
    def name(self) -> str:
        """The screw in words: ``AP 1 = LAT b``."""
        return " = ".join(f"{view} {label}" for view, label in self.labels)

    @property
    def by_view(self) -> dict[str, str]:
        """The label in each view."""
        return dict(self.labels)


@dataclass(frozen=True, eq=False)
class Combination:
    """One answer to the pairing: a hypothesis for each screw, and what stays alone.

    Parameters
    ----------
    unpaired : for every view, the labels that have no partner.
    chi_square, degrees_of_freedom : sums over the screws.
    """

    hypotheses: tuple[Hypothesis, ...]
    unpaired: Mapping[str, tuple[str, ...]]

    @property
    def chi_square(self) -> float:
        """Sum over the screws."""
        return float(sum(hypothesis.fit.chi_square for hypothesis in self.hypotheses))

    @property
    def degrees_of_freedom(self) -> int:
        """Sum over the screws."""
        return sum(hypothesis.fit.degrees_of_freedom for hypothesis in self.hypotheses)


class HypothesisTable:
    """All hypotheses of a case, each fitted once."""

    def __init__(self, case: Case, noise: LandmarkNoise, fit: Fit = fit_segment) -> None:
        self._case = case
        self._noise = noise
        self._fit_marks = fit
        self._marks: dict[tuple[str, str], Annotation] = {
            (view, mark.label): mark for view, marks in case.annotations.items() for mark in marks
        }
        self._known: dict[Labels, Hypothesis | None] = {}

    def get(self, labels: Labels) -> Hypothesis | None:
        """The best model's hypothesis for a screw marked in two views or more; None where the geometry forbids it."""
        if labels not in self._known:
            self._known[labels] = self._fit(labels)
        return self._known[labels]

    def chi_square(self, labels: Labels) -> float:
        """Chi-square of a screw: 0 for a mark in one view alone, infinite where the geometry forbids it."""
        if len(labels) < 2:
            return 0.0
        hypothesis = self.get(labels)
        return np.inf if hypothesis is None else hypothesis.fit.chi_square

    def _fit(self, labels: Labels) -> Hypothesis | None:
        cameras = [self._case.views[view].camera for view, _ in labels]
        given = [self._case.views[view].sigma for view, _ in labels]
        sigmas = [None if sigma == "auto" else sigma for sigma in given]  # "auto": the landmarks contradict nothing
        marks = [self._marks[key] for key in labels]
        tips, centers = np.array([mark.tip_px for mark in marks]), np.array([mark.center_px for mark in marks])
        named = {mark.model for mark in marks if mark.model is not None}
        if len(named) > 1:
            return None  # marked as two different models: not one screw
        fits = {}
        for name in sorted(named) or self._case.implants:
            try:
                length_mm = self._case.implants[name].length_mm
                fits[name] = self._fit_marks(cameras, tips, centers, length_mm, self._noise)
                if self._fit_marks is fit_segment and any(sigmas):
                    fits[name] = loosened(fits[name], cameras, sigmas, tips, centers, length_mm, self._noise)
            except GeometryError:
                return None  # parallel rays, or they meet behind a source: for every model alike
        best, *others = sorted(fits, key=lambda name: fits[name].chi_square)
        if not others:
            return Hypothesis(labels, best, fits[best])
        margin = fits[others[0]].chi_square - fits[best].chi_square
        return Hypothesis(labels, best, fits[best], others[0], margin)


def combinations(
    case: Case, noise: LandmarkNoise, count: int, table: HypothesisTable | None = None
) -> list[Combination]:
    """The pairings that explain the landmarks best, best first.

    View after view, every screw found so far is given a mark of the next view or none. All that are returned pair as
    many screws as the best one does.

    Parameters
    ----------
    count : at most so many. Two screws in two views have two, three have six; all of them are then returned.
    table : the case's hypotheses, where they were fitted before.
    """
    table = table or HypothesisTable(case, noise)
    ranked = _RANKED_OF_TWO_VIEWS if len(case.views) == 2 else _RANKED_OF_MORE
    first, *others = case.views
    beam = [_Tracks(tuple(((first, mark.label),) for mark in case.annotations[first]), 0.0)]
    for view in others:
        labels = [mark.label for mark in case.annotations[view]]
        beam = sorted(
            (longer for tracks in beam for longer in _extended(table, tracks, view, labels, ranked)), key=_by_cost
        )
        beam = beam[:ranked]
    found = [_combination(table, case, tracks.screws) for tracks in beam]
    screws = len(found[0].hypotheses) if found else 0
    return [one for one in found if screws and len(one.hypotheses) == screws][:count]


@dataclass(frozen=True)
class _Tracks:
    """The screws after some of the views, and what they cost: chi-square, and a price for each that found no mark."""

    screws: tuple[Labels, ...]
    cost: float


def _by_cost(tracks: _Tracks) -> float:
    return tracks.cost


def _extended(table: HypothesisTable, tracks: _Tracks, view: str, labels: Sequence[str], ranked: int) -> list[_Tracks]:
    """Every way, cheapest first, to continue the screws with the marks of one more view."""
    costs = np.array(
        [
            [table.chi_square((*screw, (view, label))) - table.chi_square(screw) for label in labels]
            for screw in tracks.screws
        ]
    ).reshape(len(tracks.screws), len(labels))
    longer = []
    for assignment in cheapest_assignments(costs, _NO_PAIR_CHI_SQUARE, ranked):
        continued = [
            screw if column is None else (*screw, (view, labels[column]))
            for screw, column in zip(tracks.screws, assignment.columns, strict=True)
        ]
        new = [((view, label),) for column, label in enumerate(labels) if column not in assignment.columns]
        longer.append(_Tracks((*continued, *new), tracks.cost + assignment.cost))
    return longer


def _combination(table: HypothesisTable, case: Case, screws: Sequence[Labels]) -> Combination:
    hypotheses = tuple(h for h in (table.get(screw) for screw in screws if len(screw) > 1) if h is not None)
    paired = {key for hypothesis in hypotheses for key in hypothesis.labels}
    unpaired = {
        view: tuple(mark.label for mark in marks if (view, mark.label) not in paired)
        for view, marks in case.annotations.items()
    }
    return Combination(hypotheses, unpaired)
