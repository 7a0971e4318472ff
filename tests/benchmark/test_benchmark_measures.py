"""Each measure of a pose against a value worked by hand."""

import numpy as np
import pytest

from screwpose.benchmark import measures
from screwpose.geometry import rigid
from tests.benchmark.worked import AP, BAR, DISTANCE_MM, FOCAL_PX, LAT, box, shifted, turned


@pytest.mark.parametrize(
    ("roll_deg", "order", "counted"),
    [
        (92.0, 4, 2.0),
        (-179.0, 2, 1.0),
        (179.0, 1, 179.0),
        (44.0, 4, 44.0),
        (46.0, 4, -44.0),
        (119.0, 3, -1.0),
        (-59.0, 6, 1.0),
    ],
)
def test_a_roll_by_symmetry(roll_deg: float, order: int, counted: float) -> None:
    assert measures.roll_by_symmetry_deg(roll_deg, order) == pytest.approx(counted)


def test_what_turns_freely_has_no_roll() -> None:
    assert measures.roll_by_symmetry_deg(33.0, 0) is None


def test_a_shift_along_the_ray_is_all_depth() -> None:
    point = np.array([30.0, -20.0, 10.0])
    ray = (point - AP.center_in_world_mm) / np.linalg.norm(point - AP.center_in_world_mm)
    in_plane, depth = measures.in_plane_and_depth_mm(AP, point + 2.5 * ray, point)
    assert (in_plane, depth) == (pytest.approx(0.0, abs=1e-9), pytest.approx(2.5))
    np.testing.assert_allclose(AP.project(point + 2.5 * ray), AP.project(point), atol=1e-9)
    assert measures.in_plane_and_depth_mm(AP, point - 2.5 * ray, point)[1] == pytest.approx(-2.5)


def test_what_is_depth_for_one_view_is_in_plane_for_the_other() -> None:
    moved = np.array([0.0, 0.0, 3.0])  # along the viewing axis of AP
    assert measures.in_plane_and_depth_mm(AP, moved, np.zeros(3)) == (pytest.approx(0), pytest.approx(3))
    assert measures.in_plane_and_depth_mm(LAT, moved, np.zeros(3)) == (pytest.approx(3), pytest.approx(0))
    three_four = np.array([3.0, 4.0, 0.0])
    assert measures.in_plane_and_depth_mm(AP, three_four, np.zeros(3))[0] == pytest.approx(5)


def test_surface_weights_are_areas() -> None:
    points, weights = measures.surface_points(box((0, 0, 0), (1, 2, 3)))
    assert weights.sum() == pytest.approx(1.0)
    # The mean of y over the surface of a box is its middle; that of y^2 by hand: the four sides along y (area 16)
    # have 4/3, the ends (area 3 each) 0 and 4: (16 * 4/3 + 3 * 4) / 22.
    assert weights @ points[:, 1] == pytest.approx(1.0)
    assert weights @ points[:, 1] ** 2 == pytest.approx((16 * 4 / 3 + 12) / 22)


def test_mtre_of_a_shift_and_of_half_a_turn() -> None:
    points, weights = measures.surface_points(BAR.mesh)
    assert measures.mtre_mm(points, weights, shifted(1, 2, 2), np.eye(4)) == pytest.approx(3.0)
    assert measures.mtre_mm(points, weights, shifted(1, 2, 2), shifted(1, 2, 2)) == 0.0
    # By half a turn about the axis each point moves by twice its distance from it: the mean over the square's sides
    # of half-width 5 is 5 (sqrt 2 + asinh 1) / 2 = 5.74, over the square itself 5.74 / 1.5.
    half_turn = measures.mtre_mm(points, weights, turned((0, 1, 0), 180.0), np.eye(4))
    on_sides = 5 * (np.sqrt(2) + np.arcsinh(1)) / 2
    by_hand = 2 * on_sides * (1200 + 200 / 1.5) / 1400
    assert half_turn == pytest.approx(by_hand, rel=0.08)  # a box has few triangles to integrate over


def test_the_projection_of_a_shift_in_the_plane() -> None:
    points = np.array([[0.0, 0, 0], [0, 10, 0], [7, 0, 0]])
    even = np.full(3, 1 / 3)
    moved = shifted(0.3, 0.4)
    px_per_mm = FOCAL_PX / DISTANCE_MM
    assert measures.projection_distance_px(AP, points, even, moved, np.eye(4)) == pytest.approx(0.5 * px_per_mm)
    assert measures.projection_distance_px(LAT, points[:2], np.full(2, 0.5), shifted(0, 0.4), np.eye(4)) == (
        pytest.approx(0.4 * px_per_mm)
    )
    behind = shifted(0, 0, -2 * DISTANCE_MM)
    assert measures.projection_distance_px(AP, points, even, behind, np.eye(4)) is None


def test_mahalanobis_by_hand() -> None:
    error, covariance = np.array([1.0, 2.0, 0.0]), np.diag([1.0, 4.0, 9.0])
    assert measures.mahalanobis2(error, covariance) == pytest.approx(2.0)
    R = rigid.exp_rotation(np.array([0.3, 0.5, -0.2]))
    assert measures.mahalanobis2(R @ error, R @ covariance @ R.T) == pytest.approx(2.0)
    assert measures.mahalanobis2(error, np.zeros((3, 3))) is None


def test_rms_by_hand() -> None:
    assert measures.rms([3.0, -4.0, 0.0]) == pytest.approx(5 / np.sqrt(3))


def test_landmarks_hold_the_pivot_where_there_is_one() -> None:
    np.testing.assert_array_equal(measures.landmark_points(BAR), [[0, 0, 0], [0, 15, 0], [0, 20, 0]])
