"""Patients from segmented spines and CT: their levels are found where the bone is, by measures that need no person."""

from collections.abc import Iterator

import numpy as np
import pytest

from screwpose.errors import ImageError, MeshError
from screwpose.implants.mesh import write_stl
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.bodies import Layer
from screwpose.simulation.patient import Patient, ct_patient, mesh_spine_patient
from screwpose.simulation.spine_ct import extended, find_ct_levels, sampled_hu
from screwpose.simulation.spine_levels import find_level, find_levels
from screwpose.simulation.spine_mesh import read_vertebrae
from screwpose.simulation.spine_shapes import made_bone, shape_of_level
from screwpose.simulation.volume import CtVolume
from tests.data import shared_data


@pytest.fixture(scope="module")
def segmented() -> Patient:
    return mesh_spine_patient(shared_data("anatomy/P001"), np.random.default_rng(0))


def rods(patient: Patient, radius: float) -> Iterator[Mesh]:
    """Through every pedicle from 3 mm behind its middle 20 mm forward, converging by 10 degrees, in the world."""
    for level in patient.levels:
        for side, pedicle in zip((1.0, -1.0), level.pedicles_mm, strict=True):
            forward = -np.array([side * np.sin(np.radians(10.0)), np.cos(np.radians(10.0)), 0.0])
            ends = [pedicle - 3.0 * forward, pedicle + 17.0 * forward]
            placed = [level.world_from_level[:3, :3] @ end + level.world_from_level[:3, 3] for end in ends]
            yield solids.mesh(solids.blob(*((end, [radius] * 3) for end in placed)))


def test_pedicles_of_the_segmented_spine_hold_a_screw(segmented):
    """A bar of 5.5 mm, 20 mm long, stays in bone: wholly in lumbar pedicles, most of it in slender thoracic ones."""
    bones = [body for body in segmented.bodies(np.random.default_rng(0)) if body.layer is Layer.CORTEX]
    spine = [body for body in bones if 3000 < len(body.mesh.faces) < 8000]
    assert len(segmented.levels) == 11
    shares = []
    for rod in rods(segmented, 2.75):
        made = solids.solid(rod)
        shares.append(max((made ^ solids.solid(body.mesh)).volume() for body in spine) / made.volume())
    lumbar, thoracic = np.array(shares[:10]), np.array(shares[10:])
    assert lumbar.min() > 0.95
    assert thoracic.min() > 0.7
    assert np.median(thoracic) > 0.85


def test_levels_of_the_segmented_spine_are_an_adults(segmented):
    frames = np.stack([level.world_from_level for level in segmented.levels])
    np.testing.assert_allclose(np.linalg.det(frames[:, :3, :3]), 1.0)
    assert (np.diff(frames[:, 2, 3]) > 18.0).all()
    np.testing.assert_allclose(frames[2, :3, 3], 0.0, atol=1e-9)
    for lower, upper in zip(segmented.levels, segmented.levels[1:], strict=False):
        turn = lower.world_from_level[:3, :3].T @ upper.world_from_level[:3, :3]
        assert np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) < 26.0
    for level in segmented.levels:
        left, right = level.pedicles_mm
        assert left[0] > 8.0
        assert right[0] < -8.0
        assert 18.0 < left[0] - right[0] < 52.0
        assert 14.0 < level.body_half_depth_mm < 24.0
        assert 18.0 < level.body_height_mm < 32.0
        # Behind the body, in its upper half.
        assert (level.pedicles_mm[:, 1] > level.body_half_depth_mm).all()
        assert (np.abs(level.pedicles_mm[:, 2] - 4.0) < 4.5).all()


def test_bodies_of_the_segmented_spine_are_usable(segmented):
    bodies = segmented.bodies(np.random.default_rng(1))
    for body in bodies:
        assert len(body.closed.faces)
    assert sum(len(body.mesh.faces) for body in bodies) < 220_000
    assert sum(body.layer is Layer.MARROW for body in bodies) >= 11
    highest = max(float(body.vertices_in_world_mm[:, 1].max()) for body in bodies if body.layer is Layer.CORTEX)
    skin = max(float(body.vertices_in_world_mm[:, 1].max()) for body in bodies)
    assert skin > highest


@pytest.mark.parametrize("index", [2, 9])
@pytest.mark.parametrize("lean_deg", [0.0, 12.0])
def test_a_made_vertebra_is_found_where_it_was_made(index, lean_deg):
    """Its pedicles were drawn at known places; leaning, and approached from the wrong direction."""
    bone, _ = made_bone(index)
    shape = shape_of_level(index)
    c, s = np.cos(np.radians(lean_deg)), np.sin(np.radians(lean_deg))
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    found = find_level(
        Mesh(bone.vertices_mm @ turn.T + [3.0, -50.0, 400.0], bone.faces),
        np.array([3.0, -46.0, 398.0]),
        np.array([0.0, 0.0, 1.0]),
    )
    np.testing.assert_allclose(found.world_from_level[:3, 3], [3.0, -50.0, 400.0], atol=1.5)
    angle = np.degrees(np.arccos((np.trace(turn.T @ found.world_from_level[:3, :3]) - 1.0) / 2.0))
    assert angle < 3.0
    np.testing.assert_allclose(np.abs(found.pedicles_mm[:, 0]), shape.pedicle_x, atol=2.0)
    np.testing.assert_allclose(found.pedicles_mm[:, 2], shape.pedicle_z, atol=2.0)
    assert found.body_half_depth_mm == pytest.approx(shape.half_depth, abs=1.5)
    # Between the end plates, which are hollow: by 1.9 and 2.5 mm.
    assert found.body_height_mm == pytest.approx(shape.height - 4.0, abs=1.0)


def test_what_is_no_vertebra_is_refused():
    with pytest.raises(MeshError, match="one sees 0 mm2 through the canal of this vertebra; expected a whole vertebra"):
        find_levels(
            [Mesh(solids.box((20, 20, 12)).vertices_mm + [0, 0, 30 * k], solids.box((1, 1, 1)).faces) for k in range(3)]
        )


def test_a_folder_without_vertebrae_is_refused(tmp_path):
    with pytest.raises(
        MeshError, match=r"0 files named vertebra_\*\.stl; expected 6 or more, vertebra_01.stl the highest"
    ):
        read_vertebrae(tmp_path)
    for number in range(1, 7):
        write_stl(solids.box((20, 20, 12)), tmp_path / f"vertebra_{number:02d}.stl")
    box = solids.box((20, 20, 12))
    write_stl(Mesh(box.vertices_mm, box.faces[1:]), tmp_path / "vertebra_04.stl")
    with pytest.raises(MeshError, match=r"vertebra_04\.stl: a mesh of 11 faces that encloses no solid"):
        read_vertebrae(tmp_path)


@pytest.fixture(scope="module")
def scanned() -> Patient:
    return ct_patient(shared_data("ct/example_ct.nii.gz"), np.random.default_rng(0))


def test_levels_of_a_ct_are_its_lumbar_vertebrae(scanned):
    """Discs were read off the sagittal slice by eye, mm along the file's z: 222, 260, 298, 335, 371, 404."""
    assert scanned.volume is not None
    assert scanned.bodies(np.random.default_rng(0)) == []
    heights = np.array([level.world_from_level[2, 3] for level in scanned.levels])
    by_eye = np.array([222.0, 260.0, 298.0, 335.0, 371.0, 404.0])
    middles = 0.5 * (by_eye[1:] + by_eye[:-1])
    np.testing.assert_allclose(heights, middles - middles[2], atol=4.0)
    assert 80.0 < scanned.back_mm < 130.0


def test_levels_of_a_ct_are_in_bone(scanned):
    """At its pedicles there is bone, in the canal between them there is none."""
    assert scanned.volume is not None
    for level in scanned.levels:
        np.testing.assert_allclose(np.linalg.det(level.world_from_level[:3, :3]), 1.0)
        local = np.vstack([level.pedicles_mm, level.pedicles_mm.mean(axis=0) + [0.0, 6.0, 0.0], np.zeros(3)])
        left, right, canal, middle = sampled_hu(
            scanned.volume, local @ level.world_from_level[:3, :3].T + level.world_from_level[:3, 3]
        )
        assert min(left, right) > 130.0
        assert canal < min(left, right) - 40.0
        assert middle > 80.0


def test_a_ct_goes_on_beyond_its_ends():
    hu = np.arange(24.0, dtype=np.float32).reshape(2, 3, 4)
    lps_from_ras = np.diag([-1.5, -1.5, 3.0, 1.0])
    longer = extended(CtVolume(hu, lps_from_ras), 7.0)
    assert longer.hu.shape == (2, 3, 10)
    for z, k in ((-8.0, 0), (0.0, 0), (9.0, 3), (15.0, 3)):
        assert sampled_hu(longer, np.array([[-1.5, -3.0, z]]))[0] == hu[1, 2, k]


def test_a_ct_without_a_spine_is_refused():
    air = CtVolume(np.full((60, 60, 80), -1000.0, dtype=np.float32), np.diag([-3.0, -3.0, 3.0, 1.0]))
    with pytest.raises(ImageError, match="0 vertebrae between discs are found in this CT volume; expected 3 or more"):
        find_ct_levels(air)
