"""The rigid segment's chi-square against its distribution and a case worked by hand."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2, kstest

from screwpose.errors import ParallelViewsError
from screwpose.pairing import LandmarkNoise, fit_segment
from screwpose.pairing.segment import _residuals, triangulated_segment
from tests.pairing.scenes import camera, screws

CAMERAS = [camera(0.0), camera(88.0)]


def test_exact_landmarks_fit_exactly() -> None:
    ends = screws(np.random.default_rng(1), 1)[0]
    pixels = np.array([view.project(ends) for view in CAMERAS])
    fit = fit_segment(CAMERAS, pixels[:, 0], pixels[:, 1], 22.5, LandmarkNoise())
    assert fit.chi_square < 1e-9
    np.testing.assert_allclose([fit.tip_mm, fit.center_mm], ends, atol=1e-6)
    np.testing.assert_allclose(fit.measured_length_mm, 22.5, atol=1e-6)
    assert fit.degrees_of_freedom == 3


def test_a_wrong_length_by_hand() -> None:
    # The marks are exact to far below the length's sigma, so the length alone pays: (23.5 - 22.5)^2 / 0.5^2.
    ends = screws(np.random.default_rng(2), 1)[0]
    pixels = np.array([view.project(ends) for view in CAMERAS])
    fit = fit_segment(CAMERAS, pixels[:, 0], pixels[:, 1], 23.5, LandmarkNoise(0.001, 0.5))
    np.testing.assert_allclose(fit.chi_square, 4.0, rtol=1e-3)


def test_the_chi_square_is_distributed_as_it_says() -> None:
    rng = np.random.default_rng(3)
    noise = LandmarkNoise(1.5, 0.4)
    values = []
    for _ in range(400):
        ends = screws(rng, 1)[0]
        ends[1] += (ends[1] - ends[0]) / 22.5 * rng.normal(0, 0.4)  # the clicked centre is not quite the model's
        pixels = np.array([view.project(ends) for view in CAMERAS]) + rng.normal(0, 1.5, (2, 2, 2))
        values.append(fit_segment(CAMERAS, pixels[:, 0], pixels[:, 1], 22.5, noise).chi_square)
    assert kstest(values, chi2(3).cdf).pvalue > 0.01
    assert kstest(values, chi2(2).cdf).pvalue < 1e-6  # the test can tell 2 degrees of freedom from 3


def test_parallel_views_are_refused() -> None:
    ends = screws(np.random.default_rng(4), 1)[0]
    views = [camera(0.0), camera(1.0)]
    pixels = np.array([view.project(ends) for view in views])
    with pytest.raises(ParallelViewsError, match="3 are needed"):
        fit_segment(views, pixels[:, 0], pixels[:, 1], 22.5, LandmarkNoise())


@pytest.mark.parametrize("wrong_mm", [0.0, 6.0])
def test_the_least_chi_square_is_scipys(wrong_mm: float) -> None:
    """Also where the marks are not one screw's: the residuals are then large, and the fit has far to go."""
    rng = np.random.default_rng(5)
    noise = LandmarkNoise(1.5, 0.4)
    compared = 0
    for _ in range(40):
        ends = screws(rng, 1)[0]
        pixels = np.array([view.project(ends + rng.normal(0, wrong_mm, (1, 3))) for view in CAMERAS])
        pixels += rng.normal(0, 1.5, (2, 2, 2))
        start = triangulated_segment(CAMERAS, pixels[:, 0], pixels[:, 1], 22.5, noise)
        arguments = (CAMERAS, pixels[:, 0], pixels[:, 1], 22.5, noise)
        found = least_squares(
            lambda x, a=arguments: _residuals(x, *a), np.concatenate([start.tip_mm, start.center_mm]), method="lm"
        )
        got = fit_segment(*arguments)
        compared += start.chi_square > 1.01 * got.chi_square  # the triangulated points are not yet the answer
        assert got.chi_square == pytest.approx(2.0 * found.cost, rel=1e-6)
    assert compared > 5
