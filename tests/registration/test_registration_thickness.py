"""The fine registration on images made by ray casting of its own: poses come back to hundredths of a mm."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.errors import CancelledError
from screwpose.geometry import Camera, rigid
from screwpose.registration.landmark_prior import MarkedScrew, mark_residuals
from screwpose.registration.recipe import STAGES, fit_by_thickness, once_more, scaled_stages
from screwpose.registration.thickness_fit import (
    Body,
    changed,
    energies_of_candidates,
    energies_of_each,
    energies_of_views,
    fit_at_scale,
    linearised,
)
from screwpose.similarity.thickness import make_gradient_target
from screwpose.simulation.pathlength import path_length_mm
from tests.registration.drawn_scene import SCREW, pose_at

SIZE = (400, 400)
K = np.array([[1300.0, 0, 199.5], [0, 1300.0, 199.5], [0, 0, 1]])
CAMERAS = {
    "AP": Camera.from_matrix(K @ np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 600]]), SIZE),
    "LAT": Camera.from_matrix(K @ np.array([[0, 0, -1.0, 0], [0, 1, 0, 0], [1, 0, 0, 600]]), SIZE),
}
TRUTH = [pose_at([0.25, 0.3, 0.15], [-25.0, -45.0, -10.0]), pose_at([-0.2, 1.1, -0.2], [20.0, -40.0, 15.0])]


@pytest.fixture(scope="module")
def targets() -> dict:
    """Views of both screws, drawn by the simulator's path lengths: other code than the solver's."""
    rng = np.random.default_rng(4)
    made = {}
    images = {}
    for name, camera in CAMERAS.items():
        lengths = sum(
            path_length_mm(camera, rigid.transform(pose, SCREW.mesh.vertices_mm)[SCREW.mesh.faces], SIZE)
            for pose in TRUTH
        )
        images[name] = (0.8 * -np.expm1(-0.22 * np.asarray(lengths)) + rng.normal(0, 0.01, SIZE)).astype(np.float32)
    for scale in (1, 2, 3):
        made[scale] = [
            make_gradient_target(images[name], np.ones(SIZE, bool), camera, scale) for name, camera in CAMERAS.items()
        ]
    return made


def bodies(noise_px: float = 0.0, seed: int = 0) -> list[Body]:
    rng = np.random.default_rng(seed)
    cameras = list(CAMERAS.values())
    made = []
    for pose in TRUTH:
        marks = [
            camera.project(rigid.transform(pose, np.stack([SCREW.tip_mm, SCREW.center_mm])))
            + rng.normal(0, 1, (2, 2)) * noise_px
            for camera in cameras
        ]
        marked = MarkedScrew(cameras, np.stack([m[0] for m in marks]), np.stack([m[1] for m in marks]))
        made.append(Body(SCREW, SCREW.mesh, marked))
    return made


def off(poses: tuple[np.ndarray, ...]) -> tuple[float, float]:
    """The largest error of the tips, mm, and of the rotations, degrees."""
    tips = [np.linalg.norm((p - t) @ np.append(SCREW.tip_mm, 1.0)) for p, t in zip(poses, TRUTH, strict=True)]
    turns = [np.linalg.norm(rigid.log_rotation(p[:3, :3] @ t[:3, :3].T)) for p, t in zip(poses, TRUTH, strict=True)]
    return float(max(tips)), float(np.degrees(max(turns)))


def test_marks_and_their_derivatives() -> None:
    body = bodies(2.0, 3)[0]
    assert body.marks is not None
    residuals, slopes = mark_residuals(SCREW, TRUTH[0], body.marks, 2.0)
    assert residuals.shape == (8,)
    tip_in_ap = CAMERAS["AP"].project(rigid.transform(TRUTH[0], SCREW.tip_mm))
    np.testing.assert_allclose(residuals[:2], (body.marks.tips_px[0] - tip_in_ap) / 2.0)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-5
        ahead, back = (
            mark_residuals(SCREW, changed(body, TRUTH[0], s * step), body.marks, 2.0)[0] for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(slopes[:, k], (back - ahead) / 2e-5, rtol=1e-4, atol=1e-4)


def test_at_the_truth_the_gradient_is_small_and_a_step_towards_it_is_right(targets: dict) -> None:
    both = bodies()
    moved = [changed(body, pose, np.array([0, 0, 0, 0.15, -0.1, 0.1])) for body, pose in zip(both, TRUTH, strict=True)]
    at_truth, aside = (linearised(targets[1], both, poses, 3.0) for poses in (TRUTH, moved))
    assert np.mean(at_truth.energies) > np.mean(aside.energies)
    step = np.linalg.solve(aside.information, aside.gradient).reshape(2, 6)
    share = step[:, 3:] / [-0.15, 0.1, -0.1]
    assert (share > 0.4).all()
    assert (share < 1.2).all()
    assert np.linalg.norm(np.linalg.solve(at_truth.information, at_truth.gradient).reshape(2, 6)[:, 3:]) < 0.05


def test_it_comes_back_from_a_mm_and_a_degree(targets: dict) -> None:
    both = bodies(1.0)
    start = [
        changed(body, pose, np.array([0.02, -0.01, 0.015, 0.6, -0.4, 0.5]))
        for body, pose in zip(both, TRUTH, strict=True)
    ]
    fit = fit_at_scale(targets[2], both, start, 3.0, 12, 0.005)
    fit = fit_at_scale(targets[1], both, fit.world_from_cad, 3.0, 8, 0.002)
    tip_mm, turn_deg = off(fit.world_from_cad)
    assert tip_mm < 0.06  # a pixel is 0.46 mm here
    assert turn_deg < 0.5
    assert np.mean(energies_of_views(targets[1], both, fit.world_from_cad)) > 0.9


def test_the_recipe_finds_roll_and_direction_by_itself(targets: dict) -> None:
    both = bodies(1.0, 7)
    start = [
        changed(body, pose, np.concatenate([turn * (pose[:3, :3] @ SCREW.axis), [0.5, 0.3, -0.4]]))
        for body, pose, turn in zip(both, TRUTH, (2.0, -1.2), strict=True)
    ]
    stages = scaled_stages(0.46)
    assert [scale for scale, _ in stages] == [3, 2, 1]
    assert stages[-1][1] == replace(STAGES[3], rolls_deg=STAGES[2].rolls_deg, other_ways=True)
    told: list[float] = []
    fit = fit_by_thickness(both, start, targets, stages, lambda fraction, _: told.append(fraction))
    tip_mm, turn_deg = off(fit.world_from_cad)
    assert tip_mm < 0.06
    assert turn_deg < 0.5
    assert told == [0.0, 1 / 3, 2 / 3]
    again = fit_by_thickness(both, start, targets, stages)
    np.testing.assert_array_equal(again.world_from_cad, fit.world_from_cad)


def test_fine_x_rays_are_reduced_more() -> None:
    assert [scale for scale, _ in scaled_stages(0.2)] == [8, 4, 2, 1]
    assert [scale for scale, _ in scaled_stages(0.066)] == [24, 12, 6, 3]
    assert [scale for scale, _ in scaled_stages(1.7)] == [1]


def test_energy_falls_where_a_screw_is_wrong(targets: dict) -> None:
    both = bodies()
    half_turn = [TRUTH[0], changed(both[1], TRUTH[1], np.append(np.pi * (TRUTH[1][:3, :3] @ SCREW.axis), np.zeros(3)))]
    right, wrong = energies_of_candidates(targets[2], both, TRUTH, 1, [TRUTH[1], half_turn[1]])
    assert right > wrong + 0.01


def test_cancelling_stops_it(targets: dict) -> None:
    def stop(_fraction: float, _what: str) -> None:
        raise CancelledError("stopped by the user")

    with pytest.raises(CancelledError, match="stopped"):
        fit_by_thickness(bodies(), TRUTH, targets, scaled_stages(0.46), stop)


def test_the_screw_that_is_wrong_has_the_low_energy(targets: dict) -> None:
    both = bodies()
    right = energies_of_each(targets[1], both, TRUTH)
    assert right.shape == (2, 2)
    assert right.min() > 0.8
    aside = [TRUTH[0], changed(both[1], TRUTH[1], np.array([0.0, 0.0, 0.0, 3.0, 3.0, 3.0]))]
    wrong = energies_of_each(targets[1], both, aside)
    assert wrong[1].max() < 0.0
    assert wrong[0].min() > wrong[1].max() + 0.5


def test_what_explains_little_goes_through_all_scales_once_more(targets: dict) -> None:
    both = bodies(1.0)
    stages = scaled_stages(0.46)
    aside = [TRUTH[0], changed(both[1], TRUTH[1], np.array([0.03, -0.03, 0.0, 1.5, -1.5, 1.0]))]
    assert energies_of_each(targets[1], both, aside).min() < 0.5
    assert off(tuple(aside))[0] > 2.0
    tip_mm, turn_deg = off(tuple(once_more(both, aside, targets, stages)))
    assert tip_mm < 0.06
    assert turn_deg < 0.5
    # What explains enough is at rest.
    for found, pose in zip(once_more(both, TRUTH, targets, stages), TRUTH, strict=True):
        assert found is pose
