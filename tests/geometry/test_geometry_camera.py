"""The camera against values worked by hand, OpenCV, and the real calibrations."""

import json

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from screwpose.errors import BehindSourceError, CalibrationError
from screwpose.geometry import Camera
from tests.data import shared_data

# Source at (0, 0, -600), looking along +z, 1000 px focal length, principal point (511.5, 400).
BY_HAND = np.array([[1000.0, 0, 511.5, 511.5 * 600], [0, 1000.0, 400.0, 400.0 * 600], [0, 0, 1.0, 600.0]])


def random_camera(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    K = np.array([[3000 + 500 * rng.random(), 2 * rng.random(), 500], [0, 3100, 520 + rng.random()], [0, 0, 1]])
    R = Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix()
    t = np.array([10.0, -20.0, 700.0])
    return K @ np.column_stack([R, t]), K, R, t


def test_project_by_hand() -> None:
    camera = Camera.from_matrix(BY_HAND, (1024, 800))
    # 30 mm to the right at depth 600 + 150 = 750 mm: 30 / 750 * 1000 = 40 px.
    np.testing.assert_allclose(camera.project(np.array([30.0, -15.0, 150.0])), [511.5 + 40, 400 - 20])
    np.testing.assert_allclose(camera.center_in_world_mm, [0, 0, -600])
    np.testing.assert_allclose(camera.depth_mm(np.array([0, 0, 150.0])), [750])
    np.testing.assert_allclose(camera.viewing_axis_in_world, [0, 0, 1])
    np.testing.assert_allclose(camera.mm_per_px_at(np.array([0, 0, 0.0])), 0.6)


@pytest.mark.parametrize("scale", [1.0, -1.0, 1e-3, -37.0])
def test_any_scale_and_sign_is_normalised_to_depth_in_mm(scale: float) -> None:
    camera = Camera.from_matrix(scale * BY_HAND)
    np.testing.assert_allclose(camera.projection, BY_HAND, atol=1e-9)


def test_project_matches_opencv() -> None:
    rng = np.random.default_rng(3)
    _, K, R, t = random_camera(rng)
    points = rng.uniform(-80, 80, (50, 3))
    want, _ = cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, K * [[1, 0, 1], [0, 1, 1], [1, 1, 1]], None)
    P_no_skew = (K * [[1, 0, 1], [0, 1, 1], [1, 1, 1]]) @ np.column_stack([R, t])
    np.testing.assert_allclose(Camera.from_matrix(-2 * P_no_skew).project(points), want[:, 0], atol=1e-8)


def test_intrinsics_and_pose_are_recovered() -> None:
    P, K, R, t = random_camera(np.random.default_rng(4))
    camera = Camera.from_matrix(P * -0.01)
    np.testing.assert_allclose(camera.intrinsics, K, atol=1e-7)
    np.testing.assert_allclose(camera.camera_from_world[:3, :3], R, atol=1e-10)
    np.testing.assert_allclose(camera.camera_from_world[:3, 3], t, atol=1e-7)


def test_a_ray_passes_through_what_its_pixel_sees() -> None:
    P, *_ = random_camera(np.random.default_rng(5))
    camera = Camera.from_matrix(P)
    point = np.array([12.0, 33.0, -8.0])
    direction = camera.ray_directions_in_world(camera.project(point))[0]
    to_point = point - camera.center_in_world_mm
    np.testing.assert_allclose(direction, to_point / np.linalg.norm(to_point), atol=1e-9)


def test_a_mirrored_matrix_keeps_its_sign_when_a_point_in_front_is_known() -> None:
    mirrored = np.diag([1.0, -1.0, 1.0]) @ BY_HAND  # v grows upwards
    camera = Camera.from_matrix(mirrored, in_front_in_world_mm=np.zeros(3))
    assert not camera.is_right_handed
    np.testing.assert_allclose(camera.project(np.array([30.0, -15.0, 150.0])), [551.5, -380.0])
    with pytest.raises(BehindSourceError, match="depth -600 mm"):
        Camera.from_matrix(mirrored).project(np.zeros(3))


def test_behind_the_source_is_refused() -> None:
    with pytest.raises(BehindSourceError, match=r"point 1 of 2 has depth -10 mm.*not in front of the X-ray source"):
        Camera.from_matrix(BY_HAND).project(np.array([[0.0, 0, 0], [0, 0, -610]]))


@pytest.mark.parametrize(
    ("matrix", "text"),
    [
        (np.eye(3), r"shape \(3, 3\); expected 3 rows of 4 numbers"),
        (BY_HAND * np.nan, "not finite"),
        (np.zeros((3, 4)), "singular projection matrix"),
        (np.vstack([BY_HAND[:2], BY_HAND[1]]), "singular projection matrix"),
    ],
)
def test_a_matrix_that_is_no_camera_is_refused(matrix: np.ndarray, text: str) -> None:
    with pytest.raises(CalibrationError, match=text):
        Camera.from_matrix(matrix)


def test_real_calibrations_have_the_angle_and_distance_that_their_source_states() -> None:
    first = json.loads(shared_data("jtml_biplane/cases.json").read_text())["cases"][0]
    a, b = (Camera.from_matrix(np.array(first["views"][name]["projection"])) for name in "AB")
    angle = np.degrees(np.arccos(a.viewing_axis_in_world @ b.viewing_axis_in_world))
    assert abs(angle - 70.3) < 0.1
    assert abs(np.linalg.norm(a.center_in_world_mm - b.center_in_world_mm) - 1516) < 1
