"""Triangulation against a case worked by hand, OpenCV and a direct minimisation."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from screwpose.errors import BehindSourceError, CalibrationError, ParallelViewsError
from screwpose.geometry import Camera, triangulate
from screwpose.geometry.triangulation import linear_system

K = np.array([[1000.0, 0, 500], [0, 1000.0, 500], [0, 0, 1]])
AP = Camera.from_matrix(K @ np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 600]]))  # source (0, 0, -600), along +z
LAT = Camera.from_matrix(K @ np.array([[0, 0, -1.0, 0], [0, 1, 0, 0], [1, 0, 0, 600]]))  # source (-600, 0, 0), along +x


def view_from(angle_deg: float) -> Camera:
    R = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return Camera.from_matrix(K @ np.column_stack([R, [0, 0, 600.0]]))


def test_by_hand() -> None:
    # (30, 60, 0): AP depth 600 -> (500 + 50, 500 + 100); LAT depth 630 -> (500 - 0, 500 + 60 / 0.63).
    found = triangulate([AP, LAT], np.array([[550.0, 600.0], [500.0, 500 + 60 / 0.63]]))
    np.testing.assert_allclose(found.point_in_world_mm, [30, 60, 0], atol=1e-9)
    np.testing.assert_allclose(found.residuals_px, np.zeros((2, 2)), atol=1e-9)
    np.testing.assert_allclose(found.ray_distances_mm, [0, 0], atol=1e-9)


def test_rows_of_the_system_are_the_papers() -> None:
    A, b = linear_system([AP], np.array([[550.0, 600.0]]))
    # p1 = (1000, 0, 500, 300000), p2 = (0, 1000, 500, 300000), p3 = (0, 0, 1, 600)
    np.testing.assert_allclose(A, [[1000, 0, 500 - 550], [0, 1000, 500 - 600]])
    np.testing.assert_allclose(b, [550 * 600 - 300000, 600 * 600 - 300000])


def test_skew_rays_by_hand() -> None:
    # Both principal rays, LAT's moved 6 px down: 3.6 mm at 600 mm. The point lies between, 1.8 mm from each ray.
    found = triangulate([AP, LAT], np.array([[500.0, 500.0], [500.0, 506.0]]))
    np.testing.assert_allclose(found.point_in_world_mm, [0, 1.8, 0], atol=0.02)
    np.testing.assert_allclose(found.ray_distances_mm, [1.8, 1.8], atol=0.01)
    np.testing.assert_allclose(found.residuals_px, [[0, 3], [0, -3]], atol=0.02)
    np.testing.assert_allclose(found.rms_px, 3.0, atol=0.02)
    np.testing.assert_allclose(found.ray_angle_deg, 90, atol=0.01)


def test_noise_free_points_match_opencv() -> None:
    rng = np.random.default_rng(7)
    points = rng.uniform(-60, 60, (20, 3))
    pixels = [camera.project(points) for camera in (AP, LAT)]
    want = cv2.triangulatePoints(AP.projection, LAT.projection, pixels[0].T, pixels[1].T)
    for i, point in enumerate(points):
        found = triangulate([AP, LAT], np.array([pixels[0][i], pixels[1][i]])).point_in_world_mm
        np.testing.assert_allclose(found, (want[:3, i] / want[3, i]), atol=1e-6)
        np.testing.assert_allclose(found, point, atol=1e-9)


def test_noisy_points_solve_the_normal_equations_of_all_views() -> None:
    rng = np.random.default_rng(8)
    cameras = [AP, LAT, view_from(40.0)]
    pixels = np.array([camera.project(np.array([10.0, 20, 30])) for camera in cameras]) + rng.normal(0, 2, (3, 2))
    A, b = linear_system(cameras, pixels)
    want = np.linalg.solve(A.T @ A, A.T @ b)
    np.testing.assert_allclose(triangulate(cameras, pixels).point_in_world_mm, want, atol=1e-7)


def test_the_scale_of_a_matrix_changes_nothing() -> None:
    pixels = np.array([[520.0, 480.0], [510.0, 486.0]])
    scaled = [Camera.from_matrix(-1e-3 * AP.projection), Camera.from_matrix(40 * LAT.projection)]
    want = triangulate([AP, LAT], pixels).point_in_world_mm
    np.testing.assert_allclose(triangulate(scaled, pixels).point_in_world_mm, want, atol=1e-9)


def test_parallel_views_are_refused() -> None:
    assert triangulate([AP, view_from(4.0)], np.full((2, 2), 500.0)).ray_angle_deg == pytest.approx(4.0)
    with pytest.raises(ParallelViewsError, match="differ by 2 degrees at most, 3 are needed"):
        triangulate([AP, view_from(2.0)], np.full((2, 2), 500.0))


def test_the_condition_grows_as_the_views_come_together() -> None:
    conditions = [triangulate([AP, view_from(a)], np.full((2, 2), 500.0)).condition for a in (90.0, 30.0, 10.0)]
    assert conditions[0] < 2 < conditions[1] < conditions[2]


def test_rays_that_meet_behind_a_source_are_refused() -> None:
    behind = np.array([0.0, 0.0, -700.0])  # 100 mm behind AP's source
    pixels = []
    for camera in (AP, LAT):
        w = camera.projection @ np.append(behind, 1)
        pixels.append(w[:2] / w[2])
    with pytest.raises(BehindSourceError, match="depth -100 mm"):
        triangulate([AP, LAT], np.array(pixels))


def test_one_view_is_not_enough() -> None:
    with pytest.raises(CalibrationError, match="two views or more"):
        triangulate([AP], np.array([[1.0, 2.0]]))
