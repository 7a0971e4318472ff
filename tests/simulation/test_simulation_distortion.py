"""Pincushion and S distortion: points against hand-worked values, images against points."""

import numpy as np
import pytest

from screwpose._types import FloatArray
from screwpose.simulation.detector import Detector, expected_signal
from screwpose.simulation.distortion import distorted_px, undistorted_px

SIZE = (401, 301)  # centre (200, 150), R = 150.5


def bent(pincushion: float, s_rad: float) -> Detector:
    return Detector(image_size=SIZE, blur_px=0.0, scatter_fraction=0.0, pincushion=pincushion, s_distortion_rad=s_rad)


def test_points_by_hand():
    """At R the radius grows by the pincushion, and the angle by S; at R / 2 by a quarter of both."""
    detector = bent(0.04, 0.1)
    points = np.array([[200.0, 150.0], [350.5, 150.0], [200.0, 150.0 + 75.25]])
    quarter = 75.25 * 1.01
    want = [
        [200.0, 150.0],
        [200.0 + 150.5 * 1.04 * np.cos(0.1), 150.0 + 150.5 * 1.04 * np.sin(0.1)],
        [200.0 - quarter * np.sin(0.025), 150.0 + quarter * np.cos(0.025)],
    ]
    np.testing.assert_allclose(distorted_px(detector, points), want, atol=1e-10)
    np.testing.assert_array_equal(distorted_px(bent(0.0, 0.0), points), points)


@pytest.mark.parametrize(("pincushion", "s_rad"), [(0.05, 0.0), (0.0, -0.08), (0.12, 0.06), (-0.045, 0.05), (0.5, 0.3)])
def test_the_inverse_is_exact(pincushion, s_rad):
    detector = bent(pincushion, s_rad)
    rng = np.random.default_rng(1)
    points = rng.uniform([0.0, 0.0], [400.0, 300.0], (500, 2))
    points[0] = [200.0, 150.0]
    seen = distorted_px(detector, points)
    assert np.abs(seen - points).max() > 3.0
    np.testing.assert_allclose(undistorted_px(detector, seen), points, atol=1e-7)
    np.testing.assert_allclose(distorted_px(detector, undistorted_px(detector, points)), points, atol=1e-7)


def wire(through_px: FloatArray, angle_rad: float) -> FloatArray:
    """The transmission of a straight wire of Gaussian profile."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    across = -(u - through_px[0]) * np.sin(angle_rad) + (v - through_px[1]) * np.cos(angle_rad)
    return 1.0 - 0.6 * np.exp(-0.5 * (across / 1.6) ** 2)


@pytest.mark.parametrize(("pincushion", "s_rad"), [(0.05, 0.03), (-0.04, 0.0), (0.0, 0.06)])
def test_a_straight_wire_bends_to_where_its_marks_are(pincushion, s_rad):
    detector = bent(pincushion, s_rad)
    through, angle = np.array([200.0, 60.0]), 0.1
    image = wire(through, angle)
    signal = expected_signal(image, detector, np.ones_like(image))
    marks = through + np.linspace(-170.0, 170.0, 18)[:, None] * [np.cos(angle), np.sin(angle)]
    seen = distorted_px(detector, marks)
    ahead = distorted_px(detector, marks + 0.01 * np.array([np.cos(angle), np.sin(angle)])) - seen
    normal = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
    steps = np.arange(-6.0, 6.01, 0.05)
    errors = []
    for point, across in zip(seen, normal, strict=True):
        dark = 1.0 - bilinear(signal, point + steps[:, None] * across)
        errors.append(float((steps * dark).sum() / dark.sum()))
    assert np.abs(errors).max() < 0.05
    # Its ends are far from a straight line through the middle, so the test can see the distortion.
    straight = np.abs(seen - marks)[:, 1]
    assert straight.max() > 1.0
    undone = Detector(image_size=SIZE, blur_px=0.0, scatter_fraction=0.0)
    np.testing.assert_array_equal(expected_signal(image, undone, np.ones_like(image)), image)


def bilinear(image: FloatArray, at_px: FloatArray) -> FloatArray:
    u, v = at_px[:, 0], at_px[:, 1]
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    du, dv = u - left, v - top
    return (
        image[top, left] * (1 - du) * (1 - dv)
        + image[top, left + 1] * du * (1 - dv)
        + image[top + 1, left] * (1 - du) * dv
        + image[top + 1, left + 1] * du * dv
    )


def test_no_ringing_goes_below_zero_beside_air():
    image = np.full((301, 401), 0.01)
    image[:, 150:] = 1.0
    signal = expected_signal(image, bent(0.04, 0.02), np.ones_like(image))
    assert signal.min() > 0.005 / 1.0
    np.testing.assert_allclose(signal[150, [20, 390]] / signal[150, 390], [0.01, 1.0], rtol=1e-3)
