"""Shifts and ellipses in a view, against projecting and against drawn samples."""

import numpy as np

from screwpose.geometry.camera import Camera
from screwpose.geometry.handling import ellipse_in_view, shift_in_view

CAMERA = Camera.from_matrix(np.array([[4000, 511.5, 30, 306900], [20, 511.5, -4000, 306900], [0, 1, 0.02, 600.0]]))
POINT = np.array([3.0, -7.0, 12.0])


def test_a_shift_moves_the_image_by_what_was_asked_and_keeps_the_depth():
    shift = shift_in_view(CAMERA, POINT, np.array([2.5, -1.25]))
    moved = CAMERA.project(POINT + shift) - CAMERA.project(POINT)
    np.testing.assert_allclose(moved, [2.5, -1.25], atol=1e-9)
    np.testing.assert_allclose(CAMERA.depth_mm(POINT + shift), CAMERA.depth_mm(POINT), atol=1e-9)
    assert 0.3 < np.linalg.norm(shift) < 0.5  # 0.15 mm a pixel at the screws


def test_the_ellipse_is_that_of_samples():
    rng = np.random.default_rng(3)
    root = np.array([[0.05, 0, 0], [0.02, 0.01, 0], [0, 0.03, 0.2]])
    samples = CAMERA.project(POINT + rng.normal(size=(40_000, 3)) @ root.T)
    want = np.cov(samples.T)
    ellipse = ellipse_in_view(CAMERA, POINT, root @ root.T, points=400)
    # Of a circle's points the covariance is half of the radius squared.
    np.testing.assert_allclose(2 * ellipse.T @ ellipse / len(ellipse), want, rtol=0.03, atol=4e-3)
