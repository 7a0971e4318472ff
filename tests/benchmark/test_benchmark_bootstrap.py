"""Intervals against closed forms and tables; calibration by hand."""

import numpy as np
import pytest
from scipy.stats import binom

from screwpose.benchmark import bootstrap


def test_wilson_by_the_formula() -> None:
    # 8 of 10, z = 1.96: (0.8 + 0.19207 -+ 1.96 sqrt(0.016 + 0.0096036)) / 1.38415, as in textbooks: 0.490 to 0.943.
    np.testing.assert_allclose(bootstrap.wilson_interval(8, 10), [0.4902, 0.9433], atol=1e-4)
    np.testing.assert_allclose(bootstrap.wilson_interval(0, 10), [0.0, 0.27753], atol=1e-4)  # z^2 / (n + z^2)
    np.testing.assert_allclose(bootstrap.wilson_interval(10, 10), [0.72247, 1.0], atol=1e-4)
    assert bootstrap.wilson_interval(0, 0) == (0.0, 1.0)


def test_wilson_covers_as_it_says() -> None:
    inside = np.array([low <= 0.9 <= high for low, high in (bootstrap.wilson_interval(k, 60) for k in range(61))])
    assert 0.93 < (binom.pmf(np.arange(61), 60, 0.9) * inside).sum() < 0.975


def test_the_median_of_distinct_values_has_binomial_bounds() -> None:
    # Of n = 101 cases with one value each, the bootstrap median is the k-th value or a lower one when at least 51 of
    # 101 draws fall among the first k: a binomial tail, which gives the interval without drawing anything.
    n, values = 101, np.arange(101.0)
    chance = np.array([binom.sf(50, n, k / n) for k in range(n + 1)])
    low, high = np.argmax(chance >= 0.025) - 1, np.argmax(chance >= 0.975) - 1
    [(found_low, found_high)] = bootstrap.quantile_intervals(values, np.arange(n), [0.5], resamples=4000, seed=1)
    assert (found_low, found_high) == (pytest.approx(low, abs=1), pytest.approx(high, abs=1))
    assert (low, high) == (40, 60)


def test_repeated_quantiles_are_numpys() -> None:
    rng = np.random.default_rng(5)
    values = np.sort(rng.normal(size=7))
    counts = rng.integers(0, 4, (20, 7))
    counts[:, 3] += 1
    for quantile in (0.0, 0.3, 0.5, 0.99, 1.0):
        found = bootstrap._quantile_of_repeated(values, np.cumsum(counts, axis=1), quantile)
        wanted = [np.quantile(np.repeat(values, row), quantile) for row in counts]
        np.testing.assert_allclose(found, wanted)


def test_cases_are_drawn_not_screws() -> None:
    # Ten cases of a hundred equal screws: by screws the median would seem known to a hair.
    values = np.repeat(np.arange(10.0), 100)
    [(low, high)] = bootstrap.quantile_intervals(values, np.repeat(np.arange(10), 100), [0.5])
    assert high - low >= 3.0
    [(low, high)] = bootstrap.quantile_intervals(values, np.arange(1000), [0.5])
    assert high - low <= 1.0


def test_order_and_numbers_of_the_cases_do_not_matter() -> None:
    rng = np.random.default_rng(2)
    cases, values = np.repeat(np.arange(30), 3), np.round(rng.gamma(2.0, size=90), 1)  # with ties
    first = bootstrap.quantile_intervals(values, cases, [0.5, 0.9])
    shuffled = rng.permutation(90)
    renamed = rng.permutation(30) * 7 + 2
    assert bootstrap.quantile_intervals(values[shuffled], renamed[cases[shuffled]], [0.5, 0.9]) == first


def test_calibration_by_hand() -> None:
    # Bin 0.5 to 0.6: two cases told 0.5 and 0.58, one right: |0.54 - 0.5| = 0.04. Bin 0.9 to 1: three told 0.9, 1.0
    # and 1.0, two right: |2.9 / 3 - 2 / 3| = 0.3. Error (2 * 0.04 + 3 * 0.3) / 5.
    bins = bootstrap.calibration_bins([0.5, 0.9, 0.58, 1.0, 1.0], [True, False, False, True, True])
    assert [(one.low, one.cases, one.right) for one in bins] == [(0.5, 2, 1), (0.9, 3, 2)]
    assert bootstrap.calibration_error(bins) == pytest.approx((2 * 0.04 + 3 * 0.3) / 5)
    assert bootstrap.calibration_error([]) is None
