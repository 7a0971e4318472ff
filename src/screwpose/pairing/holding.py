"""The pairing that a person holds to, found among those that were ranked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from screwpose._types import FloatArray
from screwpose.errors import AnnotationError
from screwpose.files.case import Case
from screwpose.pairing.evidence import Poses
from screwpose.pairing.hypotheses import Combination, Hypothesis, HypothesisTable, combination_of
from screwpose.pairing.ranking import Ranking


@dataclass(frozen=True, eq=False)
class HeldScrew:
    """A screw of the pairing that a person holds to.

    Parameters
    ----------
    labels : its label in each view that shows it.
    world_from_cad : (4, 4), where its registration begins; None: on its landmarks.
    model : which model lies there, since another one's CAD frame is another: the screw begins as that one, as long as
        its landmarks allow it. None: the model that the landmarks say.
    """

    labels: Mapping[str, str]
    world_from_cad: FloatArray | None = None
    model: str | None = None


def begun_poses(combination: Combination, placed: Poses, held: Sequence[HeldScrew]) -> Poses:
    """Where the screws of a combination begin: as a person says, else, and where the model is another, as they were
    placed."""
    given = {(frozenset(one.labels.items()), one.model): one.world_from_cad for one in held}
    own = [
        given.get((frozenset(one.labels), one.model), given.get((frozenset(one.labels), None)))
        for one in combination.hypotheses
    ]
    return tuple(pose if one is None else one for pose, one in zip(placed, own, strict=True))


def with_held_models(ranking: Ranking, held: Sequence[HeldScrew]) -> Ranking:
    """The ranking, its screws of the models that a person's poses are of."""
    pairs = {pair for one in ranking.combinations for pair in one.hypotheses}
    return ranking.with_pairs({pair: _of_held_model(pair, held) for pair in pairs})[0]


def held_combination(case: Case, table: HypothesisTable, ranking: Ranking, held: Sequence[HeldScrew]) -> Combination:
    """The pairing that a person holds to: the ranking's own, where it has it.

    Raises
    ------
    AnnotationError
        Marks that are not there, that stand for two screws, or whose rays cannot be of one.
    """
    labels = [tuple((view, one.labels[view]) for view in case.views if view in one.labels) for one in held]
    there = {(view, mark.label) for view, marks in case.annotations.items() for mark in marks}
    named = [key for one in labels for key in one]
    for key in named:
        if key not in there or named.count(key) > 1:
            raise AnnotationError(
                f"the mark {key[1]} in {key[0]} {'is not there' if key not in there else 'stands for two screws'}",
                expected="each mark in one screw of the pairing",
                remedy="Choose the pairing anew.",
            )
    for one in labels:
        if len(one) > 1 and table.get(one) is None:
            name = " and ".join(f"{view} {label}" for view, label in one)
            raise AnnotationError(f"{name} cannot be one screw: their rays do not meet, or their models differ")
    wanted = {one for one in labels if len(one) > 1}
    same = (one for one in ranking.combinations if {h.labels for h in one.hypotheses} == wanted)
    found = next(same, None)
    if found is not None:
        return found
    unranked = combination_of(table, case, labels)
    return replace(unranked, hypotheses=tuple(_of_held_model(one, held) for one in unranked.hypotheses))


def _of_held_model(hypothesis: Hypothesis, held: Sequence[HeldScrew]) -> Hypothesis:
    models = (one.model for one in held if frozenset(one.labels.items()) == frozenset(hypothesis.labels))
    model = next(models, None)
    is_open = any(model == name for name, _ in hypothesis.open_models)
    return hypothesis.of_model(model) if model is not None and is_open else hypothesis
