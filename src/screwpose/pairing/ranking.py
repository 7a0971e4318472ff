"""The ways to pair the marks of a case, with the probability of each, of every pair, and of every mark to stand alone.

The best assignments are enumerated exactly (Murty's algorithm) for each of several amounts of noise; those of all
amounts together are then weighed by the model of `screwpose.pairing.posterior`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose._types import FloatArray
from screwpose.files.case import Case
from screwpose.geometry import Camera
from screwpose.pairing.assignment import cheapest_assignments
from screwpose.pairing.confidence import probabilities
from screwpose.pairing.hypotheses import Combination, Hypothesis, HypothesisTable, Labels, combination_of
from screwpose.pairing.overlap import overlaps_mm, rod_of
from screwpose.pairing.posterior import (
    PairingModel,
    Spread,
    log_alone,
    log_scale_evidence,
    log_together,
    scale_mean,
    spread_of,
)
from screwpose.pairing.segment import LandmarkNoise

# The factors of the noise for which assignments are enumerated; in between the same ones are the best.
_SCALES = (0.35, 0.6, 1.0, 1.7, 3.0, 5.0)
_RANKED, _RANKED_OF_MORE_VIEWS = 60, 24
# Without the model: a pair so far from its landmarks (15 px in one of them at 2 px of noise) is no pair.
_ALONE_CHI_SQUARE, _RANKED_BY_CHI_SQUARE = 60.0, 400
_NEGLIGIBLE = 16.0  # logarithm: what is a ten-millionth as probable as the best changes nothing
_MANY = 1e7  # the price of a mark that stays alone where as many pairs as possible are wanted
_RAY_REACH_MM = 100.0  # a screw lies no further than this along its ray from where the others are
_RIM_PX = 16.0  # nobody marks what is nearer to the border
# Implants that stand in each other by more than what marks are off are not where these marks say.
_OVERLAP_SIGMA_MM, _MOST_OVERLAP_SIGMAS = 1.5, 4.0


@dataclass(frozen=True, eq=False)
class Ranking:
    """The ways to pair a case's marks.

    Parameters
    ----------
    combinations : best first.
    probabilities : (K,), of each; their sum is 1.
    scale : by how much larger than assumed the noise seems to be, by the best combination and what is known beforehand.
    log_evidence : the logarithm of all weights together, against no two marks being of one screw.
    """

    combinations: tuple[Combination, ...]
    probabilities: FloatArray
    scale: float
    log_evidence: float = -np.inf

    @property
    def most_probable(self) -> Combination:
        """The one with the largest probability: not the first, once more is known than was when they were ranked."""
        return self.combinations[int(np.argmax(self.probabilities))]

    def shown(self, count: int) -> list[Combination]:
        """At most so many of those that pair as many screws as the best one does, which is the first."""
        most = len(self.combinations[0].hypotheses) if self.combinations else 0
        return [one for one in self.combinations if most and len(one.hypotheses) == most][:count]

    def probability_of(self, combination: Combination) -> float:
        """Of one of the combinations; 0 of another, which is then less probable than all that were kept."""
        index = next((i for i, one in enumerate(self.combinations) if one is combination), None)
        return 0.0 if index is None else float(self.probabilities[index])

    def with_probabilities(self, known: Mapping[Combination, float]) -> "Ranking":
        """The same where more is known of some combinations, without changing what they have together."""
        changed = [known.get(one, old) for one, old in zip(self.combinations, self.probabilities, strict=True)]
        return replace(self, probabilities=np.array(changed))

    def weighed(self, log_odds: Mapping[Hypothesis, float]) -> "Ranking":
        """The same where it is known of some pairs how much more probable something is, that was seen, if they are
        pairs."""
        gains = [sum(log_odds.get(pair, 0.0) for pair in one.hypotheses) for one in self.combinations]
        weights = self.probabilities * np.exp(np.array(gains) - max(gains, default=0.0))
        return replace(self, probabilities=weights / weights.sum())

    def with_pairs(self, others: Mapping[Hypothesis, Hypothesis]) -> tuple["Ranking", dict[Combination, Combination]]:
        """The same where some pairs are known to be of other models; and what has become of each combination."""
        changed = {
            one: replace(one, hypotheses=tuple(others.get(pair, pair) for pair in one.hypotheses))
            for one in self.combinations
        }
        return replace(self, combinations=tuple(changed.values())), changed

    def pair_probability(self, labels: Labels) -> float:
        """That these marks are of one screw, and of no other view's."""
        holds = [any(h.labels == labels for h in one.hypotheses) for one in self.combinations]
        return float(min(self.probabilities[holds].sum(), 1.0))

    def alone_probability(self, view: str, label: str) -> float:
        """That a mark has no partner."""
        holds = [label in one.unpaired[view] for one in self.combinations]
        return float(min(self.probabilities[holds].sum(), 1.0))


def ranked_pairings(
    case: Case,
    noise: LandmarkNoise,
    table: HypothesisTable | None = None,
    alternatives: int = 6,
    model: PairingModel | None = None,
) -> Ranking:
    """Every pairing that is worth a thought.

    View after view, every screw found so far is given a mark of the next view or none.

    Parameters
    ----------
    alternatives : at least so many with as many pairs as possible are among them, if that is what the best one has,
        however improbable they are.
    """
    model = model or PairingModel()
    if table is not None and not table.knows_length:
        return _ranked_by_chi_square(case, table)
    odds = _Odds(case, noise, table or HypothesisTable(case, noise), model)
    found: dict[tuple[Labels, ...], None] = {}
    for scale in _plausible_scales(odds):
        found.update(dict.fromkeys(_assignments(odds, scale, 0.0, _RANKED)))
    if not found:
        return Ranking((), np.zeros(0), 1.0)
    for screws in _assignments(odds, 1.0, _MANY, alternatives):
        found[screws] = None
    pairs = {screws: odds.pairs_in(screws) for screws in found}
    different = {frozenset(pairs[screws]): screws for screws in found}
    every = list(different.values())
    weights = odds.log_weights([pairs[screws] for screws in every])
    order = np.argsort(-weights, kind="stable")
    probabilities = np.exp(weights[order] - weights.max())
    ranked = tuple(combination_of(odds.table, case, every[i]) for i in order)
    first = ranked[0]
    scale = scale_mean(first.chi_square, first.degrees_of_freedom, model.scale_sd)
    total = float(probabilities.sum())
    return Ranking(ranked, np.asarray(probabilities / total), scale, float(weights.max() + np.log(total)))


def _plausible_scales(odds: "_Odds") -> tuple[float, ...]:
    """The factors of the noise that the best assignments of all factors leave possible: few, where there are many
    screws."""
    best = {screws: None for scale in _SCALES for screws in _assignments(odds, scale, 0.0, 1)}
    pairs = [odds.pairs_in(screws) for screws in best]
    weights = odds.log_weights(pairs)
    likely = [one for one, weight in zip(pairs, weights, strict=True) if weight > weights.max() - _NEGLIGIBLE]
    ranges = [odds.scale_range(one) for one in likely]
    least, most = min((low for low, _ in ranges), default=1.0), max((high for _, high in ranges), default=1.0)
    within = [scale for scale in _SCALES if least <= scale <= most]
    nearest = min(_SCALES, key=lambda scale: abs(np.log(scale**2 / (least * most))))
    return tuple(sorted({*within, nearest}))


def _ranked_by_chi_square(case: Case, table: HypothesisTable) -> Ranking:
    """Where fits do not know the screws' length the model has nothing to say: a pair has its chi-square, a mark that
    stays alone a price, and the probability is the share of ``exp(-chi^2 / 2)``."""
    every = _assignments(_ChiSquares(case, table), 1.0, _ALONE_CHI_SQUARE, _RANKED_BY_CHI_SQUARE)
    found = [combination_of(table, case, screws) for screws in every]
    most = len(found[0].hypotheses) if found else 0
    ranked = tuple(one for one in found if most and len(one.hypotheses) == most)
    return Ranking(ranked, probabilities(ranked) if ranked else np.zeros(0), 1.0)


class _ChiSquares:
    """The cost of a screw is its chi-square."""

    def __init__(self, case: Case, table: HypothesisTable) -> None:
        self.case, self.table = case, table

    def cost(self, labels: Labels, _scale: float) -> float:
        """Chi-square, 0 for a mark alone."""
        return self.table.chi_square(labels)


class _Odds:
    """What the model says of each screw that may be, by its labels."""

    def __init__(self, case: Case, noise: LandmarkNoise, table: HypothesisTable, model: PairingModel) -> None:
        self.case, self.noise, self.table, self.model = case, noise, table, model
        self._screws = max(len(marks) for marks in case.annotations.values())
        self._known: dict[Labels, tuple[float, float, int]] = {}
        self._fit_all_pairs()
        self._middle_mm = self._middle_of_all()
        self._alone = {
            (view, mark.label): log_alone(model, self._screws, self._unseen(view, 0.5 * (mark.tip_px + mark.center_px)))
            for view, marks in case.annotations.items()
            for mark in marks
        }
        self._spread = self._spread_of_case()

    def of(self, labels: Labels) -> tuple[float, float, int]:
        """The logarithm of the odds of a screw against its marks alone where its residuals are 0 and s is 1; its
        chi-square; and its degrees of freedom. A mark by itself has 0 of all."""
        if len(labels) < 2:
            return 0.0, 0.0, 0
        if labels not in self._known:
            hypothesis = self.table.get(labels)
            if hypothesis is None:
                self._known[labels] = (-np.inf, np.inf, 0)
            else:
                fit = hypothesis.fit
                unseen = self._unseen_at(labels, 0.5 * (fit.tip_mm + fit.center_mm))
                prior = log_together(self.model, self._screws, len(labels), unseen)
                prior -= sum(self._alone[key] for key in labels)
                prior += self._spread.of(len(labels))
                self._known[labels] = (prior, fit.chi_square, fit.degrees_of_freedom)
        return self._known[labels]

    def cost(self, labels: Labels, scale: float) -> float:
        """What a screw adds to the cost of an assignment where the noise is so much larger than assumed."""
        prior, chi_square, degrees = self.of(labels)
        return -prior + degrees * float(np.log(scale)) + 0.5 * chi_square / scale**2

    def pairs_in(self, screws: Sequence[Labels]) -> tuple[Labels, ...]:
        """The screws that more than one view shows."""
        return tuple(labels for labels in screws if len(labels) > 1)

    def log_weights(self, of_each: Sequence[Sequence[Labels]]) -> FloatArray:
        """The logarithm of the weight of assignments, by the screws that have more than one mark."""
        terms = [[self.of(labels) for labels in pairs] for pairs in of_each]
        prior = np.array([sum(term[0] for term in one) for one in terms])
        chi_square = np.array([sum(term[1] for term in one) for one in terms])
        degrees = np.array([sum(term[2] for term in one) for one in terms])
        evidence = log_scale_evidence(chi_square, degrees, self.model.scale_sd)
        return np.asarray(prior + evidence + self._log_overlaps(of_each))

    def scale_range(self, pairs: Sequence[Labels]) -> tuple[float, float]:
        """Between which factors the noise is, to three standard deviations, if these are the screws."""
        terms = [self.of(labels) for labels in pairs]
        degrees = float(sum(term[2] for term in terms))
        middle = scale_mean(float(sum(term[1] for term in terms)), degrees, self.model.scale_sd)
        # The logarithm of a noise from k residuals has a variance of 1 / (2 k).
        sd = 1.0 / np.sqrt(self.model.scale_sd**-2 + 2.0 * degrees)
        return float(middle * np.exp(-3.0 * sd)), float(middle * np.exp(3.0 * sd))

    def _log_overlaps(self, of_each: Sequence[Sequence[Labels]]) -> FloatArray:
        """What it costs that implants would stand in each other, the worst two of each assignment."""
        index = {labels: i for i, labels in enumerate(dict.fromkeys(one for pairs in of_each for one in pairs))}
        if len(index) < 2:
            return np.zeros(len(of_each))
        found = [self.table.get(labels) for labels in index]
        hypotheses = [one for one in found if one is not None]
        rods = {name: rod_of(implant) for name, implant in self.case.implants.items()}
        deep = overlaps_mm(
            np.array([one.fit.tip_mm for one in hypotheses]),
            np.array([one.fit.center_mm for one in hypotheses]),
            np.array([rods[one.model].length_mm for one in hypotheses]),
            np.array([rods[one.model].radius_mm for one in hypotheses]),
        )
        sigmas = np.minimum(deep / _OVERLAP_SIGMA_MM, _MOST_OVERLAP_SIGMAS)
        worst = []
        for pairs in of_each:
            which = [index[labels] for labels in pairs]
            worst.append(float(sigmas[np.ix_(which, which)].max()) if which else 0.0)
        return -0.5 * np.array(worst) ** 2

    def _fit_all_pairs(self) -> None:
        views = list(self.case.annotations)
        for i, first in enumerate(views):
            for second in views[i + 1 :]:
                self.table.fit(
                    ((first, one.label), (second, other.label))
                    for one in self.case.annotations[first]
                    for other in self.case.annotations[second]
                )

    def _middle_of_all(self) -> FloatArray:
        """Where the screws are, (3,): the median of all pairs, most of which are wrong but near."""
        fits = self.table.fits()
        if not fits:
            return np.zeros(3)
        return np.asarray(np.median([0.5 * (fit.tip_mm + fit.center_mm) for fit in fits], axis=0))

    def _spread_of_case(self) -> Spread:
        lengths_mm = [implant.length_mm for implant in self.case.implants.values()]
        cameras = [view.camera for view in self.case.views.values()]
        depths_mm = [float(camera.depth_mm(self._middle_mm)[0]) for camera in cameras]
        mm_per_px = [
            depth / float(np.sqrt(camera.intrinsics[0, 0] * camera.intrinsics[1, 1]))
            for depth, camera in zip(depths_mm, cameras, strict=True)
        ]
        # In a view a triangulated point is off by half the distance of the two rays.
        apart_px = max((2.0 * fit.residual_px for fit in self.table.fits()), default=0.0)
        return spread_of(
            self.model,
            self.noise.sigma_px,
            self.noise.length_sigma_mm,
            float(np.mean(lengths_mm)),
            max(float(np.mean(mm_per_px)), 1e-6),
            apart_px,
        )

    def _unseen(self, view: str, mark_px: FloatArray) -> list[float]:
        """For each other view the probability that a screw marked here is not marked there."""
        camera = self.case.views[view].camera
        toward = camera.ray_directions_in_world(mark_px)[0]
        source = camera.center_in_world_mm
        along = float((self._middle_mm - source) @ toward) + np.linspace(-_RAY_REACH_MM, _RAY_REACH_MM, 21)
        points = source + along[:, None] * toward
        return [
            1.0 - self.model.detection * _share_inside(other.camera, _size_of(self.case, name), points)
            for name, other in self.case.views.items()
            if name != view
        ]

    def _unseen_at(self, labels: Labels, point_mm: FloatArray) -> list[float]:
        """For each view without a mark of a screw the probability of that."""
        shown = {view for view, _ in labels}
        return [
            1.0 - self.model.detection * _share_inside(view.camera, _size_of(self.case, name), point_mm[None])
            for name, view in self.case.views.items()
            if name not in shown
        ]


def _size_of(case: Case, view: str) -> tuple[int, int]:
    return case.views[view].camera.image_size or case.views[view].radiograph.size


def _share_inside(camera: Camera, size: tuple[int, int], points_mm: FloatArray) -> float:
    """The share of points (N, 3) that are in a view's image, away from its border."""
    homogeneous = points_mm @ camera.projection[:, :3].T + camera.projection[:, 3]
    ahead = homogeneous[:, 2] > 0.0
    pixels = homogeneous[:, :2] / np.where(ahead, homogeneous[:, 2], 1.0)[:, None]
    inside = (pixels >= _RIM_PX) & (pixels <= np.array(size) - 1.0 - _RIM_PX)
    return float(np.mean(ahead & inside.all(axis=1)))


def _assignments(odds: _Odds | _ChiSquares, scale: float, alone: float, count: int) -> list[tuple[Labels, ...]]:
    """The best ways to make screws of the marks, each a screw's labels; those of 1 view are marks alone.

    Parameters
    ----------
    alone : what a mark without a partner costs, beyond what the model says.
    """
    first, *others = odds.case.views
    beam = [_Tracks(tuple(((first, mark.label),) for mark in odds.case.annotations[first]), 0.0)]
    most = count if len(others) == 1 else min(count, _RANKED_OF_MORE_VIEWS)
    for view in others:
        longer = [one for tracks in beam for one in _extended(odds, tracks, view, scale, alone, most)]
        beam = sorted(longer, key=_by_cost)[:most]
    return [tracks.screws for tracks in beam]


@dataclass(frozen=True)
class _Tracks:
    """The screws after some of the views, and what they cost."""

    screws: tuple[Labels, ...]
    cost: float


def _by_cost(tracks: _Tracks) -> float:
    return tracks.cost


def _extended(
    odds: _Odds | _ChiSquares, tracks: _Tracks, view: str, scale: float, alone: float, count: int
) -> list[_Tracks]:
    """The cheapest ways, cheapest first, to continue the screws with the marks of one more view."""
    labels = [mark.label for mark in odds.case.annotations[view]]
    odds.table.fit((*screw, (view, label)) for screw in tracks.screws for label in labels)
    costs = np.array(
        [
            [odds.cost((*screw, (view, label)), scale) - odds.cost(screw, scale) for label in labels]
            for screw in tracks.screws
        ]
    ).reshape(len(tracks.screws), len(labels))
    longer = []
    within = np.inf if alone else _NEGLIGIBLE
    for assignment in cheapest_assignments(costs, alone, count, within):
        continued = [
            screw if column is None else (*screw, (view, labels[column]))
            for screw, column in zip(tracks.screws, assignment.columns, strict=True)
        ]
        new = [((view, label),) for column, label in enumerate(labels) if column not in assignment.columns]
        longer.append(_Tracks((*continued, *new), tracks.cost + assignment.cost))
    return longer
