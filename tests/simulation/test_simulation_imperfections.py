"""Dials do what they say, exactly, and nothing else: measured from matrices and marks, without rendering."""

from dataclasses import fields, replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from screwpose.errors import InputError, ScrewposeError
from screwpose.simulation import Imperfections, SceneOptions, ScenePlan, plan_scene

SEED = 3
EXACT = Imperfections(landmark_noise_px=0.0)


def planned(**dials: float) -> ScenePlan:
    return plan_scene(SceneOptions(), replace(EXACT, **dials), SEED)


@pytest.fixture(scope="module")
def exact() -> ScenePlan:
    return planned()


def decomposed(projection: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K, R and the source by OpenCV."""
    K, R, source, *_ = cv2.decomposeProjectionMatrix(projection)
    return K / K[2, 2], R, (source[:3] / source[3]).ravel()


def marks_px(plan: ScenePlan, view: str) -> np.ndarray:
    """(screws, tip and centre, 2) in the order of the truth."""
    by_label = {mark.label: np.stack([mark.tip_px, mark.center_px]) for mark in plan.annotations[view]}
    return np.stack([by_label[labels[view]] for labels in plan.labels])


def assert_same_scene(one: ScenePlan, other: ScenePlan) -> None:
    for a, b in zip(one.screws, other.screws, strict=True):
        np.testing.assert_array_equal(a.world_from_cad, b.world_from_cad)
        np.testing.assert_array_equal(a.implant.mesh.vertices_mm, b.implant.mesh.vertices_mm)
    assert [dict(labels) for labels in one.labels] == [dict(labels) for labels in other.labels]
    assert replace(one.detector, pincushion=0.0, s_distortion_rad=0.0) == replace(
        other.detector, pincushion=0.0, s_distortion_rad=0.0
    )


DIALS = {
    "landmark_noise_px": 2.0,
    "tip_bias_mm": 1.0,
    "center_bias_mm": -1.0,
    "focal_error_percent": 1.0,
    "principal_error_px": 5.0,
    "rotation_error_deg": 1.0,
    "translation_error_mm": 3.0,
    "pincushion": 0.02,
    "s_distortion_deg": 1.0,
    "cad_length_mm": 5.0,
    "cad_diameter_mm": 1.0,
    "motion_deg": 1.0,
    "motion_mm": 3.0,
}


def test_every_dial_is_tried() -> None:
    assert set(DIALS) == {field.name for field in fields(Imperfections)}


@pytest.mark.parametrize("dial", DIALS)
def test_a_dial_leaves_the_rest_of_the_scene_alone(exact: ScenePlan, dial: str) -> None:
    turned = planned(**{dial: DIALS[dial]})
    assert_same_scene(exact, turned)
    changed = set()
    for view in ("AP", "LAT"):
        if not np.array_equal(turned.cameras[view].projection, exact.cameras[view].projection):
            changed.add(f"reported {view}")
        if not np.array_equal(turned.true_cameras[view].projection, exact.true_cameras[view].projection):
            changed.add(f"true {view}")
        if not np.array_equal(marks_px(turned, view), marks_px(exact, view)):
            changed.add(f"marks {view}")
    if turned.implants.keys() != exact.implants.keys():
        changed.add("CAD")
    both_marks = {"marks AP", "marks LAT"}
    want = {
        "focal_error_percent": {"reported AP", "reported LAT"},
        "principal_error_px": {"reported AP", "reported LAT"},
        "rotation_error_deg": {"reported LAT"},
        "translation_error_mm": {"reported LAT"},
        "cad_length_mm": {"CAD"},
        "cad_diameter_mm": {"CAD"},
        "motion_deg": {"true LAT", "marks LAT"},
        "motion_mm": {"true LAT", "marks LAT"},
    }.get(dial, both_marks)
    assert changed == want


def test_noise_is_in_proportion_and_the_same_at_any_amount(exact: ScenePlan) -> None:
    small, large = planned(landmark_noise_px=0.5), planned(landmark_noise_px=4.0)
    for view in ("AP", "LAT"):
        at_small, at_large = (marks_px(plan, view) - marks_px(exact, view) for plan in (small, large))
        np.testing.assert_allclose(at_large, 8.0 * at_small, atol=1e-9)
        assert np.abs(at_small).max() > 0.05


def test_marks_err_along_the_axis_by_millimetres(exact: ScenePlan) -> None:
    turned = planned(tip_bias_mm=2.0, center_bias_mm=-3.0)
    for view in ("AP", "LAT"):
        for screw, found in zip(exact.screws, marks_px(turned, view), strict=True):
            along = screw.world_from_cad[:3, 1]
            tip, center = (
                screw.world_from_cad @ np.append(point, 1.0) for point in ([0, 0, 0], screw.implant.center_mm)
            )
            want = exact.cameras[view].project(np.stack([tip[:3] + 2.0 * along, center[:3] - 3.0 * along]))
            np.testing.assert_allclose(found, want, atol=1e-9)


def test_intrinsics_err_by_what_is_said(exact: ScenePlan) -> None:
    turned = planned(focal_error_percent=1.5, principal_error_px=12.0)
    for view in ("AP", "LAT"):
        K, R, source = decomposed(exact.cameras[view].projection)
        wrong_K, wrong_R, wrong_source = decomposed(turned.cameras[view].projection)
        for axis in range(2):
            assert abs(wrong_K[axis, axis] / K[axis, axis] - 1.0) == pytest.approx(0.015, abs=1e-9)
        assert np.linalg.norm((wrong_K - K)[:2, 2]) == pytest.approx(12.0, abs=1e-6)
        np.testing.assert_allclose(wrong_R, R, atol=1e-9)
        np.testing.assert_allclose(wrong_source, source, atol=1e-6)


def test_lat_is_turned_and_moved_against_ap_by_what_is_said(exact: ScenePlan) -> None:
    turned, moved = planned(rotation_error_deg=2.0), planned(translation_error_mm=7.0)
    K, R, source = decomposed(exact.cameras["LAT"].projection)
    wrong_K, wrong_R, _ = decomposed(turned.cameras["LAT"].projection)
    np.testing.assert_allclose(wrong_K, K, atol=1e-6)
    assert np.degrees(Rotation.from_matrix(wrong_R @ R.T).magnitude()) == pytest.approx(2.0, abs=1e-9)
    # About the isocentre, so the screws stay in the picture.
    points = np.concatenate([screw.landmarks_in_world_mm for screw in exact.screws])
    off = turned.cameras["LAT"].project(points) - exact.cameras["LAT"].project(points)
    assert 0.5 < np.linalg.norm(off, axis=1).max() < 20.0
    _, same_R, wrong_source = decomposed(moved.cameras["LAT"].projection)
    np.testing.assert_allclose(same_R, R, atol=1e-9)
    assert np.linalg.norm(wrong_source - source) == pytest.approx(7.0, abs=1e-6)


def test_the_patient_moves_as_a_whole_before_lat(exact: ScenePlan) -> None:
    turned = planned(motion_deg=3.0, motion_mm=5.0)
    # What a resting camera sees of the moved patient: found from the marks' camera alone.
    moved_from_rest = np.linalg.solve(
        np.vstack([exact.cameras["LAT"].projection, [0, 0, 0, 1]]),
        np.vstack([turned.true_cameras["LAT"].projection, [0, 0, 0, 1]]),
    )
    R, shift = moved_from_rest[:3, :3], moved_from_rest[:3, 3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.degrees(Rotation.from_matrix(R).magnitude()) == pytest.approx(3.0, abs=1e-9)
    # It turns about a point near the screws, which itself moves by the 5 mm.
    middle = np.mean([screw.landmarks_in_world_mm for screw in exact.screws], axis=(0, 1))
    assert 1.0 < np.linalg.norm(R @ middle + shift - middle) < 9.0
    points = np.concatenate([screw.landmarks_in_world_mm for screw in exact.screws])
    want = exact.cameras["LAT"].project(points @ R.T + shift).reshape(2, 2, 2)
    np.testing.assert_allclose(marks_px(turned, "LAT"), want, atol=1e-6)


def test_marks_are_made_in_the_distorted_image(exact: ScenePlan) -> None:
    turned = planned(pincushion=0.03, s_distortion_deg=2.0)
    for view in ("AP", "LAT"):
        offset = marks_px(exact, view) - 511.5
        radius = np.linalg.norm(offset, axis=-1, keepdims=True) / 512.0
        angle = np.radians(2.0) * radius[..., 0] ** 2
        c, s = np.cos(angle), np.sin(angle)
        bent = np.stack([c * offset[..., 0] - s * offset[..., 1], s * offset[..., 0] + c * offset[..., 1]], axis=-1)
        np.testing.assert_allclose(marks_px(turned, view), 511.5 + bent * (1.0 + 0.03 * radius**2), atol=1e-6)


def test_the_given_cad_is_not_what_was_x_rayed(exact: ScenePlan) -> None:
    turned = planned(cad_length_mm=-5.0, cad_diameter_mm=1.0)
    (true,), (given,) = exact.implants.values(), turned.implants.values()
    assert given.center_mm[1] == true.center_mm[1] - 2.5
    low = [implant.mesh.vertices_mm[implant.mesh.vertices_mm[:, 1] < 30.0] for implant in (true, given)]
    thickness = [2.0 * np.hypot(vertices[:, 0], vertices[:, 2]).max() for vertices in low]
    assert thickness[1] - thickness[0] == pytest.approx(1.0, abs=0.02)
    assert turned.screws[0].implant.center_mm[1] == true.center_mm[1]
    np.testing.assert_array_equal(marks_px(turned, "AP"), marks_px(exact, "AP"))
    assert {mark.model for mark in turned.annotations["AP"]} == {given.name}


@pytest.mark.parametrize(
    ("dial", "value", "message"),
    [
        ("landmark_noise_px", -1.0, r"landmark_noise_px: -1 is out of range; expected from 0 to 100"),
        ("motion_deg", float("nan"), r"motion_deg: nan is out of range"),
        ("pincushion", 0.5, r"pincushion: 0.5 is out of range"),
    ],
)
def test_a_dial_beyond_its_end_is_refused(dial: str, value: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Imperfections(**{dial: value})


def test_a_given_mesh_cannot_be_another_one(exact: ScenePlan) -> None:
    implant = exact.screws[0].implant
    with pytest.raises(InputError, match=r"cad_length_mm: a CAD mismatch for the given mesh"):
        plan_scene(SceneOptions(), replace(EXACT, cad_length_mm=5.0), SEED, designs=[implant, implant])


@pytest.mark.parametrize("seed", [4, 5])
def test_marks_that_a_dial_drives_out_of_the_image_are_missing_and_no_others(seed: int) -> None:
    options = SceneOptions(
        screws=(12, 12), levels=(6, 8), designs=(1, 3), overlap_lat=(0.0, 1.0), image_size=(128, 128)
    )
    plan = plan_scene(options, replace(EXACT, motion_mm=100.0), seed)
    assert {(mark.view, mark.why) for mark in plan.missing} == {("LAT", "outside the field")}
    for mark in plan.missing:
        points = plan.true_cameras["LAT"].project(plan.screws[mark.screw].landmarks_in_world_mm)
        assert not ((points >= 0.0) & (points <= 127.0)).all()


def test_a_dial_that_leaves_too_few_marks_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("screwpose.simulation.arrangement._ATTEMPTS", 12)
    with pytest.raises(ScrewposeError, match=r"in 12 attempts: tips or centres are out of the field \("):
        plan_scene(
            SceneOptions(image_size=(128, 128), detector_mm=40.0), replace(EXACT, tip_bias_mm=-20.0, motion_mm=100.0), 1
        )
