"""Which screw in one view may be which in another? Every pair that the rays allow, and the combinations of pairs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose._types import FloatArray
from screwpose.errors import GeometryError
from screwpose.files.case import Annotation, Case
from screwpose.geometry import Camera
from screwpose.pairing.loose import loosened
from screwpose.pairing.segment import LandmarkNoise, SegmentFit, fit_segment
from screwpose.pairing.segments import fit_segments

Labels = tuple[tuple[str, str], ...]
"""One screw's labels: (view, label) for each view in which it was marked, in the order of the views."""
Fit = Callable[[Sequence[Camera], FloatArray, FloatArray, float, LandmarkNoise], SegmentFit]
"""``fit(cameras, tips_px, centers_px, length_mm, noise)``: how well a pair is one screw, as `fit_segment`."""
SURE_MODEL_MARGIN = 9.2  # in chi-square, between two models of one screw: odds of 100 to 1


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One screw: what it is called in each view, which model it is, and the segment that its marks give.

    Parameters
    ----------
    runner_up : where the annotations leave the model open, the one that fits next best.
    runner_up_margin : how much larger its chi-square is.
    open_models : the other models that the landmarks leave open, the best first, with the segments they give.
    """

    labels: Labels
    model: str
    fit: SegmentFit
    runner_up: str | None = None
    runner_up_margin: float = np.inf
    open_models: tuple[tuple[str, SegmentFit], ...] = ()

    @property
    def name(self) -> str:
        """The screw in words: ``AP 1 = LAT b``."""
        return " = ".join(f"{view} {label}" for view, label in self.labels)

    @property
    def by_view(self) -> dict[str, str]:
        """The label in each view."""
        return dict(self.labels)

    def of_model(self, model: str) -> "Hypothesis":
        """The same screw as another model: where the landmarks leave that open, with the segment they give it, and its
        own model is then as open."""
        if model == self.model:
            return self
        fit = dict(self.open_models).get(model)
        if fit is None:
            return replace(self, model=model)
        others = ((self.model, self.fit), *(one for one in self.open_models if one[0] != model))
        return replace(
            self,
            model=model,
            fit=fit,
            runner_up=self.model,
            runner_up_margin=self.fit.chi_square - fit.chi_square,
            open_models=others,
        )


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

    @property
    def knows_length(self) -> bool:
        """Whether the fits ask how far tip and centre are apart."""
        return self._fit_marks is fit_segment

    def fits(self) -> list[SegmentFit]:
        """All fits so far that the rays allow."""
        return [one.fit for one in self._known.values() if one is not None]

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
    margins = {name: possible[name].chi_square - possible[best].chi_square for name in others}
    still_open = tuple((name, possible[name]) for name in others if margins[name] < SURE_MODEL_MARGIN)
    return Hypothesis(labels, best, possible[best], others[0], margins[others[0]], still_open)


def combinations(
    case: Case, noise: LandmarkNoise, count: int, table: HypothesisTable | None = None
) -> list[Combination]:
    """The most probable pairings, best first; all that are returned pair as many screws as the best one does.

    Parameters
    ----------
    count : at most so many. Two screws in two views have two, three have six; all of them are then returned.
    table : the case's hypotheses, where they were fitted before.
    """
    from screwpose.pairing.ranking import ranked_pairings  # which is made of the hypotheses here

    return ranked_pairings(case, noise, table, count).shown(count)


def combination_of(table: HypothesisTable, case: Case, screws: Sequence[Labels]) -> Combination:
    """An answer from the labels of its screws; a mark in one view alone has no partner."""
    hypotheses = tuple(h for h in (table.get(screw) for screw in screws if len(screw) > 1) if h is not None)
    paired = {key for hypothesis in hypotheses for key in hypothesis.labels}
    unpaired = {
        view: tuple(mark.label for mark in marks if (view, mark.label) not in paired)
        for view, marks in case.annotations.items()
    }
    return Combination(hypotheses, unpaired)
