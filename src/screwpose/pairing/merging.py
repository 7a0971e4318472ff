"""A person's choice among combinations that were scored before: one result that shows all of them."""

from dataclasses import replace

from screwpose.files.result import Result


def beside_others(chosen: Result, before: Result | None, reason: str | None) -> Result:
    """The result of a pairing that was held to, with the other combinations of the result before.

    Parameters
    ----------
    chosen : of a solve with `held`: it has that combination alone.
    before : what was scored before; its combination of the same pairs is replaced, and keeps its number. None where
        nothing was, or where the case was another one.
    reason : the person's, for the warnings. None: the pairing is not the person's.
    """
    before = before or chosen
    (own,) = chosen.answer.combinations
    pairs = {frozenset(one.items()) for one in own.pairs}
    same = [one.id for one in before.answer.combinations if {frozenset(p.items()) for p in one.pairs} == pairs]
    number = same[0] if same else max((one.id for one in before.answer.combinations), default=0) + 1
    others = tuple(one for one in before.answer.combinations if one.id != number)
    words = () if reason is None else (f"a person chose the pairing, not the solver; the reason given: {reason}",)
    answer = chosen.answer.model_copy(
        update={
            "combinations": (own.model_copy(update={"id": number}), *others),
            "pairing": chosen.answer.pairing.model_copy(update={"chosen_by": before.answer.pairing.chosen_by}),
            "warnings": (*words, *chosen.answer.warnings),
        }
    )
    scenes = (replace(chosen.scenes[0], id=number), *(one for one in before.scenes if one.id != number))
    return Result(answer, scenes)
