"""When no pairing explains the landmarks: what would, if it were otherwise?

Landmarks, matrices and models must agree. Where they do not, the mistakes that people make are tried one after the
other: views swapped, a matrix in metres, a mesh in inches, tip and centre swapped, (row, column) for (u, v). A
mistake that explains it all is named; nothing is corrected in silence. The mistakes themselves are in
`screwpose.pairing.mistakes`.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations as choose

import numpy as np

from screwpose.errors import AnnotationError
from screwpose.files.case import Case
from screwpose.files.findings import Finding
from screwpose.pairing.confidence import p_value, p_value_of
from screwpose.pairing.hypotheses import Combination, Hypothesis, combinations
from screwpose.pairing.mistakes import Suspect, families, swapped_ends, swapped_views
from screwpose.pairing.oddities import odd_marks
from screwpose.pairing.ranking import Ranking, ranked_pairings
from screwpose.pairing.segment import LandmarkNoise

# The landmarks are in doubt below the first value; a suspected mistake must lift them above the second.
_SUSPICIOUS_P_VALUE = 1e-6
_EXPLAINED_P_VALUE = 1e-3
_CLEARLY_BETTER = 3.5  # logarithm of the odds of 33 to 1
_AGAINST = -0.5  # cosine; the two screws of a level converge by up to 60 degrees, iliac ones by up to 90


def check_plausibility(case: Case, noise: LandmarkNoise | None = None) -> tuple[Finding, ...]:
    """What the landmarks say of the matrices and the models.

    Returns
    -------
    Nothing where some pairing explains the landmarks, unless swapped views would explain them better: a warning; nor
    where it explains most of them: a warning that names the rest. Where none does one error: the mistake that would
    explain them, or that none of the usual ones does.
    """
    noise = noise or LandmarkNoise()
    ranking = ranked_pairings(case, noise)
    best = next(iter(ranking.shown(1)), None)
    if best is not None and _explains(case, best) >= _SUSPICIOUS_P_VALUE:
        return (
            *_better_swapped(case, noise, ranking),
            *_pointing_apart(case, noise, best),
            *odd_marks(case, noise, best),
        )
    lonely = _marks_without_partner(case, best)
    some_fit = len(lonely) < sum(len(marks) for marks in case.annotations.values())
    # A mistake in a matrix, a unit or a way of counting spoils every pair: where some fit, only a mark can be wrong.
    for family in [swapped_ends(case, set(lonely))] if some_fit else families(case):
        suspect = _best_of(family, noise)
        if suspect is not None:
            return (
                Finding("error", suspect.problem, case.path, suspect.field, remedy=suspect.remedy, kind=suspect.kind),
            )
    if some_fit:
        assert best is not None
        return (*_better_swapped(case, noise, ranking), *odd_marks(case, noise, best), _lonely_marks(case, lonely))
    return (
        Finding(
            "error",
            f"no pairing of the screws explains the landmarks: {_best_attempt(case)}",
            case.path,
            "annotations",
            "rays that meet to a few pixels, and tips and centres as far apart as on the model",
            "Check that each matrix belongs to its image, the unit of the matrices and the models, and the marks.",
            AnnotationError,
        ),
    )


def _marks_without_partner(case: Case, best: Combination | None) -> list[tuple[str, str]]:
    """The marks (view, label) that stand in no pair that fits, in the best combination."""
    fitting = [one for one in (best.hypotheses if best else ()) if p_value_of(one) >= _EXPLAINED_P_VALUE]
    paired = {key for one in fitting for key in one.labels}
    return [
        (view, mark.label)
        for view in case.annotations
        for mark in case.annotations[view]
        if (view, mark.label) not in paired
    ]


def _lonely_marks(case: Case, lonely: Sequence[tuple[str, str]]) -> Finding:
    """A warning where some screws pair well, and others that could have a partner fit none."""
    return Finding(
        "warning",
        f"{', '.join(f'{view} {label}' for view, label in lonely)}: no two of these marks fit each other as one screw",
        case.path,
        "annotations",
        "marks of one screw in two views, unless each of them is hidden in the other view",
        "Check these marks: what is made of them, if anything, is doubtful.",
        AnnotationError,
    )


def _better_swapped(case: Case, noise: LandmarkNoise, as_given: Ranking) -> Iterator[Finding]:
    """A warning where the landmarks fit clearly better with two matrices swapped.

    Two views at about 90 degrees are nearly mirror images of each other, and so is a swapped case: rays still meet,
    screws keep their length, and only small asymmetries of the C-arm's path tell (none at all if there are none). What
    is compared is all that the pairings say together, of those marks too that stay alone.
    """
    for suspect in swapped_views(case):
        gain = ranked_pairings(suspect.case, noise).log_evidence - as_given.log_evidence
        if gain > _CLEARLY_BETTER:
            yield Finding(
                "warning",
                f"{suspect.problem.replace('fit only', 'fit better')}: by odds of {_odds_words(gain)} to 1",
                case.path,
                suspect.field,
                remedy=suspect.remedy,
                kind=suspect.kind,
            )


def _odds_words(log_odds: float) -> str:
    return f"{np.exp(log_odds):.0f}" if log_odds < np.log(1e6) else "more than a million"


def _pointing_apart(case: Case, noise: LandmarkNoise, best: Combination) -> Iterator[Finding]:
    """A warning where one screw points against another.

    A mark whose line in the image is nearly the other view's epipolar line can be turned round without any ray missing
    another. The screw then comes out the other way round, which its neighbours show.
    """
    apart = _opposed(best)
    if apart is None:
        return
    suspect = _best_of(swapped_ends(case), noise)
    yield Finding(
        "warning",
        f"the screws {' and '.join(one.name for one in apart)} point against each other by their landmarks",
        case.path,
        "annotations" if suspect is None else suspect.field,
        "screws of one spine that point roughly the same way",
        "Are tip and center of a screw swapped in one view?"
        if suspect is None
        else f"Side by side they would stand if {suspect.problem.removeprefix('the landmarks fit only if ')}.",
        AnnotationError,
    )


def _opposed(combination: Combination) -> tuple[Hypothesis, Hypothesis] | None:
    """The two screws that point most against each other, if any do."""
    directions = [one.fit.center_mm - one.fit.tip_mm for one in combination.hypotheses]
    axes = [direction / max(float(np.linalg.norm(direction)), 1e-300) for direction in directions]
    cosines = [(float(axes[i] @ axes[j]), i, j) for i, j in choose(range(len(axes)), 2)]
    cosine, first, second = min(cosines, default=(1.0, 0, 0))
    return (combination.hypotheses[first], combination.hypotheses[second]) if cosine < _AGAINST else None


def _best_of(family: Iterable[Suspect], noise: LandmarkNoise) -> Suspect | None:
    """Of the mistakes of one kind the one that explains the landmarks best and leaves no screws against each other."""
    best: tuple[tuple[bool, float], Suspect] | None = None
    for suspect in family:
        explained = next(iter(combinations(suspect.case, noise, 1)), None)
        chance = 0.0 if explained is None else _explains(suspect.case, explained)
        if explained is not None and chance >= _EXPLAINED_P_VALUE:
            agree = _opposed(explained) is None
            if best is None or (agree, chance) > best[0]:
                best = ((agree, chance), suspect)
    return None if best is None else best[1]


def _explains(case: Case, best: Combination) -> float:
    """The best pairing's p-value, 0 where a mark that could have had a partner stays alone."""
    could_pair = sorted(len(marks) for marks in case.annotations.values())[-2]
    if len(best.hypotheses) < min(could_pair, len(case.annotations[next(iter(case.views))])):
        return 0.0
    return p_value(best)


def _best_attempt(case: Case) -> str:
    loose = LandmarkNoise(sigma_px=100.0, length_sigma_mm=100.0)
    found = combinations(case, loose, 1)
    if not found:
        return "the rays do not meet in front of both sources"
    words = [
        f"{one.name}: {one.fit.residual_px:.0f} px off, "
        f"{one.fit.measured_length_mm:.1f} mm from tip to centre where {one.model} has "
        f"{case.implants[one.model].length_mm:.1f}"
        for one in found[0].hypotheses
    ]
    return "; ".join(words)
