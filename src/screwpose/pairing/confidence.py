"""How sure is the pairing? Probabilities from the landmarks' chi-square, and when to refuse.

The probability of a combination is its share of ``exp(-chi^2 / 2)`` among all combinations. If even the best one
explains the landmarks worse than the assumed noise allows, the noise was assumed too small, and the differences
between the combinations are divided by the same factor (Birge's ratio): a bad fit must not make a sure answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from screwpose._types import FloatArray
from screwpose.pairing.hypotheses import SURE_MODEL_MARGIN, Combination, Hypothesis
from screwpose.pairing.posterior import PairingModel, log_scale_evidence

Status = Literal["confident", "ambiguous", "refused"]
CONFIDENT_PROBABILITY = 0.99
# Landmarks this unlikely under the assumed noise are doubted, and at the second limit not believed at all.
_DOUBTFUL_P_VALUE = 1e-3
_IMPOSSIBLE_P_VALUE = 1e-12


@dataclass(frozen=True)
class Confidence:
    """How sure a chosen combination is, and why it is not, in words for the result's warnings."""

    status: Status
    probability: float
    reasons: tuple[str, ...]


def probabilities(combinations: Sequence[Combination]) -> FloatArray:
    """Probability (K,) of each combination, given that one of them is right."""
    chi_square = np.array([combination.chi_square for combination in combinations])
    ratio = max(1.0, float(chi_square.min()) / combinations[int(chi_square.argmin())].degrees_of_freedom)
    weights = np.exp(-(chi_square - chi_square.min()) / (2.0 * ratio))
    return np.asarray(weights / weights.sum(), dtype=np.float64)


def judged_again(known: FloatArray, chi_square: FloatArray, degrees_of_freedom: FloatArray) -> FloatArray:
    """Probabilities (K,) once some combinations were registered, by how far their marks are from their models.

    Those that were not registered keep what they had; the others share theirs by ``exp(-chi^2 / (2 s^2))``, over which
    the noise's unknown factor s is integrated.

    Parameters
    ----------
    known : (K,), from the landmarks alone.
    chi_square, degrees_of_freedom : (K,), of the marks about the registered models; NaN where not registered.
    """
    registered = np.isfinite(chi_square)
    if not registered.any():
        return known
    log_weights = np.where(
        registered,
        log_scale_evidence(np.nan_to_num(chi_square), np.nan_to_num(degrees_of_freedom), PairingModel().scale_sd),
        -np.inf,
    )
    weights = np.exp(log_weights - log_weights.max())
    shared = float(known[registered].sum())
    return np.asarray(np.where(registered, shared * weights / weights.sum(), known), dtype=np.float64)


def p_value(combination: Combination) -> float:
    """The chance of landmarks at least this far off, if the combination is right and the noise is as assumed."""
    from scipy.stats import chi2

    return float(chi2.sf(combination.chi_square, combination.degrees_of_freedom))


def p_value_of(hypothesis: Hypothesis) -> float:
    """The same chance for one screw."""
    from scipy.stats import chi2

    return float(chi2.sf(hypothesis.fit.chi_square, hypothesis.fit.degrees_of_freedom))


def judge(combinations: Sequence[Combination], chosen: int, probability: float | None = None) -> Confidence:
    """Judge the choice of one combination by the landmarks.

    Parameters
    ----------
    combinations : all that were considered.
    chosen : index of the one that the method chose. A method that does not ask the landmarks may choose one that they
        contradict: that is an answer with a low probability. Refused is only where they contradict all.
    probability : of the chosen one, where more is known of it than its landmarks' chi-square.
    """
    if probability is None:
        probability = float(probabilities(combinations)[chosen])
    best = min(combinations, key=lambda combination: combination.chi_square)
    if p_value(best) < _IMPOSSIBLE_P_VALUE:
        return Confidence(
            "refused",
            probability,
            (
                f"no pairing explains the landmarks with these projection matrices and models ({_fit_words(best)}): "
                "the matrices, the models' lengths or the landmarks are wrong",
            ),
        )
    reasons = []
    if probability < CONFIDENT_PROBABILITY:
        reasons.append(
            f"the pairing is open: the chosen one has a probability of {probability:.3f}, "
            f"{CONFIDENT_PROBABILITY} is needed to be sure"
        )
    if p_value(combinations[chosen]) < _DOUBTFUL_P_VALUE:
        words = _fit_words(combinations[chosen])
        reasons.append(f"the landmarks are further off than their assumed noise allows ({words})")
    reasons += _doubtful_pairs(combinations[chosen])
    reasons += _open_models(combinations[chosen])
    return Confidence("ambiguous" if reasons else "confident", probability, tuple(reasons))


def _doubtful_pairs(combination: Combination) -> list[str]:
    """Single screws that their landmarks contradict: many good pairs would hide one in the sum."""
    reasons = []
    for hypothesis in combination.hypotheses:
        fit = hypothesis.fit
        if p_value_of(hypothesis) * len(combination.hypotheses) < _DOUBTFUL_P_VALUE:
            reasons.append(
                f"screw {hypothesis.name}: its landmarks fit each other badly (chi-square {fit.chi_square:.1f} for "
                f"{fit.degrees_of_freedom} degrees of freedom): are they of one screw?"
            )
    return reasons


def _open_models(combination: Combination) -> list[str]:
    """Screws whose model the landmarks leave open."""
    return [
        f"screw {hypothesis.name}: the model {hypothesis.runner_up} fits nearly as well as "
        f"{hypothesis.model}; name the model in its annotation"
        for hypothesis in combination.hypotheses
        if hypothesis.runner_up is not None and hypothesis.runner_up_margin < SURE_MODEL_MARGIN
    ]


def _fit_words(combination: Combination) -> str:
    return f"chi-square {combination.chi_square:.1f} for {combination.degrees_of_freedom} degrees of freedom"
