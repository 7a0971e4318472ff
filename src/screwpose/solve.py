"""The whole job: from a case to its result."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Literal

import numpy as np

from screwpose._progress import Progress, SideBySide, of_several, part_of, tell_nobody
from screwpose._threads import in_threads
from screwpose._types import FloatArray
from screwpose.errors import MeshError
from screwpose.files.case import Case
from screwpose.files.findings import errors_in, warnings_in
from screwpose.files.result import Result
from screwpose.pairing.advice import why_open
from screwpose.pairing.answer import Trial, answered, refused
from screwpose.pairing.cameras import CameraMode, with_sigmas
from screwpose.pairing.confidence import CONFIDENT_PROBABILITY, judge
from screwpose.pairing.epipolar import fit_epipolar
from screwpose.pairing.evidence import Evidence, Poses, gather, place, refine, score, with_metal
from screwpose.pairing.holding import HeldScrew, begun_poses, held_combination, with_held_models
from screwpose.pairing.hypotheses import Combination, Fit, Hypothesis, HypothesisTable
from screwpose.pairing.plausibility import check_plausibility
from screwpose.pairing.ranking import Ranking, ranked_pairings
from screwpose.pairing.segment import LandmarkNoise, fit_segment
from screwpose.pairing.thickness import prepare_thickness, refine_by_thickness, settle_by_thickness
from screwpose.pairing.trials import (
    judged_by_marks,
    not_registered,
    weighed_by_images,
    with_seen_models,
    without_open_pairs,
)
from screwpose.registration import SearchOptions

Method = Literal["default", "paper", "epipolar"]
"""How the pairing is decided: `default` by the landmarks' chi-square with the CAD's length, `paper` by the Dice score
after registration, `epipolar` by the landmarks' epipolar distances alone."""


Engine = Literal["opencv", "bitrows"]
"""How masks are drawn: `opencv` triangle by triangle as in the paper, `bitrows` by the exact rule, and much faster."""


Refinement = Literal["evolution", "thickness"]
"""How screws are registered: `evolution`, the paper's search on silhouettes, or `thickness`, ours."""

_FEW_SCREWS = 3
# By the landmarks alone. A wrong combination's screws seldom explain the X-rays: to let them begin again in other ways
# took half the time of a case, and of 72 development cases none was right with less than 0.4.
_HOPELESS = 1e-9
# Combinations of many screws that are more probable than this are registered too.
_OPEN = 0.005
# Once so many are settled, each of which made another more probable, no more are registered.
_MOST_SETTLED = 4


@dataclass(frozen=True)
class SolveOptions:
    """What can be chosen; the defaults suit two screws on a laptop.

    Parameters
    ----------
    method : how the pairing is decided.
    noise : how exactly the landmarks were marked.
    faces : triangles that a model is reduced to for the searches; None for the CAD as it is.
    combinations : at most so many are placed and scored.
    registered : so many of them are registered; all, where there are no more than 3 screws; and by thickness also each
        that the landmarks leave open, with half a percent or more.
    refinement : how screws are registered; None: as in the paper for `paper` and `epipolar`, else by thickness.
    search : bounds, budget and seed of the evolution. No generations: whatever the refinement, nothing is registered.
    engine : how masks are drawn; None: as in the paper for `paper`, else the fast one.
    cameras : whether cameras are refined with the poses, in the registration by thickness: never, as the case's views
        say, or also where they say nothing.
    held : the pairing of a person: it is the answer, and how likely it is stands in the result. None: the method's own.
    """

    method: Method = "default"
    noise: LandmarkNoise = field(default_factory=LandmarkNoise)
    faces: int | None = 1000
    combinations: int = 6
    registered: int = 2
    search: SearchOptions = field(default_factory=SearchOptions)
    engine: Engine | None = None
    refinement: Refinement | None = None
    cameras: CameraMode = "given"
    held: tuple[HeldScrew, ...] | None = None


def solve(case: Case, options: SolveOptions | None = None, progress: Progress | None = None) -> Result:
    """Pair and register the screws of a case.

    Parameters
    ----------
    progress : called as ``progress(fraction, what)`` after every step and every generation of the search, about once a
        second with the defaults; raise CancelledError in it to stop.

    Returns
    -------
    The result, whose status is `refused`, with the reasons, where the landmarks, matrices and models contradict each
    other: it is then no answer, and nothing was registered.

    Raises
    ------
    BehindSourceError
        A model, laid on its landmarks, reaches behind an X-ray source.
    AnnotationError
        A pairing is held to whose marks cannot be one screw, or are not in the case.

    References
    ----------
    arXiv 2511.05702, for the steps; the choice of `default` and the confidence of both methods are ours.
    """
    options = options or SolveOptions()
    tell = progress or tell_nobody
    clock = _Clock()

    tell(0.0, "checking the landmarks")
    case = with_sigmas(case, options.cameras, options.noise)
    findings = check_plausibility(case, options.noise)
    table = HypothesisTable(case, options.noise, _FITS[options.method])
    ranking = ranked_pairings(case, options.noise, table, options.combinations)
    if options.held is not None:
        ranking = with_held_models(ranking, options.held)
    ranked = ranking.shown(options.combinations)
    if options.held is not None:
        held = held_combination(case, table, ranking, options.held)
        ranked = [held, *(one for one in ranked if one is not held)]
    if errors_in(findings) or not ranked:
        reasons = [finding.within_file() for finding in findings] or ["no two marks can be one screw"]
        return refused(case, reasons, clock.read("pairing"))

    evidence = _gathered(case, options)
    placed = _placed(evidence, ranked, part_of(tell, 0.02, 0.15))
    if options.held is not None:
        placed = [
            begun_poses(combination, poses, options.held) for combination, poses in zip(ranked, placed, strict=True)
        ]
    evidence = with_metal(evidence, case, list(zip(ranked, placed, strict=True)))
    if options.held is not None:  # the others say which metal counts, as where nothing is held, and no more
        ranked, placed = ranked[:1], placed[:1]
    trials = [
        Trial(combination, ranking.probability_of(combination), poses, score(evidence, combination, poses))
        for combination, poses in zip(ranked, placed, strict=True)
    ]
    warnings = [finding.within_file() for finding in warnings_in(findings)]
    clock.lap("pairing")

    if options.search.generations > 0:
        trials, ranking, excuses = _registered(case, evidence, trials, ranking, options, part_of(tell, 0.2, 0.97))
        warnings += excuses
    else:
        trials = sorted(trials, key=_ORDERS[options.method])
    clock.lap("registration")

    tell(0.97, "judging")
    confidence = judge([trial.combination for trial in trials], 0, trials[0].probability)
    if confidence.status == "refused":
        return refused(case, confidence.reasons, clock.read("judging"))
    if warnings and confidence.status == "confident":
        confidence = replace(confidence, status="ambiguous")
    why = why_open(case, options.noise, ranking) if confidence.probability < CONFIDENT_PROBABILITY else None
    if why is not None:
        confidence = replace(confidence, reasons=(*confidence.reasons, why))
    result = answered(case, evidence, trials, confidence, ranking, options.noise, warnings, clock.read("judging"))
    tell(1.0, "solved")
    return result


def _gathered(case: Case, options: SolveOptions) -> Evidence:
    from screwpose.projection import opencv, silhouette

    engine = options.engine or ("opencv" if options.method == "paper" else "bitrows")
    if engine == "opencv":
        return gather(case, options.faces, opencv.silhouette)
    return gather(case, options.faces, silhouette.silhouette, is_quick=True)


def _placed(evidence: Evidence, ranked: list[Combination], tell: Progress) -> list[Poses]:
    """Each combination's models on their landmarks; a pair that stands in several combinations is placed once."""
    poses: dict[Hypothesis, Poses] = {}
    different = list(dict.fromkeys(hypothesis for one in ranked for hypothesis in one.hypotheses))
    for index, hypothesis in enumerate(different):
        tell(index / len(different), f"placing screw {index + 1} of {len(different)} candidates")
        poses[hypothesis] = (place(evidence, hypothesis),)
    return [tuple(poses[hypothesis][0] for hypothesis in one.hypotheses) for one in ranked]


def _refinement(options: SolveOptions) -> Refinement:
    return options.refinement or ("thickness" if options.method == "default" else "evolution")


def _promising(trials: list[Trial], options: SolveOptions) -> list[Trial]:
    """Those that are worth registering: all, where there are few screws."""
    few = all(len(trial.combination.hypotheses) <= _FEW_SCREWS for trial in trials)
    count = len(trials) if few else min(options.registered, len(trials))
    if _refinement(options) == "thickness":  # they share most of their pairs, which are registered once
        count = max(count, sum(trial.probability > _OPEN for trial in trials))
    return sorted(trials, key=_PROMISING[options.method])[:count]


def _registered(
    case: Case, evidence: Evidence, trials: list[Trial], ranking: Ranking, options: SolveOptions, tell: Progress
) -> tuple[list[Trial], Ranking, list[str]]:
    """The trials in the method's order, the most promising of them registered; what is then known of all pairings; and
    why it was not done as asked, if it was not."""
    if _refinement(options) == "evolution":
        return _registered_by_evolution(evidence, trials, options, tell), ranking, []
    try:
        return *_registered_by_thickness(case, evidence, trials, ranking, options, tell), []
    except MeshError as error:
        excuse = f"registered by silhouettes, since a model has no thickness: {error}"
        return _registered_by_evolution(evidence, trials, options, tell), ranking, [excuse]


def _registered_by_evolution(
    evidence: Evidence, trials: list[Trial], options: SolveOptions, tell: Progress
) -> list[Trial]:
    """The trials in the method's order, the most promising of them registered by the paper's search."""
    promising = _promising(trials, options)
    done = []
    for index, trial in enumerate(promising):
        within = of_several(tell, index, len(promising))
        found = refine(evidence, trial.combination, trial.placed, options.search, within)
        post = score(evidence, trial.combination, found.world_from_cad)
        done.append(replace(trial, found=found, post=post))
    return sorted([*done, *(trial for trial in trials if trial not in promising)], key=_ORDERS[options.method])


def _registered_by_thickness(
    case: Case, evidence: Evidence, trials: list[Trial], ranking: Ranking, options: SolveOptions, tell: Progress
) -> tuple[list[Trial], Ranking]:
    """The trials in the method's order: the most promising of them registered by thickness, all judged again by their
    marks and by what they explain, the first of them settled; and the ranking, judged again."""
    promising = _promising(trials, options)
    centers = [hypothesis.fit.center_mm for trial in promising for hypothesis in trial.combination.hypotheses]
    thickness = prepare_thickness(case, np.mean(centers, axis=0))
    together = SideBySide(part_of(tell, 0.0, 0.7), len(promising))
    known: dict[Hypothesis, FloatArray] = {}

    def registered(trial: Trial, progress: Progress) -> Trial:
        found, quality = refine_by_thickness(
            case, thickness, trial.combination, trial.placed, options.noise, progress, known,
            trial.probability < _HOPELESS,
        )  # fmt: skip
        seen = evidence if quality.cameras is None else replace(evidence, cameras=quality.cameras.cameras)
        post = score(seen, trial.combination, found.world_from_cad)
        return replace(trial, found=found, post=post, quality=quality)

    def one_of_several(index: int) -> Trial:
        return registered(promising[index], together.progress_of(index))

    done = []
    if any(len(trial.combination.hypotheses) > _FEW_SCREWS for trial in promising):
        # Combinations of many screws share most of their pairs: these are registered once.
        done = [one_of_several(0)]
        first = done[0]
        assert first.found is not None
        assert first.quality is not None
        # They begin in the cameras as reported.
        held = first.found.world_from_cad if first.quality.cameras is None else first.quality.cameras.held
        known.update(zip(first.combination.hypotheses, held, strict=True))
    done += in_threads(one_of_several, range(len(done), len(promising)), together.give_up)
    rest = [trial for trial in trials if trial not in promising]
    ranking = judged_by_marks([*done, *rest], ranking)
    within = part_of(tell, 0.7, 1.0)

    def settled(trial: Trial) -> Trial:
        assert trial.found is not None
        assert trial.quality is not None
        found, quality = settle_by_thickness(
            case, thickness, trial.combination, trial.found, options.noise, within, trial.quality.cameras
        )
        seen = evidence if quality.cameras is None else replace(evidence, cameras=quality.cameras.cameras)
        return replace(trial, found=found, post=score(seen, trial.combination, found.world_from_cad), quality=quality)

    # What is not settled explains too little to be held against it: so the first by the marks is settled, and whatever
    # is then more probable.
    chosen = min(done, key=_by_chi_square)
    chosen, (done, rest), ranking = with_seen_models(
        case, evidence, thickness, chosen, (done, rest), ranking, part_of(tell, 0.7, 0.7)
    )
    at_rest: dict[Combination, Trial] = {}
    while chosen.combination not in at_rest:
        at_rest[chosen.combination] = settled(chosen)
        within = part_of(tell, 1.0, 1.0)  # a second one is seldom
        done = [at_rest.get(trial.combination, trial) for trial in done]
        weighed = weighed_by_images(done, ranking, at_rest)
        chosen = max(done, key=lambda trial: weighed.probability_of(trial.combination))
        late = not_registered(weighed, done)
        if late is not None and options.held is None and len(at_rest) < _MOST_SETTLED:
            placed = tuple(place(evidence, hypothesis) for hypothesis in late.hypotheses)
            trial = Trial(late, weighed.probability_of(late), placed, score(evidence, late, placed))
            chosen = registered(trial, part_of(tell, 1.0, 1.0, "registering what has become more probable: "))
            done.append(chosen)
            rest = [trial for trial in rest if trial.combination is not late]
    others = rest + [trial for trial in done if trial is not chosen]
    others = [replace(trial, probability=weighed.probability_of(trial.combination)) for trial in others]
    chosen = replace(chosen, probability=weighed.probability_of(chosen.combination))
    if options.held is None:  # a person's pairs are the answer, however open they are
        chosen = without_open_pairs(evidence, chosen, weighed)
    return [chosen, *sorted(others, key=_ORDERS[options.method])], weighed


def _by_chi_square(trial: Trial) -> tuple[bool, float]:
    if trial.quality is not None:
        return False, trial.quality.mark_chi_square
    return trial.post is None, trial.combination.chi_square


def _by_probability(trial: Trial) -> tuple[bool, float, float]:
    return trial.post is None, -trial.probability, _by_chi_square(trial)[1]


def _by_dice_after(trial: Trial) -> tuple[bool, float]:
    return trial.post is None, -(trial.pre if trial.post is None else trial.post).dice


_FITS: dict[Method, Fit] = {"default": fit_segment, "paper": fit_segment, "epipolar": fit_epipolar}
_ORDERS: dict[Method, Callable[[Trial], tuple[bool, *tuple[float, ...]]]] = {
    "default": _by_probability,
    "paper": _by_dice_after,
    "epipolar": _by_chi_square,
}
_PROMISING: dict[Method, Callable[[Trial], float]] = {
    "default": lambda trial: -trial.probability,
    "paper": lambda trial: -trial.pre.dice,
    "epipolar": lambda trial: trial.combination.chi_square,
}


class _Clock:
    """Seconds spent in each step."""

    def __init__(self) -> None:
        self._start = self._last = perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, step: str) -> None:
        now = perf_counter()
        self._laps[step] = now - self._last
        self._last = now

    def read(self, last_step: str) -> dict[str, float]:
        self.lap(last_step)
        return {**self._laps, "total": self._last - self._start}
