"""Landmark proposals against measured real screws and against parametric ones, whose landmarks are known."""

import json
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from screwpose.implants import Mesh, ScrewDesign, check_landmarks, make_screw, propose_landmarks, read_mesh, transformed
from tests.data import shared_data


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def random_rigid(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    moved = np.eye(4)
    moved[:3, :3] = Rotation.random(rng=rng).as_matrix()
    moved[:3, 3] = rng.uniform(-200.0, 200.0, 3)
    return moved


def test_all_real_screws_against_their_measured_landmarks() -> None:
    """Worst of the 15: tip 0.33 mm, centre 0.22 mm; the measured axis is the file's +y, good to a degree itself."""
    folder = shared_data("screws_lassoan")
    models = json.loads((folder / "models.json").read_text())["models"]
    assert len(models) == 15
    for seed, (name, measured) in enumerate(models.items()):
        target_from_source = random_rigid(seed)
        found = propose_landmarks(transformed(read_mesh(folder / name), target_from_source))
        assert found.confidence == "sure", name
        assert found.tip_mm is not None
        assert found.center_mm is not None
        assert found.axis is not None
        for point, key, bound_mm in ((found.tip_mm, "tip", 0.4), (found.center_mm, "shank_center", 0.3)):
            want = target_from_source[:3, :3] @ measured[key] + target_from_source[:3, 3]
            assert np.linalg.norm(point - want) < bound_mm, (name, key)
        assert angle_deg(found.axis, target_from_source[:3, :3] @ measured["axis_tip_to_head"]) < 1.0
        assert found.thread is not None
        assert found.thread.right_handed
        np.testing.assert_allclose(found.thread.pitch_mm, 2.15, atol=0.1)


SCREWS: list[tuple[dict[str, Any], float]] = [
    ({}, 0.1),
    ({"tower": False}, 0.1),
    ({"thread_starts": 2, "pitch_mm": 2.0, "cannulation_mm": 0.0}, 0.1),
    ({"polyaxial": True, "shank_length_mm": 30.0, "shank_diameter_mm": 8.5}, 0.2),
    ({"shank_length_mm": 80.0, "shank_diameter_mm": 4.5, "tower_length_mm": 80.0}, 0.1),
    # A leaning tulip comes down on one side, and the head is taken to begin there.
    ({"polyaxial": True, "tilt_deg": 20.0, "tilt_direction_deg": 77.0}, 1.0),
    ({"polyaxial": True, "tilt_deg": 25.0, "tower": False}, 1.2),
]


@pytest.mark.parametrize(("fields", "center_mm"), SCREWS, ids=str)
def test_parametric_screws_wherever_they_lie(fields: dict[str, Any], center_mm: float) -> None:
    screw = make_screw(ScrewDesign(**fields))
    target_from_source = random_rigid(11)
    rotation, shift = target_from_source[:3, :3], target_from_source[:3, 3]
    found = propose_landmarks(transformed(screw.mesh, target_from_source))
    assert found.confidence == "sure", found.notes
    assert found.tip_mm is not None
    assert found.center_mm is not None
    assert found.axis is not None
    assert np.linalg.norm(found.tip_mm - shift) < 0.1
    assert np.linalg.norm(found.center_mm - rotation @ screw.center_mm - shift) < center_mm
    assert angle_deg(found.axis, rotation @ screw.axis) < 0.3  # a short shank has few turns to average over
    assert found.thread is not None
    assert found.thread.starts == fields.get("thread_starts", 1)
    np.testing.assert_allclose(found.thread.pitch_mm, fields.get("pitch_mm", 2.75), rtol=0.02)


def test_moving_the_mesh_moves_the_proposal() -> None:
    mesh = make_screw(ScrewDesign(tower=False)).mesh
    here = propose_landmarks(mesh)
    for seed in (3,):
        target_from_source = random_rigid(seed)
        there = propose_landmarks(transformed(mesh, target_from_source))
        assert here.tip_mm is not None
        assert here.center_mm is not None
        for a, b in ((here.tip_mm, there.tip_mm), (here.center_mm, there.center_mm)):
            assert b is not None
            np.testing.assert_allclose(b, target_from_source[:3, :3] @ a + target_from_source[:3, 3], atol=0.1)


def test_a_left_handed_thread_is_told_apart() -> None:
    mesh = make_screw(ScrewDesign(tower=False)).mesh
    mirrored = Mesh(mesh.vertices_mm * [-1.0, 1.0, 1.0], mesh.faces[:, ::-1])
    found = propose_landmarks(mirrored)
    assert found.thread is not None
    assert not found.thread.right_handed
    assert "A left-handed thread of 2.7" in found.notes[0]


def test_a_mesh_in_metres_is_found_but_not_sure() -> None:
    mesh = make_screw().mesh
    found = propose_landmarks(Mesh(mesh.vertices_mm / 1000.0, mesh.faces))
    assert found.confidence == "likely"
    assert found.center_mm is not None
    np.testing.assert_allclose(found.center_mm, [0.0, 0.0225, 0.0], atol=1e-4)
    assert "is it in metres?" in found.notes[-1]


def test_a_shank_without_a_head_is_likely_and_says_what_is_missing() -> None:
    found = propose_landmarks(make_screw().parts[0].mesh)
    assert found.confidence == "likely"
    assert found.tip_mm is not None
    assert np.linalg.norm(found.tip_mm) < 0.2
    assert any("No head was seen" in note for note in found.notes)


def test_a_screw_without_a_thread_is_likely_and_says_so() -> None:
    outline = np.array([[0, 0], [1.0, 0.2], [2.8, 6], [2.8, 45], [6.5, 45], [6.5, 60], [0, 60]], dtype=float)
    turned = trimesh.creation.revolve(outline, sections=48)  # about z
    found = propose_landmarks(Mesh(np.asarray(turned.vertices), np.asarray(turned.faces, dtype=np.int64)))
    assert found.confidence == "likely"
    assert found.thread is None
    assert found.center_mm is not None
    np.testing.assert_allclose(found.center_mm, [0.0, 0.0, 22.5], atol=0.2)
    assert "No thread was seen" in found.notes[0]


def other_bodies() -> list[Any]:
    rod = trimesh.creation.cylinder(2.75, 80.0, sections=48)
    rings = trimesh.creation.revolve(
        [(0, 0), *[(2.5 + 0.5 * (k % 2), 1 + 1.2 * k) for k in range(50)], (0, 62)], sections=48
    )
    box = trimesh.creation.box((60.0, 5.0, 8.0))
    return [pytest.param(body, id=name) for name, body in (("rod", rod), ("ringed rod", rings), ("bar", box))]


@pytest.mark.parametrize("body", other_bodies())
def test_what_is_slender_but_no_screw_is_left_open(body: trimesh.Trimesh) -> None:
    found = propose_landmarks(Mesh(np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int64)))
    assert found.confidence == "unsure"
    assert found.tip_mm is None
    assert "Give tip and centre by hand" in found.notes[0]


@pytest.mark.parametrize(
    "name",
    [
        "jtml_biplane/femur0.stl",
        "jtml_biplane/tibia0.stl",
        "jtml_single/KR_left_8_tib.stl",
        "anatomy/P001/vertebra_05.stl",
    ],
)
def test_real_bodies_that_are_no_screws_are_left_open(name: str) -> None:
    found = propose_landmarks(read_mesh(shared_data(name)))
    assert found.confidence == "unsure"
    assert found.tip_mm is None
    assert found.center_mm is None
    assert found.axis is None
    assert "too stout for a screw" in found.notes[0]


# --- landmarks that were given


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return make_screw(ScrewDesign(tower=False)).mesh  # tip 0, top of the tulip 61, centre 22.5


def check(mesh: Mesh, tip: tuple[float, ...], center: tuple[float, ...]) -> str:
    return " | ".join(check_landmarks(mesh, np.array(tip, dtype=float), np.array(center, dtype=float)))


def test_right_landmarks_raise_no_warning(mesh: Mesh) -> None:
    assert check(mesh, (0, 0, 0), (0, 22.5, 0)) == ""
    assert check(mesh, (0.3, -0.5, 0), (0, 30, 0.5)) == ""
    tower = make_screw(ScrewDesign(polyaxial=True, tilt_deg=25.0))
    assert check_landmarks(tower.mesh, tower.tip_mm, tower.center_mm) == ()


@pytest.mark.parametrize(
    ("tip", "center", "text"),
    [
        ((0, 22.5, 0), (0, 0, 0), "Tip and center look swapped"),
        ((0, 61, 0), (0, 22.5, 0), ""),
        ((0, 0, 0), (0, 0, 0), "Tip and center coincide"),
        ((0, 10, 0), (0, 30, 0), "not an end of the mesh: it goes on for 10 mm before the tip. Check the tip"),
        ((0, 0, 0), (0, 61, 0), "The center lies only 0 mm from the far end of the mesh"),
        ((0, 0, 0), (0, 225, 0), r"The center (0, 225, 0) lies 164 mm outside the mesh"),
        ((500, 0, 0), (500, 22.5, 0), r"The tip (500, 0, 0) lies 494 mm outside the mesh"),
        ((0, 0, 0), (0, 0.0225, 0), "Tip and center are 0.0225 mm apart, expected 4 to 125 mm"),
        ((np.nan, 0, 0), (0, 1, 0), "The tip (nan, 0, 0) is not finite"),
    ],
)  # fmt: skip
def test_wrong_landmarks_are_named(mesh: Mesh, tip: tuple[float, ...], center: tuple[float, ...], text: str) -> None:
    said = check(mesh, tip, center)
    assert (text in said) if text else (said == "")
