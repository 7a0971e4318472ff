"""Differential evolution on scenes that the same projection drew: the true pose is known exactly."""

from dataclasses import fields
from typing import get_type_hints

import numpy as np
import pytest

from screwpose.errors import CancelledError
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.pairing.thickness import Quality, refine_by_thickness, settle_by_thickness
from screwpose.projection import opencv
from screwpose.registration import (
    Registered,
    SearchOptions,
    SearchResult,
    drawn_losses,
    moved,
    moved_by_each,
    register,
    search_window,
    search_windows,
)
from screwpose.similarity import Posed, make_target, union_mask

SHAPE = (96, 128)
K = np.array([[400.0, 0, 64], [0, 400.0, 48], [0, 0, 1]])
CAMERAS = {
    "AP": Camera.from_matrix(K @ np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 300]])),
    "LAT": Camera.from_matrix(K @ np.array([[0, 0, -1.0, 0], [0, 1, 0, 0], [1, 0, 0, 300]])),
}
# An L-shaped prism without symmetry: its silhouettes fix all six degrees of freedom.
_L = np.array([[-4.0, -20], [4, -20], [4, 12], [16, 12], [16, 20], [-4, 20]])
_SIDES = [[i, (i + 1) % 6, 6 + (i + 1) % 6] for i in range(6)] + [[i, 6 + (i + 1) % 6, 6 + i] for i in range(6)]
_CAP = [[0, 1, 2], [0, 2, 5], [2, 4, 5], [2, 3, 4]]
MESH = Mesh(
    np.vstack([np.column_stack([_L, np.full(6, z)]) for z in (-3.0, 3.0)]),
    np.array(_SIDES + _CAP + [[a + 6, b + 6, c + 6] for a, b, c in _CAP]),
)
IMPLANT = Implant("L", MESH, np.array([0.0, -20, 0]), np.array([0.0, 0, 0]))


def scene_targets(poses: list[np.ndarray]) -> dict:
    targets = {}
    for name, camera in CAMERAS.items():
        mask = union_mask(camera, [Posed(MESH, pose) for pose in poses], SHAPE, opencv.silhouette)
        targets[name] = make_target(mask.astype(np.float32), np.ones(SHAPE, bool), mask)
    return targets


def found_by(starts: list, targets: dict, options: SearchOptions, progress=None):
    implants, meshes = [IMPLANT] * len(starts), [MESH] * len(starts)
    windows = search_windows(implants, meshes, starts, CAMERAS, targets, options)
    losses = drawn_losses(meshes, CAMERAS, targets, opencv.silhouette, windows)
    return register(implants, starts, losses, options, progress)


TRUTH = rigid.exp(np.array([0.1, 0.5, 0.2, 1.0, 2.0, -3.0]))
START = moved(IMPLANT, TRUTH, np.array([0.12, -0.05, 0.04, 1.5, -1.2, 1.8]))
OPTIONS = SearchOptions(max_shift_mm=3.0, generations=40, population=6, seed=3)


def test_moved_turns_about_the_centre_by_hand() -> None:
    pose = moved(IMPLANT, np.eye(4), np.array([np.pi / 2, 0, 0, 0, 0, 7.0]))  # a quarter turn about V = +y, then 7 up z
    np.testing.assert_allclose(rigid.transform(pose, IMPLANT.center_mm), [0, 0, 7], atol=1e-12)
    np.testing.assert_allclose(rigid.transform(pose, np.array([1.0, 5, 0])), [0, 5, 6], atol=1e-12)


def test_many_changes_at_once_are_those_one_by_one() -> None:
    changes = np.random.default_rng(1).normal(size=(5, 6))
    turn = [rigid.exp_rotation(change[:3]) for change in changes]
    np.testing.assert_allclose(rigid.exp_rotations(changes[:, :3]), turn, atol=1e-14)
    np.testing.assert_allclose(
        rigid.exp_rotations(1e-9 * changes[:, :3]),
        [rigid.exp_rotation(1e-9 * change[:3]) for change in changes],
        atol=1e-18,
    )
    many = moved_by_each(IMPLANT, TRUTH, changes)
    np.testing.assert_allclose(many, [moved(IMPLANT, TRUTH, change) for change in changes], atol=1e-12)


def test_it_finds_the_pose_that_drew_the_masks() -> None:
    targets = scene_targets([TRUTH])
    told: list[float] = []
    found = found_by([START], targets, OPTIONS, lambda f, _: told.append(f))
    offset = rigid.log(rigid.invert(TRUTH) @ found.world_from_cad[0])
    start_offset = rigid.log(rigid.invert(TRUTH) @ START)
    # A pixel is 0.75 mm here; the masks hold the pose to a fraction of it.
    assert np.linalg.norm(offset[3:]) < 0.5 < np.linalg.norm(start_offset[3:])
    assert np.degrees(np.linalg.norm(offset[:3])) < 2.0 < np.degrees(np.linalg.norm(start_offset[:3]))
    assert found.loss < -0.9
    assert found.at_bound == (False,)
    assert told[-1] <= 1.0
    assert told == sorted(told)
    assert len(told) > 5


def test_the_same_seed_gives_the_same_answer_and_another_seed_another() -> None:
    targets = scene_targets([TRUTH])
    few = [SearchOptions(generations=3, population=3, seed=seed) for seed in (1, 1, 2)]
    poses = [found_by([START], targets, options).world_from_cad[0] for options in few]
    np.testing.assert_array_equal(poses[0], poses[1])
    assert np.abs(poses[0] - poses[2]).max() > 1e-6


def test_the_end_is_never_worse_than_the_start() -> None:
    targets = scene_targets([TRUTH])
    none = SearchOptions(generations=1, population=2, max_shift_mm=30.0, max_tilt_deg=40.0)
    found = found_by([TRUTH], targets, none)
    np.testing.assert_allclose(found.loss, -1.0)
    np.testing.assert_allclose(found.world_from_cad[0], TRUTH)


def test_a_start_too_far_off_ends_at_a_bound_and_says_so() -> None:
    targets = scene_targets([TRUTH])
    off = TRUTH.copy()
    off[0, 3] += 8.0
    tight = SearchOptions(generations=30, population=6, max_shift_mm=4.0, max_tilt_deg=1.0, max_roll_deg=1.0)
    found = found_by([off], targets, tight)
    assert found.at_bound == (True,)


def test_only_a_search_by_loss_has_a_loss() -> None:
    assert [field.name for field in fields(Registered)] == ["world_from_cad", "at_bound"]
    assert issubclass(SearchResult, Registered)
    for fit in (refine_by_thickness, settle_by_thickness):  # it used to be minus the mean of the explained energy
        assert get_type_hints(fit)["return"] == tuple[Registered, Quality]


def test_two_screws_are_registered_together() -> None:
    second = TRUTH.copy()
    second[:3, 3] += [22.0, -9.0, 14.0]
    starts = [START, moved(IMPLANT, second, np.array([-0.08, 0.05, 0.03, -1.0, 1.1, 0.6]))]
    found = found_by(starts, scene_targets([TRUTH, second]), OPTIONS)
    for pose, truth in zip(found.world_from_cad, (TRUTH, second), strict=True):
        assert np.linalg.norm(rigid.log(rigid.invert(truth) @ pose)[3:]) < 1.0
    assert found.loss < -0.8


def test_cancelling_stops_it() -> None:
    def stop(fraction: float, what: str) -> None:
        raise CancelledError("stopped by the user")

    with pytest.raises(CancelledError, match="stopped by the user"):
        found_by([START], scene_targets([TRUTH]), OPTIONS, stop)


def test_no_change_within_the_bounds_leaves_the_window() -> None:
    rng = np.random.default_rng(9)
    options = SearchOptions(max_shift_mm=4.0, max_tilt_deg=12.0, max_roll_deg=30.0)
    limits = np.r_[np.radians([30.0, 12, 12]), 4, 4, 4]
    for camera in CAMERAS.values():
        window = search_window(camera, [Posed(MESH, START)], [IMPLANT.center_mm], SHAPE, options)
        for _ in range(40):
            change = rng.choice([-1, 1, 0.3], 6) * limits
            scene = [Posed(MESH, moved(IMPLANT, START, change))]
            whole = union_mask(camera, scene, SHAPE, opencv.silhouette)
            inside = union_mask(camera, scene, SHAPE, opencv.silhouette, window)
            assert whole.sum() == inside.sum() > 0
