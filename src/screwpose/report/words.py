"""The answer in plain words: what its status means, how the pairing was decided."""

from dataclasses import dataclass

from screwpose.files.case import Case
from screwpose.files.schema import CombinationFile, ResultFile, SigmaFile
from screwpose.report.comparison import Comparison
from screwpose.report.tables import chosen_combination, pairs_text, same_pairs

DISCLAIMER = "Research software: not a medical device, not for clinical use."


@dataclass(frozen=True)
class StatusWords:
    """A status for people: a sign and a word beside the colour, and what it means."""

    sign: str
    word: str
    meaning: str


STATUS_WORDS = {
    "confident": StatusWords(
        "✓",
        "Confident",
        "The marked tips and centres leave no other pairing. How exact the poses are is said below, where it was "
        "estimated: look at the overlays and the warnings before you rely on one.",
    ),
    "ambiguous": StatusWords(
        "?",
        "Ambiguous",
        "There is an answer, but it may be wrong: another pairing explains the input nearly as well, or a model does "
        "not fit well. Compare the combinations below before you use it.",
    ),
    "refused": StatusWords(
        "✕",
        "Refused",
        "No answer is given, because none could be trusted. The reasons stand in the warnings; the images and the "
        "marked landmarks are shown as they were read.",
    ),
}

SCREW_STATUS_WORDS = {"ok": "ok", "check": "check: a person should look", "failed": "failed: do not use this pose"}


def pairing_story(case: Case, answer: ResultFile) -> list[str]:
    """How the pairing came about, one sentence each."""
    counts = ", ".join(
        f"{len(case.annotations.get(name, ()))} {_plural('screw', len(case.annotations.get(name, ())))} in {name}"
        for name in case.views
    )
    number = len(answer.combinations)
    story = [f"Marked: {counts}. {number} {_plural('combination', number)} {'was' if number == 1 else 'were'} scored."]
    chosen = chosen_combination(answer)
    if chosen is not None:
        story.append(f"The answer is combination {chosen.id}: {pairs_text(chosen.pairs)}.")
    story += _dice_sentences(answer, chosen)
    if answer.pairing.probability is not None:
        story.append(f"Probability that the pairing is right: {percent(answer.pairing.probability)}.")
    elif answer.status != "refused":
        story.append("The method gives no probability for the pairing.")
    alone = [f"{view} {label}" for view, labels in answer.pairing.unpaired.items() for label in labels]
    if alone:
        story.append(f"Without a partner: {', '.join(alone)}.")
    return story


def combination_verdict(one: CombinationFile, chosen: int | None, comparison: Comparison | None) -> str:
    """What became of a combination, and whether it is the true one where that is known: ``rejected, wrong``."""
    words = ["not chosen" if chosen is None else "chosen" if one.id == chosen else "rejected"]
    if comparison is not None and comparison.true_pairs is not None:
        words.append("correct" if same_pairs(one.pairs, comparison.true_pairs) else "wrong")
    return ", ".join(words)


def percent(probability: float) -> str:
    """A probability in percent that rounding never turns into a certainty: ``99.8 %``, ``> 99.99 %``."""
    if 0.9999 < probability < 1:
        return "> 99.99 %"
    if 0 < probability < 0.0001:
        return "< 0.01 %"
    digits = 2 if not 0.001 < probability < 0.999 else 1
    return f"{100 * probability:.{digits}f} %"


def _dice_sentences(answer: ResultFile, chosen: CombinationFile | None) -> list[str]:
    named = answer.pairing.chosen_by
    if named is None or len(answer.combinations) < 2:
        return []
    sentences = []
    for stage, number in (("before", named.pre), ("after", named.post)):
        scored = [(one.id, one.pre if stage == "before" else one.post) for one in answer.combinations]
        dice = {one_id: scores.dice for one_id, scores in scored if scores is not None}
        if number is None or number not in dice:
            continue
        others = [value for one_id, value in dice.items() if one_id != number]
        beside = f", the best other one {max(others):.3f}" if others else ""
        sentences.append(
            f"The higher Dice score {stage} registration names combination {number} ({dice[number]:.3f}{beside})."
        )
    if named.pre is not None and named.post is not None and named.pre != named.post:
        sentences.append("Dice before and after registration name different combinations: look at both.")
    last = named.post if named.post is not None else named.pre
    if chosen is not None and last is not None and chosen.id != last:
        sentences.append("So the answer does not follow the Dice score: the consistency of the landmarks decided.")
    return sentences


def _plural(noun: str, number: int) -> str:
    return noun if number == 1 else f"{noun}s"


def expected_error_text(sigma: SigmaFile | None) -> str | None:
    """How far a pose may be off, in one line; None where nothing of it was estimated."""
    if sigma is None:
        return None
    given = [("tip", sigma.tip_mm, " mm"), ("axis", sigma.axis_deg, "°"), ("roll", sigma.roll_deg, "°")]
    return ", ".join(f"{name} {value:.2g}{unit}" for name, value, unit in given if value is not None) or None
