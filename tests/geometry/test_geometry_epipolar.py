"""Epipolar distances against a case worked by hand and OpenCV's fundamental matrix."""

import cv2
import numpy as np

from screwpose.geometry import Camera, epipolar_distances_px, fundamental_matrix

K = np.array([[1000.0, 0, 500], [0, 1000.0, 500], [0, 0, 1]])
AP = Camera.from_matrix(K @ np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 600]]))  # source (0, 0, -600), along +z
LAT = Camera.from_matrix(K @ np.array([[0, 0, -1.0, 0], [0, 1, 0, 0], [1, 0, 0, 600]]))  # source (-600, 0, 0), along +x


def tilted() -> Camera:
    R = cv2.Rodrigues(np.array([0.2, 1.2, -0.1]))[0]
    return Camera.from_matrix(K @ np.column_stack([R, [10.0, -20, 650.0]]))


def test_by_hand() -> None:
    # AP's central ray runs through LAT at v = 500: a mark at v = 506 is 6 px off in LAT. LAT's mark (500, 506) is a
    # ray 3.6 mm below AP's central one where they cross, seen by AP as a line through (500, 506) and the image of LAT's
    # source, (-500, 500): 6 px off there too, but for the line's slope of 0.006.
    distance = epipolar_distances_px(AP, LAT, np.array([[500.0, 500.0]]), np.array([[500.0, 506.0], [480.0, 500.0]]))
    np.testing.assert_allclose(distance, [[0.5 * (6.0 + 6.0 / np.hypot(1.0, 0.006)), 0.0]], rtol=1e-9, atol=1e-9)


def test_images_of_one_point_are_on_each_others_lines() -> None:
    points = np.random.default_rng(1).uniform(-40.0, 40.0, (6, 3))
    distance = epipolar_distances_px(AP, tilted(), AP.project(points), tilted().project(points))
    np.testing.assert_allclose(np.diag(distance), np.zeros(6), atol=1e-6)
    assert distance[~np.eye(6, dtype=bool)].min() > 0.5


def test_as_opencv_has_it() -> None:
    points = np.random.default_rng(2).uniform(-60.0, 60.0, (40, 3))
    a, b = AP.project(points), tilted().project(points)
    F, _ = cv2.findFundamentalMat(a, b, cv2.FM_8POINT)
    ours = fundamental_matrix(AP, tilted())
    np.testing.assert_allclose(ours / ours[2, 2], F / F[2, 2], rtol=2e-4, atol=1e-9)
    moved = b + np.random.default_rng(3).normal(0.0, 5.0, b.shape)
    lines_b = cv2.computeCorrespondEpilines(a[:, None], 1, F)[:, 0]
    lines_a = cv2.computeCorrespondEpilines(moved[:, None], 2, F)[:, 0]

    def off(lines: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        return np.abs(np.sum(lines * np.column_stack([pixels, np.ones(len(pixels))]), axis=1))

    expected = 0.5 * (off(lines_b, moved) + off(lines_a, a))
    np.testing.assert_allclose(np.diag(epipolar_distances_px(AP, tilted(), a, moved)), expected, rtol=1e-3, atol=1e-3)
