"""What of a screw's expected errors reaches the result: nothing that another pose would make untrue."""

import numpy as np
import pytest

from screwpose.files.schema import SigmaFile
from screwpose.pairing.answer import _alike, _doubt_by_views, _sigma
from screwpose.registration.alternatives import Rival
from screwpose.registration.uncertainty import ExpectedError

ERROR = ExpectedError(
    covariance=np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4]),
    tip_covariance_mm2=np.diag([4e-4, 5e-4, 7e-4]),
    axis_deg=0.02,
    roll_deg=0.3,
)


def test_all_of_it_in_millimetres_and_degrees() -> None:
    sigma = _sigma(ERROR, [])
    assert sigma.tip_mm == pytest.approx(0.04)
    assert (sigma.axis_deg, sigma.roll_deg) == (0.02, 0.3)
    np.testing.assert_allclose(sigma.tip_covariance_mm2, ERROR.tip_covariance_mm2)
    per_rad = 180.0 / np.pi
    np.testing.assert_allclose(
        np.diag(np.array(sigma.pose_covariance)),
        [1e-6 * per_rad**2, 2e-6 * per_rad**2, 3e-6 * per_rad**2, 1e-4, 2e-4, 3e-4],
    )
    assert SigmaFile.model_validate_json(sigma.model_dump_json()) == sigma


def test_another_turn_takes_the_roll_and_another_depth_the_tip() -> None:
    turned = _sigma(ERROR, [Rival(0, 180.0, 0.1, 0.4)])
    assert (turned.roll_deg, turned.pose_covariance) == (None, None)
    assert turned.tip_mm == pytest.approx(0.04)
    shifted = _sigma(ERROR, [Rival(0, 180.0, 1.4, 0.4)])
    assert (shifted.tip_mm, shifted.tip_covariance_mm2, shifted.roll_deg) == (None, None, None)
    assert shifted.axis_deg == 0.02


def test_a_roll_that_is_not_seen_is_not_given() -> None:
    sigma = _sigma(ERROR.without_roll(), [])
    assert (sigma.roll_deg, sigma.pose_covariance) == (None, None)
    assert sigma.tip_mm == pytest.approx(0.04)


def test_what_a_reader_is_told_of_symmetry_and_of_views_that_disagree() -> None:
    assert "looks the same after half a turn" in _alike(179)
    assert "looks the same after 120 degrees" in _alike(120)
    told = _doubt_by_views({"AP": 1.26, "LAT": 0.5})
    assert "AP alone would have it 1.3 px elsewhere and LAT alone would have it 0.5 px elsewhere" in told
