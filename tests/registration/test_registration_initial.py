"""Laying a model on its landmarks, and turning it about its axis, against values worked by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.registration import align, axial_search, turned

# A flag on a pole: the pole is the axis +y, the flag points along +x.
FLAG = Mesh(np.array([[0.0, 0, 0], [0, 20, 0], [0, 40, 0], [5, 40, 0]]), np.array([[0, 1, 3], [1, 2, 3]]))
IMPLANT = Implant("flag", FLAG, np.zeros(3), np.array([0.0, 20, 0]))


def test_tip_and_centre_land_on_the_triangulated_ones() -> None:
    tip, center = np.array([10.0, -5, 30]), np.array([10.0, -5, 50])
    world_from_cad = align(IMPLANT, tip, center)
    np.testing.assert_allclose(rigid.transform(world_from_cad, IMPLANT.tip_mm), tip, atol=1e-12)
    np.testing.assert_allclose(rigid.transform(world_from_cad, IMPLANT.center_mm), center, atol=1e-12)
    # +y turned to +z by the smallest rotation, about +x: the flag stays along +x.
    np.testing.assert_allclose(world_from_cad[:3, :3] @ [1, 0, 0], [1, 0, 0], atol=1e-12)


def test_a_length_that_does_not_agree_is_shared_between_both_ends() -> None:
    world_from_cad = align(IMPLANT, np.array([0.0, 0, 0]), np.array([0.0, 23, 0]))
    np.testing.assert_allclose(rigid.transform(world_from_cad, IMPLANT.tip_mm), [0, 1.5, 0], atol=1e-12)
    np.testing.assert_allclose(rigid.transform(world_from_cad, IMPLANT.center_mm), [0, 21.5, 0], atol=1e-12)


def test_upside_down() -> None:
    world_from_cad = align(IMPLANT, np.array([0.0, 20, 0]), np.zeros(3))
    np.testing.assert_allclose(rigid.transform(world_from_cad, IMPLANT.tip_mm), [0, 20, 0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(world_from_cad[:3, :3]), 1.0)


def test_turned_is_right_handed_about_v_and_keeps_the_landmarks() -> None:
    start = align(IMPLANT, np.array([1.0, 2, 3]), np.array([15.0, 2, 3]))
    pose = turned(IMPLANT, start, np.radians(25.0))
    for landmark in (IMPLANT.tip_mm, IMPLANT.center_mm):
        np.testing.assert_allclose(rigid.transform(pose, landmark), rigid.transform(start, landmark), atol=1e-12)
    relative = pose[:3, :3] @ start[:3, :3].T
    want = Rotation.from_rotvec(np.radians(25.0) * np.array([1.0, 0, 0])).as_matrix()  # V is the world's +x
    np.testing.assert_allclose(relative, want, atol=1e-12)


@pytest.mark.parametrize("true_roll_deg", [0.0, 3.0, -57.0, 124.0, 179.0, -171.0])
def test_the_axial_search_finds_the_flag(true_roll_deg: float) -> None:
    start = align(IMPLANT, np.array([4.0, 5, 6]), np.array([4.0, 25, 6]))
    want = rigid.transform(turned(IMPLANT, start, np.radians(true_roll_deg)), FLAG.vertices_mm)

    def loss(pose: np.ndarray) -> float:
        return float(np.sum((rigid.transform(pose, FLAG.vertices_mm) - want) ** 2))

    found = axial_search(IMPLANT, start, lambda poses: np.array([loss(pose) for pose in poses]))
    off_deg = (np.degrees(found.roll_rad) - true_roll_deg + 180) % 360 - 180
    assert abs(off_deg) <= 1.0 + 1e-9
    np.testing.assert_allclose(loss(found.world_from_cad), found.loss)


def test_a_body_of_revolution_keeps_its_start() -> None:
    start = align(IMPLANT, np.array([4.0, 5, 6]), np.array([4.0, 25, 6]))
    assert axial_search(IMPLANT, start, lambda poses: np.full(len(poses), 0.5)).roll_rad == 0.0
