"""What is known of all ways to pair the marks once some of them were registered."""

from collections.abc import Container, Mapping
from dataclasses import replace

import numpy as np

from screwpose._progress import Progress
from screwpose._types import FloatArray
from screwpose.files.case import Case
from screwpose.pairing.answer import Trial
from screwpose.pairing.confidence import judged_again
from screwpose.pairing.evidence import Evidence, Poses, place, score
from screwpose.pairing.hypotheses import Combination, Hypothesis
from screwpose.pairing.image_evidence import log_odds_of_pairs
from screwpose.pairing.ranking import Ranking
from screwpose.pairing.seen_models import seen_models
from screwpose.pairing.thickness import Thickness


def with_seen_models(
    case: Case,
    evidence: Evidence,
    thickness: Thickness,
    chosen: Trial,
    groups: tuple[list[Trial], list[Trial]],
    ranking: Ranking,
    progress: Progress,
) -> tuple[Trial, tuple[list[Trial], list[Trial]], Ranking]:
    """The chosen trial, one of the first group, with the models that the X-rays show, where the landmarks leave them
    open; and all others, which share its pairs, with the same."""
    pairs = chosen.combination.hypotheses
    assert chosen.found is not None
    assert chosen.quality is not None
    if chosen.quality.cameras is not None or not any(pair.open_models for pair in pairs):
        return chosen, groups, ranking
    seen, poses = seen_models(case, thickness, pairs, chosen.found.world_from_cad, progress)
    now = dict(zip(pairs, seen, strict=True))
    found = dict(zip(pairs, poses, strict=True))
    placed = {old: place(evidence, new) for old, new in now.items() if new.model != old.model}
    ranking, changed = ranking.with_pairs(now)

    def with_them(trial: Trial) -> Trial:
        before = trial.combination
        if not any(pair in now for pair in before.hypotheses):
            return trial
        # One that a person holds to need not be in the ranking.
        after = changed.get(before) or replace(before, hypotheses=tuple(now.get(one, one) for one in before.hypotheses))
        trial = replace(trial, combination=after)
        if not any(pair in placed for pair in before.hypotheses):
            return trial
        trial = replace(trial, placed=_with(trial.placed, before, placed))
        trial = replace(trial, pre=score(evidence, after, trial.placed))
        if trial.found is None:
            return trial
        others = {pair: pose for pair, pose in found.items() if pair in placed}  # a pose is one of a model's own frame
        its = replace(trial.found, world_from_cad=_with(trial.found.world_from_cad, before, others))
        return replace(trial, found=its, post=score(evidence, after, its.world_from_cad))

    done, rest = ([with_them(trial) for trial in group] for group in groups)
    return done[groups[0].index(chosen)], (done, rest), ranking


def _with(poses: Poses, combination: Combination, others: Mapping[Hypothesis, FloatArray]) -> Poses:
    """A combination's poses, some of them replaced."""
    return tuple(others.get(pair, pose) for pair, pose in zip(combination.hypotheses, poses, strict=True))


def not_registered(ranking: Ranking, done: list[Trial]) -> Combination | None:
    """The most probable combination, where it is neither one of the registered ones nor a part of one: it may have a
    pair more than the best had by its landmarks, which all that were registered have as many as."""
    best = ranking.most_probable
    return None if any(set(best.hypotheses) <= set(trial.combination.hypotheses) for trial in done) else best


def judged_by_marks(trials: list[Trial], ranking: Ranking) -> Ranking:
    """What is known of all pairings once the marks of some are seen beside their registered models."""
    marks = [(t.quality.mark_chi_square, t.quality.marks) if t.quality else (np.nan, np.nan) for t in trials]
    again = judged_again(np.array([trial.probability for trial in trials]), *np.array(marks).T)
    return ranking.with_probabilities(
        {trial.combination: float(probability) for trial, probability in zip(trials, again, strict=True)}
    )


def weighed_by_images(trials: list[Trial], ranking: Ranking, at_rest: Container[Combination]) -> Ranking:
    """The ranking with what the registered pairs explain; that of those not settled counts only in their favour."""
    seen = [
        (one.combination.hypotheses, one.quality.energies, one.combination in at_rest) for one in trials if one.quality
    ]
    settled = log_odds_of_pairs((pairs, energies) for pairs, energies, is_settled in seen if is_settled)
    rough = log_odds_of_pairs((pairs, energies) for pairs, energies, is_settled in seen if not is_settled)
    return ranking.weighed({pair: max(odds, 0.0) for pair, odds in rough.items()} | settled)


def without_open_pairs(evidence: Evidence, trial: Trial, ranking: Ranking) -> Trial:
    """A registered combination without those of its pairs that are more probably none."""
    best = ranking.most_probable
    places = {hypothesis: index for index, hypothesis in enumerate(trial.combination.hypotheses)}
    is_part = 0 < len(best.hypotheses) < len(places) and all(one in places for one in best.hypotheses)
    assert trial.found is not None
    assert trial.quality is not None
    if not is_part or trial.quality.cameras is not None:
        return trial
    kept = [places[one] for one in best.hypotheses]
    placed, found = tuple(trial.placed[index] for index in kept), trial.found.of(kept)
    pre, post = score(evidence, best, placed), score(evidence, best, found.world_from_cad)
    return Trial(best, ranking.probability_of(best), placed, pre, found, post, trial.quality.of(kept))
