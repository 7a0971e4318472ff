"""Probabilities after registration, by hand; and what of other poses is told."""

import numpy as np
import pytest
from scipy.integrate import quad

from screwpose.implants import ScrewDesign, make_screw
from screwpose.pairing import thickness
from screwpose.pairing.confidence import judged_again
from screwpose.registration.alternatives import Rival
from screwpose.registration.thickness_fit import Body

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


def test_what_looks_the_same_is_told_apart_from_what_the_images_leave_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thickness, "symmetry_order", lambda *_: 2)
    bodies = [Body(implant := make_screw(ScrewDesign(segments=16)), implant.mesh, None)] * 2
    half_turn, by_chance = Rival(0, -179.0, 0.05, -0.2), Rival(1, 181.0, 0.0, 2.2)
    slipped, ruled_out, clear = Rival(0, 178.0, 1.4, 0.3), Rival(1, 60.0, 0.5, 1.8), Rival(1, 180.0, 0.0, 4.0)
    given = [half_turn, by_chance, slipped, ruled_out, clear]
    open_ones, alike = thickness._undecided(bodies, given)
    assert open_ones == (slipped,)
    assert alike == (half_turn, by_chance)
    quality = thickness.Quality(({}, {}), 0.0, 0, open_ones, alike).of([1])
    assert quality.rivals == ()
    assert [(one.index, one.turn_deg) for one in quality.alike] == [(0, 181.0)]
