"""Silhouettes against masks worked by hand, shapes with a known area, and matplotlib's point-in-polygon test."""

import numpy as np
import pytest
from matplotlib.path import Path
from scipy.ndimage import binary_dilation

from screwpose.projection import opencv, reference

ONE = np.array([[0, 1, 2]])


def test_a_right_triangle_by_hand() -> None:
    # Corners on pixel centres: the hypotenuse u + v = 3 passes through four of them, which count as inside.
    mask = reference.silhouette(np.array([[0.0, 0], [3, 0], [0, 3]]), ONE, (5, 5))
    want = np.array([[1, 1, 1, 1, 0], [1, 1, 1, 0, 0], [1, 1, 0, 0, 0], [1, 0, 0, 0, 0], [0, 0, 0, 0, 0]], dtype=bool)
    np.testing.assert_array_equal(mask, want)


def test_u_is_the_column_and_the_centre_decides() -> None:
    thin = np.array([[1.6, 0.9], [4.4, 0.9], [4.4, 1.1], [1.6, 1.1]])
    mask = reference.silhouette(thin, np.array([[0, 1, 2], [0, 2, 3]]), (3, 6))
    np.testing.assert_array_equal(np.argwhere(mask), [[1, 2], [1, 3], [1, 4]])
    between_centres = thin + [0.0, 0.3]
    assert not reference.silhouette(between_centres, np.array([[0, 1, 2], [0, 2, 3]]), (3, 6)).any()


@pytest.mark.parametrize("silhouette", [reference.silhouette, opencv.silhouette])
def test_outside_and_across_the_border(silhouette: object) -> None:
    big = np.array([[-50.0, -50], [200, -50], [-50, 200]])
    assert silhouette(big, ONE, (20, 30)).all()  # type: ignore[operator]  # parametrised function
    assert not silhouette(big + 500, ONE, (20, 30)).any()  # type: ignore[operator]
    far = np.array([[-1e7, -1e7], [3e7, -1e7], [-1e7, 3e7]])
    assert silhouette(far, ONE, (20, 30)).all()  # type: ignore[operator]


def test_winding_does_not_matter_and_no_area_covers_nothing() -> None:
    triangle = np.array([[2.0, 1], [9, 3], [4, 8]])
    forwards = reference.silhouette(triangle, ONE, (10, 12))
    np.testing.assert_array_equal(forwards, reference.silhouette(triangle, ONE[:, ::-1], (10, 12)))
    assert forwards.sum() > 15
    assert not reference.silhouette(np.array([[0.0, 0], [4, 4], [8, 8]]), ONE, (10, 10)).any()


def test_random_triangles_match_matplotlib() -> None:
    rng = np.random.default_rng(11)
    v, u = np.mgrid[:40, :50]
    centres = np.column_stack([u.ravel(), v.ravel()])
    for _ in range(30):
        corners = rng.uniform(-10, 60, (6, 2))
        faces = np.array([[0, 1, 2], [3, 4, 5]])
        inside = [Path(corners[face]).contains_points(centres) for face in faces]
        want = (inside[0] | inside[1]).reshape(40, 50)
        np.testing.assert_array_equal(reference.silhouette(corners, faces, (40, 50)), want)


def fan(radius_px: float, center_px: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    angles = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles)]) * radius_px + center_px
    indices = np.arange(200)
    return np.vstack([rim, center_px]), np.column_stack([indices, np.roll(indices, -1), np.full(200, 200)])


def test_a_disc_has_its_area() -> None:
    vertices, faces = fan(30.0, (50.3, 44.8))
    assert abs(reference.silhouette(vertices, faces, (100, 100)).sum() - np.pi * 900) < 15


def test_opencv_covers_the_reference_and_at_most_its_outline_more() -> None:
    vertices, faces = fan(30.0, (50.3, 44.8))
    want = reference.silhouette(vertices, faces, (100, 100))
    got = opencv.silhouette(vertices, faces, (100, 100))
    assert not (want & ~got).any()
    assert not (got & ~binary_dilation(want, np.ones((3, 3)))).any()
    assert 0 < (got & ~want).sum() < 2 * np.pi * 32


def test_opencv_counts_integer_pixel_centres_too() -> None:
    # A symmetric shape about (20, 10) gives a symmetric mask: a half-pixel shift would tilt it.
    square = np.array([[14.6, 4.6], [25.4, 4.6], [25.4, 15.4], [14.6, 15.4]])
    mask = opencv.silhouette(square, np.array([[0, 1, 2], [0, 2, 3]]), (21, 41))
    np.testing.assert_array_equal(mask, mask[::-1, ::-1])
    np.testing.assert_allclose(np.argwhere(mask).mean(axis=0), [10, 20])
