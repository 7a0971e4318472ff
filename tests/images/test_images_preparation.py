"""Log, background and smoothing against closed forms and SciPy."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from screwpose.images import background, carried_outwards, flattened, log_image, smoothed


def test_log_adds_up_along_a_ray() -> None:
    """Two layers that let a half and a quarter through make an eighth: their logs add."""
    pixels = (1 - np.array([[1.0, 0.5, 0.25, 0.125]])).astype(np.float32)
    got = log_image(pixels)
    np.testing.assert_allclose(got[0, 1] + got[0, 2], got[0, 3], rtol=1e-6)
    np.testing.assert_allclose(got, -np.log([[1.0, 0.5, 0.25, 0.125]]) / np.log(85), rtol=1e-5, atol=1e-7)
    assert got.dtype == np.float32


def test_log_floor_is_three_counts() -> None:
    counts = np.array([[255, 85, 3, 2, 0]])
    got = log_image((1 - counts / 255).astype(np.float32))
    np.testing.assert_allclose(got, [[0, np.log(3) / np.log(85), 1, 1, 1]], atol=1e-5)


def test_smoothed_against_scipy() -> None:
    image = np.random.default_rng(1).random((60, 70)).astype(np.float32)
    np.testing.assert_allclose(smoothed(image, 2.0), gaussian_filter(image, 2.0, mode="nearest"), atol=2e-3)
    assert smoothed(image, 0) is image
    with pytest.raises(ValueError, match="sigma_px is -1, expected 0 or more"):
        smoothed(image, -1)


@pytest.mark.parametrize("sigma_px", [3.0, 20.0])
def test_background_against_normalised_convolution(sigma_px: float) -> None:
    rng = np.random.default_rng(2)
    v, u = np.mgrid[:200, :240]
    image = (0.3 + 0.2 * np.sin(u / 60) + 0.1 * np.cos(v / 40) + 0.02 * rng.standard_normal(u.shape)).astype(np.float32)
    region = np.hypot(u - 120, v - 100) < 90
    weight = gaussian_filter(region.astype(float), sigma_px, mode="reflect", truncate=6)
    want = gaussian_filter(image * region, sigma_px, mode="reflect", truncate=6) / np.maximum(weight, 1e-9)
    got = background(image, region, sigma_px)
    assert np.ptp(want[region]) > 0.2
    np.testing.assert_allclose(got[region], want[region], atol=0.01)
    # What lies outside does not count, however bright.
    np.testing.assert_allclose(background(np.where(region, image, 9), region, sigma_px)[region], got[region], atol=1e-5)


def test_flattened_removes_a_slope_and_keeps_a_rod() -> None:
    v, u = np.mgrid[:200, :200]
    rod = (abs(u - 100) < 4) * 0.3
    region = np.ones(u.shape, dtype=bool)
    region[:20] = False
    got = flattened((0.002 * v + rod).astype(np.float32), region, 25.0)
    np.testing.assert_allclose(got[60:160, 30:60].mean(axis=1), got[110, 30:60].mean(), atol=0.01)
    assert (got[60:160, 98:103] - got[60:160, 30:35]).min() > 0.25
    assert (got[:20] == 0).all()


def test_empty_region_is_refused() -> None:
    with pytest.raises(ValueError, match="the region is empty"):
        background(np.zeros((4, 4), np.float32), np.zeros((4, 4), bool), 2.0)


def test_carried_outwards_is_the_nearest_inside() -> None:
    image = np.array([[9, 1, 2, 9, 9]], dtype=np.float32)
    region = np.array([[False, True, True, False, False]])
    np.testing.assert_array_equal(carried_outwards(image, region), [[1, 1, 2, 2, 2]])
