"""The parametric patient is put together soundly: bones are closed, in their places, and of an adult's measures."""

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
import trimesh

from screwpose._types import FloatArray
from screwpose.errors import MeshError
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.anatomy_bones import bones_from_table
from screwpose.simulation.anatomy_fields import bar, ellipsoid, slab, smooth_union
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import GAS
from screwpose.simulation.patient import Level, Patient, parametric_patient
from screwpose.simulation.ribs import made_pelvis
from screwpose.simulation.spine_shapes import LEVEL_NAMES, made_bone

SEEDS = (0, 1)


def in_world(body: Body) -> Mesh:
    return Mesh(body.vertices_in_world_mm, body.mesh.faces)


def as_trimesh(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def volume(mesh: Mesh | None) -> float:
    return 0.0 if mesh is None else float(as_trimesh(mesh).volume)


@pytest.fixture(scope="module")
def patients() -> list[tuple[Patient, list[Body]]]:
    made = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        patient = parametric_patient(rng)
        made.append((patient, patient.bodies(rng)))
    return made


def of_layer(bodies: list[Body], layer: Layer) -> list[Body]:
    return [body for body in bodies if body.layer is layer]


def vertebrae(patient: Patient, bodies: list[Body]) -> list[tuple[Mesh, Mesh]]:
    """Bone and marrow of each level, in the world."""
    found = []
    for level in patient.levels:
        at_level = [b for b in bodies if np.array_equal(b.world_from_body, level.world_from_level)]
        bone, marrow = of_layer(at_level, Layer.CORTEX), of_layer(at_level, Layer.MARROW)
        assert [len(bone), len(marrow)] == [1, 1]
        found.append((in_world(bone[0]), in_world(marrow[0])))
    return found


def test_every_body_is_a_closed_solid(patients):
    for _, bodies in patients:
        for body in bodies:
            mesh = in_world(body)
            assert as_trimesh(mesh).is_watertight, (body.layer, body.material.name)
            assert volume(mesh) > 0.0
            solids.solid(mesh)


def test_levels_are_right_handed_and_stand_above_each_other(patients):
    for patient, _ in patients:
        assert [level.name for level in patient.levels] == list(LEVEL_NAMES)
        assert len(patient.levels) >= 8
        np.testing.assert_allclose(patient.levels[2].world_from_level, np.eye(4), atol=1e-9)  # L3 is the world's frame
        frames = np.stack([level.world_from_level for level in patient.levels])
        np.testing.assert_allclose(
            np.swapaxes(frames, 1, 2)[:, :3, :3] @ frames[:, :3, :3], [np.eye(3)] * 12, atol=1e-9
        )
        np.testing.assert_allclose(np.linalg.det(frames[:, :3, :3]), 1.0)
        assert (frames[:, 2, 2] > 0.7).all()
        assert (frames[:, 1, 1] > 0.7).all()
        gaps = np.linalg.norm(np.diff(frames[:, :3, 3], axis=0), axis=1)
        heights = np.array([level.body_height_mm for level in patient.levels])
        discs = gaps - 0.5 * (heights[1:] + heights[:-1])
        assert ((discs > 1.5) & (discs < 14.0)).all()
        for level in patient.levels:
            left, right = level.pedicles_mm
            np.testing.assert_allclose(left * [-1, 1, 1], right)
            assert left[0] > 8.0
            assert left[1] > level.body_half_depth_mm


def share_in(solid_mesh: Mesh, level: Level, start: FloatArray, end: FloatArray, radius: float) -> float:
    """Of a round bar in a level's frame, the share that lies within a solid in the world."""
    frame = level.world_from_level
    ends = [frame[:3, :3] @ point + frame[:3, 3] for point in (start, end)]
    rod = solids.mesh(solids.blob(*((point, [radius] * 3) for point in ends)))
    return volume(solids.intersection(rod, solid_mesh)) / volume(rod)


@pytest.mark.parametrize("pedicle_x", [12.0, 19.0])
def test_asked_pedicles_are_where_the_bone_is(pedicle_x):
    """A bar of 3 mm through a pedicle, front to back, is in bone; one through the canal beside it is not."""
    rng = np.random.default_rng(5)
    patient = parametric_patient(rng, pedicle_x)
    assert patient.levels[2].pedicles_mm[0, 0] == pytest.approx(pedicle_x)
    for level, (bone, _) in zip(patient.levels, vertebrae(patient, patient.bodies(rng)), strict=True):
        for pedicle in level.pedicles_mm:
            assert share_in(bone, level, pedicle - [0, 5, 0], pedicle + [0, 5, 0], 1.5) > 0.93, level.name
            canal = pedicle * [0.0, 1.0, 1.0] + [0.0, 3.0, 0.0]
            assert share_in(bone, level, canal, canal + [0, 1, 0], 2.0) < 0.02, level.name


def test_marrow_lies_in_bone(patients):
    for patient, bodies in patients:
        for bone, marrow in vertebrae(patient, bodies):
            assert volume(solids.intersection(marrow, bone)) > 0.995 * volume(marrow)
            assert 0.35 < volume(marrow) / volume(bone) < 0.8


def test_vertebrae_have_an_adults_measures(patients):
    """Against the segmented spine of the data folder: its five lowest have 61-83 cm^3, 78-105 mm wide, 82-95 deep."""
    for patient, bodies in patients:
        for level, (bone, _) in zip(patient.levels, vertebrae(patient, bodies), strict=True):
            size = np.ptp((bone.vertices_mm - level.world_from_level[:3, 3]) @ level.world_from_level[:3, :3], axis=0)
            if level.name in ("L2", "L3", "L4"):
                assert 78.0 < size[0] < 110.0
                assert 76.0 < size[1] < 105.0
                assert 32e3 < volume(bone) < 85e3


def test_no_two_vertebrae_are_alike_and_neighbours_hardly_share_bone(patients):
    for patient, bodies in patients:
        meshes = [bone for bone, _ in vertebrae(patient, bodies)]
        for lower, upper in pairwise(meshes):
            assert volume(solids.intersection(lower, upper)) < 0.03 * volume(lower)
        # T11 and T12 are bent from the same bone: not by the same bends.
        own = [
            b.mesh.vertices_mm
            for b in bodies
            if b.layer is Layer.CORTEX and b.mesh.faces.shape == meshes[6].faces.shape
        ]
        assert all(np.abs(own[0] - other).max() > 0.5 for other in own[1:])


def test_tissues_are_in_the_trunk(patients):
    """What is soft is inside the skin, gas within the belly; the skin is the largest of the trunk."""
    for _, bodies in patients:
        skin = in_world(next(b for b in bodies if b.material.name == "skin"))
        around = solids.solid(skin)
        for body in bodies:
            if body.layer in (Layer.VISCERA, Layer.GAS, Layer.MUSCLE, Layer.DISC) or body.material is GAS:
                mesh = in_world(body)
                # Bubbles overlap, which a volume of the mesh counts twice: as a union.
                made = solids.union(solids.solid(mesh).decompose())
                # All reach beyond the view along z.
                share = (made ^ around).volume() / made.volume()
                assert share > 0.97, (body.layer, body.material.name, share)


def test_nothing_is_behind_the_source():
    """Sources of a C-arm turn at 600 mm and more about the spine, from 30 to 150 degrees to either side and above."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        patient = parametric_patient(rng, table=True)
        points = np.concatenate([body.vertices_in_world_mm for body in patient.bodies(rng)])
        for level in patient.levels[:9]:
            for angle in np.radians([0.0, 90.0, 270.0]):
                beam = np.array([np.sin(angle), np.cos(angle), 0.0])
                depth = (points - level.world_from_level[:3, 3]) @ beam + 600.0
                assert depth.min() > 100.0


def all_points(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.concatenate([body.vertices_in_world_mm for body in parametric_patient(rng).bodies(rng)])


def test_same_generator_state_same_patient():
    first, again, other = (all_points(seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert first.shape != other.shape or np.abs(first - other).max() > 1.0


def test_building_is_light(patients):
    for _, bodies in patients:
        assert sum(len(body.mesh.faces) for body in bodies) < 220_000


def test_fields_are_signed_distances():
    at = np.array([10.0]), np.array([0.0]), np.array([0.0])
    assert ellipsoid(at, (0, 0, 0), (4, 4, 4))[0] == pytest.approx(6.0)
    assert ellipsoid((np.zeros(1),) * 3, (0, 0, 0), (4, 5, 6))[0] < -3.0
    assert bar(at, (0, -5, 0), (0, 5, 0), (3.0, 3.0))[0] == pytest.approx(7.0)
    assert bar(at, (0, 0, 0), (10, 0, 0), (1.0, 3.0))[0] == pytest.approx(-3.0)
    triangle = ((0, -20, -20), (0, 20, -20), (0, 0, 20))
    assert slab(at, triangle, 2.0)[0] == pytest.approx(8.0)
    assert slab((np.zeros(1), np.array([25.0]), np.array([-20.0])), triangle, 2.0)[0] == pytest.approx(3.0)
    assert smooth_union(np.array([1.0]), np.array([9.0]), 4.0)[0] == 1.0
    assert smooth_union(np.array([1.0]), np.array([1.0]), 4.0)[0] == pytest.approx(0.0)  # 4 / 4 below


def test_isosurface_of_a_sphere_is_closed_and_as_large():
    axis = np.arange(-12.0, 12.1, 1.0)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    made = solids.isosurface(np.sqrt(x**2 + y**2 + z**2) - 10.0, np.full(3, -12.0), 1.0)
    assert as_trimesh(made).is_watertight
    assert volume(made) == pytest.approx(4.0 / 3.0 * np.pi * 10.0**3, rel=0.01)
    np.testing.assert_allclose(np.linalg.norm(made.vertices_mm, axis=1), 10.0, atol=0.1)
    np.testing.assert_allclose(solids.vertex_normals(made), made.vertices_mm / 10.0, atol=0.25)
    assert volume(solids.displaced(made, -2.0)) == pytest.approx(4.0 / 3.0 * np.pi * 8.0**3, rel=0.02)


def test_isosurface_closes_whatever_the_field():
    """White noise has every case of the tetrahedra, the ambiguous ones of cubes too."""
    values = np.random.default_rng(0).normal(size=(9, 9, 9))
    values[[0, -1]] = values[:, [0, -1]] = values[:, :, [0, -1]] = 1.0
    made = solids.isosurface(values, np.zeros(3), 1.0)
    assert as_trimesh(made).is_watertight
    solids.solid(made)
    assert volume(made) > 0.0


def test_crumbs_go_and_the_rest_stays():
    both = solids.merged(
        [solids.box((5.0, 5.0, 5.0)), Mesh(solids.box((0.2, 0.2, 0.2)).vertices_mm + 9.0, solids.box((1, 1, 1)).faces)]
    )
    assert volume(both) == pytest.approx(1000.064)
    assert volume(solids.without_crumbs(both)) == pytest.approx(1000.0)


def test_swept_rod_has_the_volume_of_a_bent_cylinder():
    angle = np.linspace(0.0, 1.0, 60)
    path = 50.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    made = solids.swept(path, np.full((60, 2), 3.0), corners=48)
    by_pappus = np.pi * 9.0 * 50.0 + 2 * np.pi * 9.0 * 1.5 / 3.0  # and two blunt cones
    assert volume(made) == pytest.approx(by_pappus, rel=0.01)


def test_bone_of_a_level_is_symmetric_and_in_one_piece():
    bone, marrow = made_bone(2)
    assert len(solids.solid(bone).decompose()) == 1
    # Marrow may be cut off where a process is thin.
    assert max(piece.volume() for piece in solids.solid(marrow).decompose()) > 0.9 * volume(marrow)
    assert bone.vertices_mm[:, 0].max() == pytest.approx(-bone.vertices_mm[:, 0].min(), abs=0.5)


def test_stored_bones_are_those_that_the_code_makes():
    """After a change of shapes, tools/make_bones.py has to be run."""
    made = {"L3": made_bone(2), "T8": made_bone(9), "pelvis": made_pelvis()}
    for name, surfaces in made.items():
        for fresh, stored in zip(surfaces, bones_from_table(name), strict=True):
            assert volume(stored) == pytest.approx(volume(fresh), rel=1e-3)
            np.testing.assert_allclose(stored.vertices_mm.min(axis=0), fresh.vertices_mm.min(axis=0), atol=0.05)
            np.testing.assert_allclose(stored.vertices_mm.max(axis=0), fresh.vertices_mm.max(axis=0), atol=0.05)


def test_solid_refuses_an_open_mesh():
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    with pytest.raises(
        MeshError, match=r"a mesh of 11 faces that encloses no solid \(NotManifold\); expected a closed"
    ):
        solids.solid(Mesh(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int64)[1:]))


def test_loft_of_two_squares_is_a_frustum_with_roofs():
    square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    rings = np.stack([np.column_stack([k * square, np.full(4, z)]) for k, z in ((1.0, 0.0), (2.0, 3.0))])
    made = solids.lofted(rings, np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 3.0]))
    assert volume(made) == pytest.approx(3.0 / 3.0 * (4.0 + 16.0 + 8.0))


def test_importing_patients_loads_no_compiler():
    code = (
        "import sys, screwpose.simulation.patient, screwpose.simulation.instruments, screwpose.simulation.needles;"
        "slow = ('numba', 'trimesh', 'manifold3d', 'scipy.interpolate', 'cv2', 'nibabel');"
        "print([m for m in slow if m in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"
