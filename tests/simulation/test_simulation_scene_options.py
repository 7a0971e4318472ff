"""Scenes are what their options say: measured from poses, cameras and marks, without rendering."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.errors import InputError, ScrewposeError
from screwpose.geometry.epipolar import epipolar_distances_px
from screwpose.implants.mesh import transformed
from screwpose.simulation import Imperfections, SceneOptions, ScenePlan, plan_scene
from screwpose.simulation.arrangement_gaps import Capsules, capsules_around, least_gap_mm
from screwpose.simulation.arrangement_overlap import silhouette
from screwpose.simulation.solids import solid

EXACT = Imperfections(landmark_noise_px=0.0)
MANY = SceneOptions(
    screws=(6, 6),
    levels=(3, 4),
    lengths_mm=(30.0, 60.0),
    diameters_mm=(4.5, 8.5),
    designs=(3, 3),
    polyaxial=0.5,
    tower_tilt_deg=(3.0, 20.0),
    overlap_lat=(0.0, 1.0),
)


@pytest.fixture(scope="module")
def many() -> list[ScenePlan]:
    return [plan_scene(MANY, EXACT, seed) for seed in (1, 2)]


def axis_of(pose: np.ndarray) -> np.ndarray:
    """CAD +y in the world: the direction from tip to head of every screw that is made to measure."""
    return pose[:3, 1]


def view_angle_deg(plan: ScenePlan) -> float:
    ap, lat = (plan.true_cameras[view].projection[2, :3] for view in ("AP", "LAT"))
    return float(np.degrees(np.arccos(ap @ lat)))


def test_counts_levels_sides_and_designs(many: list[ScenePlan]) -> None:
    for plan in many:
        sites = [(screw.level, screw.side) for screw in plan.screws]
        assert len(sites) == len(set(sites)) == 6
        levels = {level for level, _ in sites}
        assert len(levels) in (3, 4)
        assert max(levels) - min(levels) == len(levels) - 1
        assert len(plan.implants) == 3
        for screw in plan.screws:
            length = 2.0 * screw.implant.center_mm[1]
            assert 30.0 <= length <= 60.0
            assert length % 5.0 == 0.0
            shank = screw.implant.mesh.vertices_mm[screw.implant.mesh.vertices_mm[:, 1] < 0.5 * length]
            assert 4.4 < 2.0 * np.hypot(shank[:, 0], shank[:, 2]).max() <= 8.5 + 1e-9


def test_screws_pass_their_pedicles_and_converge(many: list[ScenePlan]) -> None:
    for plan in many:
        assert plan.patient is not None
        for screw in plan.screws:
            level = plan.patient.levels[screw.level]
            in_level = np.linalg.inv(level.world_from_level) @ screw.world_from_cad
            pedicle = level.pedicles_mm[screw.side]
            assert np.sign(pedicle[0]) == (1.0 if screw.side == 0 else -1.0)  # LPS: left is +x
            tip, axis = in_level[:3, 3], axis_of(in_level)
            off = pedicle - tip
            assert np.linalg.norm(off - (off @ axis) * axis) < 4.0
            assert abs(off @ axis - screw.implant.center_mm[1]) < 4.0
            convergence = np.degrees(np.arctan2(axis[0], axis[1])) * np.sign(pedicle[0])
            assert convergence == pytest.approx(screw.convergence_deg, abs=1e-6)
            assert convergence <= 30.0
            # No screw crosses the middle of its vertebra.
            assert tip[0] * np.sign(pedicle[0]) > 5.0


def test_metal_keeps_a_millimetre_apart(many: list[ScenePlan]) -> None:
    for plan in many:
        bodies = [[solid(transformed(mesh, pose)) for mesh, pose in screw.pieces] for screw in plan.screws]
        gaps = [
            first.min_gap(second, 4.0)
            for i, one in enumerate(bodies)
            for other in bodies[:i]
            for first in one
            for second in other
        ]
        assert min(gaps) >= 1.0
        assert len(gaps) >= 15


def test_capsules_hold_a_screw_and_their_gap_is_right_by_hand() -> None:
    implant = plan_scene(SceneOptions(), EXACT, 1).screws[0].implant
    found = capsules_around(implant.mesh, implant.tip_mm, implant.axis)
    samples = implant.mesh.triangles_mm.mean(axis=1)
    for points in (implant.mesh.vertices_mm, samples):
        along = np.clip(points[:, 1, None], found.starts_mm[:, 1], found.ends_mm[:, 1])
        away = np.sqrt(points[:, 0, None] ** 2 + points[:, 2, None] ** 2 + (points[:, 1, None] - along) ** 2)
        assert (away - found.radii_mm).min(axis=1).max() < 1e-9
    assert len(found.radii_mm) > 2
    one = Capsules(np.array([[0.0, 0, 0]]), np.array([[10.0, 0, 0]]), np.array([1.0]))
    crossing = Capsules(np.array([[5.0, -3, 4]]), np.array([[5.0, 3, 4]]), np.array([0.5]))
    beyond = Capsules(np.array([[13.0, 4, 0]]), np.array([[13.0, 9, 0]]), np.array([2.0]))
    alongside = Capsules(np.array([[2.0, 0, 7]]), np.array([[8.0, 0, 7]]), np.array([1.0]))
    assert least_gap_mm(one, crossing) == pytest.approx(4.0 - 1.5)
    assert least_gap_mm(one, beyond) == pytest.approx(5.0 - 3.0)
    assert least_gap_mm(one, alongside) == pytest.approx(7.0 - 2.0)


def test_towers_lean_about_the_pivot_by_what_is_said(many: list[ScenePlan]) -> None:
    leaning = [screw for plan in many for screw in plan.screws if screw.implant.pivot_mm is not None]
    upright = [screw for plan in many for screw in plan.screws if screw.implant.pivot_mm is None]
    assert len(leaning) >= 2
    assert upright
    for screw in leaning:
        shank, tower = (screw.part_poses[part.name] for part in screw.implant.parts)
        np.testing.assert_array_equal(shank, screw.world_from_cad)
        angle = np.degrees(np.arccos(axis_of(shank) @ axis_of(tower)))
        assert 3.0 <= angle <= 20.0
        assert angle == pytest.approx(screw.tower_tilt_deg, abs=1e-6)
        pivot = np.append(screw.implant.pivot_mm, 1.0)
        np.testing.assert_allclose(shank @ pivot, tower @ pivot, atol=1e-9)
        # The CAD that is given stands upright.
        top = screw.implant.mesh.vertices_mm[screw.implant.mesh.vertices_mm[:, 1] > 60.0]
        assert np.abs(top[:, [0, 2]].mean(axis=0)).max() < 1.5
    assert all(screw.part_poses == {} and len(screw.pieces) == 1 for screw in upright)


@pytest.mark.parametrize("angle", [60.0, 93.5, 120.0])
def test_views_are_as_far_apart_as_asked(angle: float) -> None:
    plan = plan_scene(SceneOptions(angle_deg=(angle, angle), overlap_lat=(0.0, 1.0)), EXACT, 5)
    assert view_angle_deg(plan) == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize("bounds", [(0.0, 0.02), (0.3, 0.5), (0.95, 1.0)])
def test_overlap_in_lat_is_as_asked(bounds: tuple[float, float]) -> None:
    plan = plan_scene(SceneOptions(overlap_lat=bounds), EXACT, 3)
    masks = [silhouette(plan.true_cameras["LAT"], screw) for screw in plan.screws]
    shared = (masks[0] & masks[1]).sum() / min(mask.sum() for mask in masks)
    assert bounds[0] <= shared <= bounds[1]
    assert plan.overlap["LAT"] == pytest.approx(shared)


def test_marks_are_missing_outside_the_field_and_where_others_hide_them() -> None:
    options = replace(MANY, missing=(2, 2), shift_mm=(0.0, 90.0), levels=(4, 4), polyaxial=0.0, tower_tilt_deg=(0, 0))
    reasons = set()
    for seed in range(4):
        plan = plan_scene(options, EXACT, seed)
        assert len(plan.missing) == len({mark.screw for mark in plan.missing}) == 2
        for mark in plan.missing:
            reasons.add(mark.why)
            assert mark.view not in plan.labels[mark.screw]
            assert len(plan.labels[mark.screw]) == 1
            points = plan.true_cameras[mark.view].project(plan.screws[mark.screw].landmarks_in_world_mm)
            if mark.why == "outside the field":
                assert ((points < 20.0) | (points > 1003.0) | (np.hypot(*(points - 511.5).T) > 485.0)[:, None]).any()
            else:
                assert plan.covered[mark.view][mark.screw] >= 0.3
        for view, marks in plan.annotations.items():
            assert len(marks) == 6 - sum(mark.view == view for mark in plan.missing)
            names = {labels[view] for labels in plan.labels if view in labels}
            assert names == {mark.label for mark in marks}
    assert reasons == {"outside the field", "hidden by others"}


def test_models_are_named_where_asked(many: list[ScenePlan]) -> None:
    plan = plan_scene(replace(MANY, models_named="AP"), EXACT, 1)
    assert {mark.model for mark in plan.annotations["AP"]} == set(plan.implants)
    assert {mark.model for mark in plan.annotations["LAT"]} == {None}
    assert all(mark.model in many[0].implants for mark in many[0].annotations["LAT"])
    for labels, model in zip(plan.labels, plan.models, strict=True):
        assert next(mark for mark in plan.annotations["AP"] if mark.label == labels["AP"]).model == model.name


def test_labels_can_be_swapped_for_less_than_the_bound() -> None:
    options = SceneOptions(max_epipolar_gap_px=1.0, levels=(1, 1))
    for seed in range(3):
        plan = plan_scene(options, Imperfections(), seed)
        marks = {
            view: {mark.label: np.stack([mark.tip_px, mark.center_px]) for mark in plan.annotations[view]}
            for view in ("AP", "LAT")
        }
        first, second = plan.labels
        ap, lat = plan.cameras["AP"], plan.cameras["LAT"]

        def mean_px(pairs: list[tuple[str, str]], marks=marks, ap=ap, lat=lat) -> float:
            return float(
                np.mean(
                    [
                        np.diag(epipolar_distances_px(ap, lat, marks["AP"][one], marks["LAT"][other]))
                        for one, other in pairs
                    ]
                )
            )

        true = mean_px([(first["AP"], first["LAT"]), (second["AP"], second["LAT"])])
        swapped = mean_px([(first["AP"], second["LAT"]), (second["AP"], first["LAT"])])
        assert abs(swapped - true) < 1.0
        assert plan.epipolar_margin_px == pytest.approx(swapped - true)


def test_sixteen_screws_over_eight_levels_and_one_alone() -> None:
    plan = plan_scene(SceneOptions(screws=(16, 16), levels=(8, 8), overlap_lat=(0.0, 1.0)), EXACT, 4)
    assert len(plan.screws) == 16
    assert [len(marks) for marks in plan.annotations.values()] == [16, 16]
    alone = plan_scene(SceneOptions(screws=(1, 1), overlap_lat=(0.0, 1.0)), EXACT, 4)
    assert len(alone.screws) == 1
    assert alone.epipolar_margin_px is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"screws": (0, 2)}, r"screws: 0 to 2 is no range for this; expected from 1 to 16, the least first"),
        ({"angle_deg": (100.0, 90.0)}, r"angle_deg: 100 to 90 is no range for this"),
        ({"screws": (12, 12)}, r"levels: 12 screws over 1 to 2 levels; expected one or two screws on each level"),
        ({"tower_tilt_deg": (5.0, 5.0)}, r"tower_tilt_deg: towers that lean by 5 degrees on monoaxial screws"),
        ({"missing": (2, 2)}, r"missing: 2 marks missing of 2 screws; expected at most 1, so that two pairs are left"),
        ({"screws": (3, 3), "levels": (2, 2), "max_epipolar_gap_px": 2.0}, r"epipolar gap for 3 screws; expected two"),
    ],
)
def test_options_that_contradict_are_refused(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        SceneOptions(**options)


def test_what_cannot_be_found_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("screwpose.simulation.arrangement._ATTEMPTS", 12)
    # Two levels are never so alike that labels could be swapped.
    options = SceneOptions(levels=(2, 2), max_epipolar_gap_px=0.01, image_size=(256, 256))
    with pytest.raises(ScrewposeError, match=r"no arrangement of 2 screws was found in 12 attempts: .*swapped labels"):
        plan_scene(options, EXACT, 0)
