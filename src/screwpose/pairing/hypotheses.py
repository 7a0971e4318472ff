"""Which screw in one view may be which in another? Every pair that the rays allow, and the combinations of pairs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import GeometryError
from screwpose.files.case import Annotation, Case
from screwpose.geometry import Camera
from screwpose.pairing.assignment import cheapest_assignments
from screwpose.pairing.loose import loosened
from screwpose.pairing.segment import LandmarkNoise, SegmentFit, fit_segment
from screwpose.pairing.segments import fit_segments

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
            self.fit([labels])
        return self._known[labels]

    def chi_square(self, labels: Labels) -> float:
        """Chi-square of a screw: 0 for a mark in one view alone, infinite where the geometry forbids it."""
        if len(labels) < 2:
            return 0.0
        hypothesis = self.get(labels)
        return np.inf if hypothesis is None else hypothesis.fit.chi_square

    def fit(self, screws: Iterable[Labels]) -> None:
        """Fit all of these that were not fitted yet, side by side: much faster than one after the other."""
        new = [labels for labels in dict.fromkeys(screws) if len(labels) > 1 and labels not in self._known]
        tasks = [(labels, model) for labels in new for model in self._models_of(labels)]
        if self._fit_marks is fit_segment:
            fits = self._fitted_together(tasks)
        else:
            fits = [self._fitted(*task) for task in tasks]
        of_screw: dict[Labels, dict[str, SegmentFit | None]] = {labels: {} for labels in new}
        for (labels, model), fit in zip(tasks, fits, strict=True):
            of_screw[labels][model] = fit
        self._known.update({labels: _best_model(labels, found) for labels, found in of_screw.items()})

    def _models_of(self, labels: Labels) -> list[str]:
        """Which models a screw may be: none, where it was marked as two different ones."""
        named = {model for model in (self._marks[key].model for key in labels) if model is not None}
        if len(named) > 1:
            return []
        return sorted(named) or list(self._case.implants)

    def _fitted(self, labels: Labels, model: str) -> SegmentFit | None:
        cameras, tips, centers = self._seen(labels)
        try:
            return self._fit_marks(cameras, tips, centers, self._case.implants[model].length_mm, self._noise)
        except GeometryError:
            return None  # parallel rays, or they meet behind a source

    def _fitted_together(self, tasks: Sequence[tuple[Labels, str]]) -> list[SegmentFit | None]:
        fits: dict[int, SegmentFit | None] = {}
        for views in sorted({len(labels) for labels, _ in tasks}):
            those = [index for index, (labels, _) in enumerate(tasks) if len(labels) == views]
            seen = [self._seen(tasks[index][0]) for index in those]
            lengths_mm = np.array([self._case.implants[tasks[index][1]].length_mm for index in those])
            together = fit_segments(
                [one[0] for one in seen],
                np.array([one[1] for one in seen]),
                np.array([one[2] for one in seen]),
                lengths_mm,
                self._noise,
            )
            fits.update(zip(those, together, strict=True))
        return [self._loosened(*task, fits[index]) for index, task in enumerate(tasks)]

    def _loosened(self, labels: Labels, model: str, fit: SegmentFit | None) -> SegmentFit | None:
        given = [self._case.views[view].sigma for view, _ in labels]
        sigmas = [None if sigma == "auto" else sigma for sigma in given]  # "auto": the landmarks contradict nothing
        if fit is None or not any(sigmas):
            return fit
        cameras, tips, centers = self._seen(labels)
        return loosened(fit, cameras, sigmas, tips, centers, self._case.implants[model].length_mm, self._noise)

    def _seen(self, labels: Labels) -> tuple[list[Camera], FloatArray, FloatArray]:
        """The cameras that see a screw, and its tips and centres (V, 2) there."""
        marks = [self._marks[key] for key in labels]
        cameras = [self._case.views[view].camera for view, _ in labels]
        return cameras, np.array([mark.tip_px for mark in marks]), np.array([mark.center_px for mark in marks])


def _best_model(labels: Labels, fits: Mapping[str, SegmentFit | None]) -> Hypothesis | None:
    possible = {name: fit for name, fit in fits.items() if fit is not None}
    if len(possible) < len(fits) or not possible:
        return None  # what the rays forbid they forbid every model; and a screw of two models is none
    best, *others = sorted(possible, key=lambda name: possible[name].chi_square)
    if not others:
        return Hypothesis(labels, best, possible[best])
    margin = possible[others[0]].chi_square - possible[best].chi_square
    return Hypothesis(labels, best, possible[best], others[0], margin)


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
    table.fit((*screw, (view, label)) for screw in tracks.screws for label in labels)
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
