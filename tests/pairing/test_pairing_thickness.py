"""Probabilities after registration, by hand."""

import numpy as np

from screwpose.pairing.confidence import judged_again

NAN = np.nan


def test_registered_combinations_share_what_they_had_by_their_marks() -> None:
    known = np.array([0.5, 0.3, 0.2])
    again = judged_again(known, np.array([10.0, 14.0, NAN]), np.array([16.0, 16.0, NAN]))
    odds = np.exp(-2.0)
    np.testing.assert_allclose(again, [0.8 / (1 + odds), 0.8 * odds / (1 + odds), 0.2])


def test_marks_that_are_further_off_than_assumed_count_for_less() -> None:
    again = judged_again(np.array([0.5, 0.5]), np.array([48.0, 32.0]), np.array([16.0, 16.0]))
    odds = np.exp(-(48.0 - 32.0) / (2.0 * 2.0))  # the better one is twice as far off as it should be
    np.testing.assert_allclose(again, [odds / (1 + odds), 1 / (1 + odds)])


def test_without_registration_nothing_changes() -> None:
    known = np.array([0.9, 0.1])
    np.testing.assert_array_equal(judged_again(known, np.array([NAN, NAN]), np.array([NAN, NAN])), known)
