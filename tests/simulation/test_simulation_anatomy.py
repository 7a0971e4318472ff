"""The patient is put together soundly: each tissue lies within the one that it displaces."""

import numpy as np
import pytest
import trimesh

from screwpose.errors import MeshError
from screwpose.implants.model import Mesh
from screwpose.simulation import solids
from screwpose.simulation.anatomy import Anatomy, patient, random_anatomy, world_from_level
from screwpose.simulation.materials import CANCELLOUS_BONE, CORTICAL_BONE, DISC, FAT, GAS, MUSCLE, VISCERA
from screwpose.simulation.xray import Body


def in_world(body: Body) -> Mesh:
    return Mesh(body.vertices_in_world_mm, body.mesh.faces)


def volume(mesh: Mesh | None) -> float:
    return 0.0 if mesh is None else trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).volume


AROUND = {MUSCLE: FAT, VISCERA: MUSCLE, GAS: VISCERA, DISC: MUSCLE, CORTICAL_BONE: MUSCLE}


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_tissue_lies_in_what_it_displaces(seed):
    rng = np.random.default_rng(seed)
    bodies = patient(random_anatomy(rng, pedicle_x=rng.uniform(13.0, 19.0)), rng, levels=range(-3, 4))
    of = {m: [in_world(b) for b in bodies if b.material is m] for m in (FAT, MUSCLE, VISCERA, CORTICAL_BONE)}
    assert [len(meshes) for meshes in of.values()] == [1, 1, 1, 7]
    checked = set()
    for body in bodies:
        inside = in_world(body)
        assert trimesh.Trimesh(inside.vertices_mm, inside.faces, process=False).is_watertight
        if body.material is FAT:
            continue
        if body.material is CANCELLOUS_BONE:
            share = max(volume(solids.intersection(inside, shell)) for shell in of[CORTICAL_BONE]) / volume(inside)
        else:
            share = volume(solids.intersection(inside, of[AROUND[body.material]][0])) / volume(inside)
        assert share == pytest.approx(1.0, abs=1e-6), body.material.name
        checked.add(body.material.name)
        around = CORTICAL_BONE if body.material is CANCELLOUS_BONE else AROUND[body.material]
        assert all(body.layer > other.layer for other in bodies if other.material is around)
        if body.material in (DISC, CORTICAL_BONE):  # spine and belly do not meet
            assert volume(solids.intersection(inside, of[VISCERA][0])) == 0.0
    assert checked >= {"muscle", "viscera", "disc", "cortical bone", "cancellous bone"}


def test_vertebra_has_an_adults_measures():
    rng = np.random.default_rng(0)
    bodies = patient(Anatomy(), rng, levels=range(0, 1))
    vertebra = next(in_world(body) for body in bodies if body.material is CORTICAL_BONE)
    size = np.ptp(vertebra.vertices_mm, axis=0)
    # The five lowest of the segmented spine in shared/data/anatomy: 78-105 mm wide, 82-95 deep, 61-83 cm^3; this one is
    # simpler, and slender between its processes.
    assert 75.0 < size[0] < 95.0
    assert 80.0 < size[1] < 100.0
    assert 45e3 < volume(vertebra) < 83e3


def test_neighbours_hardly_share_bone():
    rng = np.random.default_rng(4)
    bodies = patient(random_anatomy(rng, 15.0), rng, levels=range(0, 2))
    lower, upper = (in_world(body) for body in bodies if body.material is CORTICAL_BONE)
    assert volume(solids.intersection(lower, upper)) < 0.02 * volume(lower)


def test_levels_stand_on_a_circle_behind_which_the_back_is_hollow():
    anatomy = Anatomy(lordosis_radius=300.0)
    origin, upper = world_from_level(anatomy, 0.0), world_from_level(anatomy, 2.0)
    np.testing.assert_allclose(origin, np.eye(4))
    center = np.array([0.0, 300.0, 0.0])
    assert np.linalg.norm(upper[:3, 3] - center) == pytest.approx(300.0)
    assert upper[2, 3] > 60.0
    np.testing.assert_allclose(upper[:3, 1], (center - upper[:3, 3]) / 300.0, atol=1e-12)  # its back faces the centre


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
