"""How sure is a figure? Bootstrap intervals over cases, Wilson's intervals of rates, calibration of probabilities."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray, IntArray

RESAMPLES = 1000
LEVEL = 0.95
BINS = 10
_Z = 1.959963984540054  # of the standard normal distribution, for LEVEL
_ROWS_AT_ONCE = 128


def wilson_interval(hits: float, trials: float) -> tuple[float, float]:
    """Wilson's score interval of a rate, at 95 %; (0, 1) without any trial.

    References
    ----------
    Wilson (1927), "Probable inference, the law of succession, and statistical inference".
    """
    if trials <= 0:
        return 0.0, 1.0
    share, z2 = hits / trials, _Z * _Z
    middle = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = _Z / (1 + z2 / trials) * np.sqrt(share * (1 - share) / trials + z2 / (4 * trials * trials))
    # At 0 and 1 the bound is the rate itself; rounding must not push it past.
    low = 0.0 if hits <= 0 else float(middle - half)
    high = 1.0 if hits >= trials else float(middle + half)
    return max(low, 0.0), min(high, 1.0)


def quantile_intervals(
    values: FloatArray,
    cases: IntArray,
    quantiles: Sequence[float],
    *,
    resamples: int = RESAMPLES,
    level: float = LEVEL,
    seed: int = 0,
) -> list[tuple[float, float]]:
    """Percentile bootstrap intervals of quantiles; whole cases are drawn, since the screws of one share their luck.

    Parameters
    ----------
    values : (N,), at least one.
    cases : (N,), any whole number that the values of one case share.
    quantiles : 0 to 1, by linear interpolation as in `numpy.quantile`.

    Returns
    -------
    (low, high) of each quantile. The same for any order of the values.

    References
    ----------
    Efron and Tibshirani (1993), "An Introduction to the Bootstrap", chapters 8 and 13.
    """
    cases = _renumbered(values, cases)
    order = np.argsort(values, kind="stable")
    sorted_values, sorted_cases = values[order], cases[order]
    count = int(cases.max()) + 1
    rng = np.random.default_rng(seed)
    found: list[list[FloatArray]] = [[] for _ in quantiles]
    for start in range(0, resamples, _ROWS_AT_ONCE):
        rows = min(_ROWS_AT_ONCE, resamples - start)
        draws = rng.multinomial(count, np.full(count, 1.0 / count), size=rows)
        drawn_up_to = np.cumsum(draws[:, sorted_cases], axis=1)
        for one, quantile in zip(found, quantiles, strict=True):
            one.append(_quantile_of_repeated(sorted_values, drawn_up_to, quantile))
    tails = [0.5 * (1 - level), 0.5 * (1 + level)]
    bounds = (np.quantile(np.concatenate(one), tails) for one in found)
    return [(float(low), float(high)) for low, high in bounds]


def _renumbered(values: FloatArray, cases: IntArray) -> IntArray:
    """0, 1, 2, ... by the values that the cases hold: neither their numbers nor their order is to change the draws."""
    held: dict[int, list[float]] = {}
    for case, value in zip(cases.tolist(), values.tolist(), strict=True):
        held.setdefault(case, []).append(value)
    number = {case: k for k, case in enumerate(sorted(held, key=lambda case: sorted(held[case])))}
    return np.array([number[case] for case in cases.tolist()], dtype=np.int64)


def _quantile_of_repeated(sorted_values: FloatArray, up_to: IntArray, quantile: float) -> FloatArray:
    """The quantile of each row, in which value n stands ``up_to[row, n] - up_to[row, n - 1]`` times."""
    rows, columns = up_to.shape
    total = up_to[:, -1]
    place = (total - 1) * quantile
    below = np.floor(place).astype(np.int64)
    above = np.minimum(below + 1, total - 1)
    # One search for all rows: each row's counts are lifted past those of the row before.
    lift = np.arange(rows) * (int(total.max()) + 1)
    flat = (up_to + lift[:, None]).ravel()
    low, high = (
        sorted_values[np.searchsorted(flat, index + lift, side="right") - np.arange(rows) * columns]
        for index in (below, above)
    )
    return np.asarray(low + (place - below) * (high - low))


@dataclass(frozen=True)
class CalibrationBin:
    """The cases whose probability lies in ``low`` to ``high`` (the upper end included in the last bin alone)."""

    low: float
    high: float
    cases: int
    mean_probability: float
    right: int


def calibration_bins(probabilities: Sequence[float], right: Sequence[bool], bins: int = BINS) -> list[CalibrationBin]:
    """Bins of equal width over 0 to 1, those that hold any case."""
    p, hits = np.asarray(probabilities, dtype=np.float64), np.asarray(right, dtype=np.bool_)
    number = np.minimum((p * bins).astype(np.int64), bins - 1)
    return [
        CalibrationBin(
            k / bins, (k + 1) / bins, int(inside.sum()), float(np.sort(p[inside]).mean()), int(hits[inside].sum())
        )
        for k in range(bins)
        if (inside := number == k).any()
    ]


def calibration_error(bins: Sequence[CalibrationBin]) -> float | None:
    """Expected calibration error: the mean over the cases of |mean probability - share right| of their bin.

    References
    ----------
    Naeini, Cooper and Hauskrecht (2015), "Obtaining well calibrated probabilities using Bayesian binning".
    """
    cases = sum(one.cases for one in bins)
    if not cases:
        return None
    return sum(one.cases * abs(one.mean_probability - one.right / one.cases) for one in bins) / cases
