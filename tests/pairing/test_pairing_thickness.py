"""Probabilities after registration, by hand."""

import numpy as np
from scipy.integrate import quad

from screwpose.pairing.confidence import judged_again

NAN = np.nan


def evidence(chi_square: float, numbers: float) -> float:
    """The integral over the noise's factor s, whose logarithm is normal about 0 with a sigma of 0.5."""

    def weight(log_s: float) -> float:
        return float(np.exp(-0.5 * (log_s / 0.5) ** 2 - numbers * log_s - 0.5 * chi_square * np.exp(-2 * log_s)))

    return float(quad(weight, -3.0, 3.0, points=[0.0])[0])


def test_registered_combinations_share_what_they_had_by_their_marks() -> None:
    known = np.array([0.5, 0.3, 0.2])
    again = judged_again(known, np.array([10.0, 14.0, NAN]), np.array([16.0, 16.0, NAN]))
    odds = evidence(14.0, 16.0) / evidence(10.0, 16.0)
    np.testing.assert_allclose(again, [0.8 / (1 + odds), 0.8 * odds / (1 + odds), 0.2], rtol=0.01)


def test_marks_that_are_further_off_than_assumed_count_for_less() -> None:
    """The same difference of 16 decides less where even the better one is twice as far off as it should be."""
    numbers = np.array([16.0, 16.0])
    again = judged_again(np.array([0.5, 0.5]), np.array([48.0, 32.0]), numbers)
    odds = evidence(48.0, 16.0) / evidence(32.0, 16.0)
    np.testing.assert_allclose(again, [odds / (1 + odds), 1 / (1 + odds)], rtol=0.01)
    nearer = judged_again(np.array([0.5, 0.5]), np.array([26.0, 10.0]), numbers)
    assert nearer[0] < 0.2 * again[0]


def test_without_registration_nothing_changes() -> None:
    known = np.array([0.9, 0.1])
    np.testing.assert_array_equal(judged_again(known, np.array([NAN, NAN]), np.array([NAN, NAN])), known)
