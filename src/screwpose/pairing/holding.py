"""The pairing that a person holds to, found among those that were ranked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from screwpose._types import FloatArray
from screwpose.errors import AnnotationError
from screwpose.files.case import Case
from screwpose.pairing.evidence import Poses
from screwpose.pairing.hypotheses import Combination, HypothesisTable, combination_of
from screwpose.pairing.ranking import Ranking


@dataclass(frozen=True, eq=False)
class HeldScrew:
    """A screw of the pairing that a person holds to.

    Parameters
    ----------
    labels : its label in each view that shows it.
    world_from_cad : (4, 4), where its registration begins; None: on its landmarks.
    """

    labels: Mapping[str, str]
    world_from_cad: FloatArray | None = None


def begun_poses(combination: Combination, placed: Poses, held: Sequence[HeldScrew]) -> Poses:
    """Where the screws of a combination begin: as a person says, else as they were placed."""
    given = {frozenset(one.labels.items()): one.world_from_cad for one in held}
    own = [given.get(frozenset(hypothesis.labels)) for hypothesis in combination.hypotheses]
    return tuple(pose if one is None else one for pose, one in zip(placed, own, strict=True))


def held_combination(
    case: Case, table: HypothesisTable, ranking: Ranking, screws: Sequence[Mapping[str, str]]
) -> Combination:
    """The pairing that a person holds to: the ranking's own, where it has it.

    Parameters
    ----------
    screws : for each screw its label in each view that shows it.

    Raises
    ------
    AnnotationError
        Marks that are not there, that stand for two screws, or whose rays cannot be of one.
    """
    labels = [tuple((view, one[view]) for view in case.views if view in one) for one in screws]
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
    return next(same, None) or combination_of(table, case, labels)
