"""Rigid motions against SciPy's matrix exponential and values worked by hand."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from screwpose.geometry import rigid

AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
ANGLES_RAD = [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 9.99e-3, 1.01e-2, 1.0, 3.0, np.pi - 0.011, np.pi - 0.009, np.pi - 1e-6]


@pytest.mark.parametrize("angle_rad", [*ANGLES_RAD, np.pi, 4.0])
def test_exp_matches_expm(angle_rad: float) -> None:
    twist = np.r_[angle_rad * AXIS, 100.0, -20.0, 5.0]
    np.testing.assert_allclose(rigid.exp(twist), expm(rigid.hat(twist)), rtol=0, atol=1e-11)


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
def test_log_finds_the_twist_that_expm_was_given(angle_rad: float) -> None:
    twist = np.r_[angle_rad * AXIS, 100.0, -20.0, 5.0]
    np.testing.assert_allclose(rigid.log(expm(rigid.hat(twist))), twist, rtol=0, atol=1e-8)


@pytest.mark.parametrize("axis", [*np.eye(3), AXIS, np.array([0.6, 0.8, 0.0])])
def test_log_at_exactly_pi(axis: np.ndarray) -> None:
    rotation = 2 * np.outer(axis, axis) - np.eye(3)  # the closed form at pi
    vector = rigid.log_rotation(rotation)
    np.testing.assert_allclose(np.linalg.norm(vector), np.pi, atol=1e-12)
    np.testing.assert_allclose(np.abs(vector @ axis), np.pi, atol=1e-12)


def test_rotations_match_scipy() -> None:
    rng = np.random.default_rng(1)
    for vector in rng.normal(size=(50, 3)) * rng.uniform(0, 1.8, (50, 1)):
        np.testing.assert_allclose(rigid.exp_rotation(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-12)
        want = Rotation.from_rotvec(vector).as_rotvec()
        np.testing.assert_allclose(rigid.log_rotation(rigid.exp_rotation(vector)), want, atol=1e-9)


def test_a_quarter_turn_about_z_by_hand() -> None:
    motion = rigid.exp(np.array([0, 0, np.pi / 2, 0, 0, 7.0]))  # a screw motion along its own axis
    np.testing.assert_allclose(rigid.transform(motion, np.array([1.0, 0, 0])), [0, 1, 7], atol=1e-12)
    turned = rigid.rotation_about_line(np.array([1.0, 0, 0]), np.array([0, 0, 5.0]), np.pi / 2)
    np.testing.assert_allclose(rigid.transform(turned, np.array([[2.0, 0, 3.0], [1, 0, 9]])), [[1, 1, 3], [1, 0, 9]])


def test_invert_and_compose() -> None:
    b_from_a = rigid.exp(np.array([0.3, -0.2, 0.9, 10.0, 20.0, -30.0]))
    np.testing.assert_allclose(rigid.invert(b_from_a), np.linalg.inv(b_from_a), atol=1e-12)
    c_from_b = rigid.exp(np.array([0.1, 0.2, 0.0, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(rigid.compose(c_from_b, b_from_a), c_from_b @ b_from_a)


@pytest.mark.parametrize("target", [AXIS, -AXIS, np.array([0, 0, 1.0]), AXIS + [1e-9, 0, 0]])
def test_rotation_between_is_the_smallest_that_turns_one_into_the_other(target: np.ndarray) -> None:
    rotation = rigid.rotation_between(AXIS, target)
    np.testing.assert_allclose(rotation @ AXIS, target / np.linalg.norm(target), atol=1e-9)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    angle = np.linalg.norm(Rotation.from_matrix(rotation).as_rotvec())
    np.testing.assert_allclose(angle, np.arccos(np.clip(AXIS @ target / np.linalg.norm(target), -1, 1)), atol=1e-6)


def test_angle_between_keeps_small_angles() -> None:
    tiny = np.array([1.0, 1e-9, 0.0])
    np.testing.assert_allclose(rigid.angle_between_rad(np.array([1.0, 0, 0]), tiny), 1e-9, rtol=1e-6)
