"""Other turns along a thread: found in the CAD, tried, fitted, and judged by what the images say."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import KDTree

from screwpose.geometry import Camera, rigid
from screwpose.implants import Implant, Mesh, ScrewDesign, make_screw
from screwpose.implants.symmetry import surface_sample
from screwpose.registration import alternatives
from screwpose.registration.alternatives import (
    Rival,
    close_ways,
    compared_again,
    other_ways,
    screwed,
    thread_lead_mm,
)
from screwpose.registration.checks import preference
from screwpose.registration.initial import turned
from screwpose.registration.recipe import STAGES, fit_by_thickness, settled
from screwpose.registration.thickness_fit import Body, fit_at_scale, packed, standing
from screwpose.similarity.assessment import path_lengths_of
from screwpose.similarity.thickness import GradientTarget, make_gradient_target
from screwpose.simulation.pathlength import path_length_mm

SIZE = (420, 420)
K = np.array([[2000.0, 0, 209.5], [0, 2000.0, 209.5], [0, 0, 1]])  # 0.3 mm a pixel, at the screw
CAMERAS = [
    Camera.from_matrix(K @ np.array([[0, 1.0, 0, 0], [0, 0, 1, 0], [1, 0, 0, 600]]), SIZE),
    Camera.from_matrix(K @ np.array([[0, 1.0, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 600]]), SIZE),
]
SHORT = ScrewDesign(tower_length_mm=30.0, slot_lengths_mm=(18.0, 10.0), segments=24)


@cache
def screw() -> Implant:
    return make_screw(SHORT)


def truth() -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rigid.exp_rotation(np.array([0.2, 0.5, 0.15]))
    pose[:3, 3] = [3.0, -45.0, -5.0]
    return pose


@cache
def views(scale: int, noise: float = 0.02, seed: int = 3) -> list[GradientTarget]:
    """The screw, drawn by the simulator's path lengths: other code than the solver's."""
    rng = np.random.default_rng(seed)
    made = []
    for camera in CAMERAS:
        corners = rigid.transform(truth(), screw().mesh.vertices_mm)[screw().mesh.faces]
        lengths = np.asarray(path_length_mm(camera, corners, SIZE))
        image = (0.8 * -np.expm1(-0.2 * lengths) + rng.normal(0, noise, SIZE)).astype(np.float32)
        made.append(make_gradient_target(image, np.ones(SIZE, bool), camera, scale))
    return made


def body() -> Body:
    return Body(screw(), screw().mesh, None)


@pytest.mark.parametrize(("pitch_mm", "starts"), [(2.0, 1), (2.75, 1), (2.75, 2)])
def test_a_thread_leads_by_its_pitch(pitch_mm: float, starts: int) -> None:
    made = make_screw(replace(SHORT, pitch_mm=pitch_mm, thread_starts=starts))
    assert thread_lead_mm(made, made.mesh) == pytest.approx(pitch_mm * starts, rel=0.025)


def test_a_left_handed_thread_leads_the_other_way_and_a_tower_not_at_all() -> None:
    mesh = screw().mesh
    mirrored = Mesh(mesh.vertices_mm * [-1.0, 1.0, 1.0], mesh.faces[:, ::-1])
    left = Implant("left", mirrored, screw().tip_mm, screw().center_mm)
    assert thread_lead_mm(left, mirrored) == pytest.approx(-2.75, rel=0.025)
    tower = Implant("tower", mesh, screw().tip_mm + [0.0, 62.0, 0.0], screw().tip_mm + [0.0, 76.0, 0.0])
    assert thread_lead_mm(tower, mesh) == 0.0


@pytest.mark.parametrize("angle_rad", [0.7, -2.0, np.pi])
def test_screwed_on_a_thread_lies_on_itself(angle_rad: float) -> None:
    """By the nearest of many points of the surface; turned without the shift it does not."""
    implant = screw()
    points, others = (surface_sample(implant.mesh, 60_000, np.random.default_rng(seed))[0] for seed in (0, 1))
    tree = KDTree(points)
    shank = others[(others[:, 1] > 10.0) & (others[:, 1] < 38.0)]

    def off_mm(pose: np.ndarray) -> float:
        return float(np.percentile(tree.query(rigid.transform(pose, shank))[0], 90))

    on = screwed(implant, np.eye(4), angle_rad, 2.75)
    assert off_mm(on) < 1.1 * off_mm(np.eye(4))  # as near as the points are to each other
    assert off_mm(turned(implant, np.eye(4), angle_rad)) > 0.25
    assert rigid.transform(on, implant.tip_mm)[1] == pytest.approx(2.75 * angle_rad / (2 * np.pi))


@pytest.mark.parametrize("turn_deg", [-55.0, 40.0, 180.0])
def test_the_recipe_turns_a_screw_back_along_its_thread(turn_deg: float) -> None:
    """Coarse images that showed no roll leave a screw where its thread fits and its head does not."""
    start = [screwed(screw(), truth(), np.radians(turn_deg), 2.75)]
    stages = [(2, replace(STAGES[2], rolls_deg=())), (1, replace(STAGES[3], iterations=3))]
    targets = {scale: views(scale) for scale, _ in stages}
    first = fit_by_thickness([body()], start, targets, stages)
    fit = settled([body()], first, targets, stages)
    assert np.degrees(np.linalg.norm(rigid.log_rotation(fit.world_from_cad[0][:3, :3] @ truth()[:3, :3].T))) < 1.0
    assert np.linalg.norm((fit.world_from_cad[0] - truth()) @ np.append(screw().tip_mm, 1.0)) < 0.1
    # The half-turn is told, and that it was ruled out.
    half_turns = [rival.preference for rival in fit.rivals if abs(rival.turn_deg) > 170.0]
    assert min(half_turns, default=np.inf) > 1.0
    assert half_turns or turn_deg != 180.0
    without = [(scale, replace(stage, other_ways=False)) for scale, stage in stages]
    stuck = settled([body()], first, targets, without)
    assert np.degrees(np.linalg.norm(rigid.log_rotation(stuck.world_from_cad[0][:3, :3] @ truth()[:3, :3].T))) > 5.0
    assert stuck.rivals == ()


def test_sharper_images_decide_what_coarser_ones_left_open() -> None:
    half_turn = screwed(screw(), truth(), np.pi, 2.75)
    wrong = fit_at_scale(views(1), [body()], [half_turn], 3.0, 4, 0.005).world_from_cad
    open_rival, clear_rival = Rival(0, 180.0, -2.75 / 2.0, 0.4), Rival(0, 90.0, 0.1, 5.0)
    best, rivals = compared_again(views(1), [body()], wrong, [open_rival, clear_rival], 3.0, 6, 0.005)
    assert np.degrees(np.linalg.norm(rigid.log_rotation(best[0][:3, :3] @ truth()[:3, :3].T))) < 1.0
    assert np.linalg.norm((best[0] - truth()) @ np.append(screw().tip_mm, 1.0)) < 0.1
    # The one that was left is the rival now, and ruled out; what was ruled out before stays as it was.
    assert abs(rivals[0].turn_deg) > 170.0
    assert rivals[0].preference > 1.0
    assert rivals[1] is clear_rival


@pytest.mark.parametrize("turn_deg", [3.5, -8.0, 16.0])
def test_a_screw_that_stopped_a_few_degrees_along_its_thread_goes_home_on_sharp_images(turn_deg: float) -> None:
    lead_mm = thread_lead_mm(screw(), screw().mesh)
    stopped = screwed(screw(), truth(), np.radians(turn_deg), lead_mm)
    close = close_ways(views(1), [body()], [stopped], [lead_mm])
    assert min(abs(one.turn_deg + turn_deg) for one in close) <= 3.5
    assert [one.shift_mm for one in close] == pytest.approx([lead_mm * one.turn_deg / 360.0 for one in close])
    best, _ = compared_again(views(1), [body()], [stopped], close, 3.0, 10, 0.002)
    off = rigid.log_rotation(best[0][:3, :3] @ truth()[:3, :3].T)
    assert np.degrees(np.linalg.norm(off)) < 1.0
    assert close_ways(views(1), [body()], [truth()], [lead_mm]) == []
    assert close_ways(views(1), [body()], [stopped], [0.0]) == []


def test_the_images_prefer_the_truth_and_say_by_how_much() -> None:
    true, half_turn = [truth()], [screwed(screw(), truth(), np.pi, 2.75)]
    by = preference(views(2), [body()], true, half_turn)
    assert by > 2.0
    assert preference(views(2), [body()], half_turn, true) == pytest.approx(-by)
    assert preference(views(2), [body()], true, true) == 0.0


def test_equally_wrong_poses_differ_by_chance_alone() -> None:
    """A sphere drawn in noise, 1 mm to either side of itself: the preference is about standard normal."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=12.0)
    mesh = Mesh(np.asarray(ball.vertices, float), np.asarray(ball.faces, np.int64))
    one = Body(Implant("ball", mesh, np.array([0.0, -12.0, 0.0]), np.zeros(3)), mesh, None)
    lengths = [np.asarray(path_length_mm(camera, mesh.vertices_mm[mesh.faces], SIZE)) for camera in CAMERAS]
    sides = [np.eye(4), np.eye(4)]
    sides[0][1, 3], sides[1][1, 3] = 1.0, -1.0  # across both views
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        drawn = [
            make_gradient_target(
                (0.8 * -np.expm1(-0.1 * length) + rng.normal(0, 0.3, SIZE)).astype(np.float32),
                np.ones(SIZE, bool),
                camera,
                2,
            )
            for camera, length in zip(CAMERAS, lengths, strict=True)
        ]
        found.append(preference(drawn, [one], [sides[0]], [sides[1]]))
    assert abs(np.mean(found)) < 0.5
    assert 0.6 < np.std(found) < 1.5


def test_the_recipe_finds_the_half_turn_of_a_head_that_is_nearly_the_same() -> None:
    """Half a turn without the thread's shift: no way along the thread passes there."""
    wrong = [turned(screw(), truth(), np.pi)]
    stages = [(2, replace(STAGES[2], rolls_deg=())), (1, replace(STAGES[3], iterations=3))]
    targets = {scale: views(scale) for scale, _ in stages}
    first = fit_by_thickness([body()], wrong, targets, stages)
    assert np.degrees(np.linalg.norm(rigid.log_rotation(first.world_from_cad[0][:3, :3] @ truth()[:3, :3].T))) > 90.0
    with pytest.MonkeyPatch.context() as patch:  # nothing along the thread looks promising
        patch.setattr(alternatives, "other_ways", lambda *_: [])
        fit = settled([body()], first, targets, stages)
    assert np.degrees(np.linalg.norm(rigid.log_rotation(fit.world_from_cad[0][:3, :3] @ truth()[:3, :3].T))) < 1.0
    assert np.linalg.norm((fit.world_from_cad[0] - truth()) @ np.append(screw().tip_mm, 1.0)) < 0.1


def test_what_looks_the_same_is_no_rival() -> None:
    assert Rival(0, 178.0, 0.1, 0.2).is_the_same(2)
    assert Rival(0, -178.0, 0.1, 0.2).is_the_same(0)
    assert not Rival(0, 178.0, 0.1, 0.2).is_the_same(1)
    assert not Rival(0, 178.0, 1.4, 0.2).is_the_same(2)
    assert not Rival(0, 90.0, 0.0, 0.2).is_the_same(2)
    assert Rival(0, 3.0, 0.1, 0.2).is_the_same(1)


def test_only_bodies_that_meet_in_a_view_matter() -> None:
    poses = [truth(), truth(), truth()]
    poses[1][:3, 3] += [0.0, 0.0, 25.0]
    poses[2][:3, 3] += 300.0
    bodies = [body()] * 3
    for index, other in ((0, 1), (1, 0)):
        for target, found in zip(views(2), standing(views(2), bodies, poses, index), strict=True):
            np.testing.assert_array_equal(found, path_lengths_of(target, packed([body()], 2), [poses[other]]))
            assert found.any()
    assert standing(views(2), bodies, poses, 2) == [None, None]


def test_a_body_of_revolution_has_no_other_ways() -> None:
    import trimesh

    tube = trimesh.creation.cylinder(radius=4.0, height=40.0, sections=360)
    mesh = Mesh(np.asarray(tube.vertices, float), np.asarray(tube.faces, np.int64))
    implant = Implant("tube", mesh, np.array([0.0, 0.0, -20.0]), np.zeros(3))
    found = other_ways(views(2), [Body(implant, mesh, None)], [np.eye(4)], 0, 0.0)
    assert found == []
