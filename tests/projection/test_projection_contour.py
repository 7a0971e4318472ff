"""Contours of closed surfaces held to the reference, pixel for pixel but for centres within 1e-3 px of an edge."""

import numpy as np
import pytest
import trimesh

from screwpose.errors import BehindSourceError
from screwpose.geometry import Camera, rigid
from screwpose.implants import ScrewDesign, make_screw
from screwpose.projection import reference
from screwpose.projection.contour import closed_surface, packed_bodies
from screwpose.projection.silhouette import scene_bits, unpacked

SHAPE = (160, 210)
CAMERA = Camera.from_matrix(np.array([[600.0, 2, 100, 0], [0, 590.0, 80, 0], [0, 0, 1, 0]]))
MIRRORED = Camera(np.array([[-600.0, 2, 100, 0], [0, 590.0, 80, 0], [0, 0, 1, 0]]))
SCREW = make_screw(ScrewDesign(segments=16, slot_lengths_mm=(30.0, 24.0), tower_length_mm=50.0)).mesh
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
Faces = tuple[np.ndarray, np.ndarray]


def drawn(camera: Camera, poses: list[np.ndarray], meshes: list[Faces], shape=SHAPE) -> np.ndarray:
    return unpacked(scene_bits(camera.projection, np.array(poses), packed_bodies(meshes), shape), shape[1])


def assert_is_the_references(camera: Camera, poses: list[np.ndarray], meshes: list[Faces], shape=SHAPE) -> int:
    """Both masks are the same but within 1e-3 px of an edge; returns how many pixels are covered."""
    want = np.zeros(shape, dtype=bool)
    corners = []
    for pose, (vertices, faces) in zip(poses, meshes, strict=True):
        pixels = camera.project(rigid.transform(pose, vertices))
        want |= reference.silhouette(pixels, faces, shape)
        corners.append(pixels[faces])
    got = drawn(camera, poses, meshes, shape)
    starts = np.concatenate(corners)
    along = np.roll(starts, -1, axis=1) - starts
    for v, u in np.argwhere(got != want):
        t = np.sum(([u, v] - starts) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-300)
        assert np.linalg.norm([u, v] - starts - np.clip(t, 0, 1)[..., None] * along, axis=2).min() < 1e-3
    assert (got != want).mean() < 0.001
    return int(want.sum())


def pose_at(x: float, y: float, z: float, turn: np.ndarray | tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = rigid.exp_rotation(np.asarray(turn, dtype=float))
    pose[:3, 3] = [x, y, z]
    return pose


@pytest.mark.parametrize("camera", [CAMERA, MIRRORED], ids=["camera", "mirrored"])
@pytest.mark.parametrize("seed", range(4))
def test_two_screws_anywhere(camera: Camera, seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = [pose_at(*rng.uniform([-60, -50, 380], [60, 50, 460]), rng.normal(size=3)) for _ in range(2)]
    screw = (SCREW.vertices_mm, SCREW.faces)
    assert assert_is_the_references(camera, poses, [screw, screw]) > 1000


def test_a_screw_seen_along_its_axis_crosses_a_row_often() -> None:
    pose = pose_at(3.3, 2.2, 150.0, (-1.55, 0.02, 0.01))
    assert assert_is_the_references(CAMERA, [pose], [(SCREW.vertices_mm, SCREW.faces)]) > 1000


def test_a_long_screw_lying_along_the_rows() -> None:
    pose = pose_at(-60.0, 2.2, 350.0, (0.0, 0.0, -1.57))
    assert assert_is_the_references(CAMERA, [pose], [(SCREW.vertices_mm, SCREW.faces)]) > 2000


def test_bodies_with_holes_hollows_and_more_than_two_faces_at_an_edge() -> None:
    ring = trimesh.creation.annulus(10.0, 20.0, 8.0)
    outer, inner = trimesh.creation.icosphere(2, 20.0), trimesh.creation.icosphere(2, 12.0)
    inner.invert()
    hollow = trimesh.util.concatenate([outer, inner])
    corners = np.array([[0.0, 0, 0], [0, 0, 20], [15, 3, 6], [12, -9, 9], [-15, 3, 4], [-11, -9, 12]])
    sharing = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2], [0, 4, 1], [0, 1, 5], [0, 5, 4], [1, 4, 5]])
    for vertices, faces in (
        (ring.vertices, ring.faces),
        (ring.vertices, ring.faces[:, ::-1]),  # inside out
        (hollow.vertices, hollow.faces),
        (corners, sharing),
    ):
        assert closed_surface(vertices, faces) is not None
        for seed in range(6):
            turn = np.random.default_rng(seed).normal(size=3)
            assert assert_is_the_references(CAMERA, [pose_at(4.0, -7.0, 300.0, turn)], [(vertices, faces)]) > 200


def test_across_and_beyond_every_border() -> None:
    rng = np.random.default_rng(8)
    ball = trimesh.creation.icosphere(2, 1.0)
    covered = []
    for _ in range(40):
        size = rng.uniform(2.0, 60.0)
        mesh = (np.asarray(ball.vertices) * size, np.asarray(ball.faces))
        place = pose_at(*rng.uniform([-90, -80, 200], [90, 80, 400]))
        covered.append(assert_is_the_references(CAMERA, [place], [mesh], (100, 128)))
    assert min(covered) == 0
    assert max(covered) > 3000


def test_open_and_closed_bodies_in_one_scene() -> None:
    screw = (SCREW.vertices_mm, SCREW.faces)
    part = (SCREW.vertices_mm, SCREW.faces[::3])
    poses = [pose_at(-20.0, -40.0, 400.0, (0.1, 0.4, 0.2)), pose_at(15.0, -20.0, 420.0, (0.5, 0.1, -0.3))]
    assert assert_is_the_references(CAMERA, poses, [part, screw]) > 1000
    assert assert_is_the_references(CAMERA, poses, [screw, part]) > 1000


@pytest.mark.parametrize("count", [100, 255, 256], ids=["crossings in several loads", "just", "one too many"])
def test_as_many_layers_as_a_byte_cannot_tell_from_none(count: int) -> None:
    plate = trimesh.creation.box((20.0, 14.0, 0.05))
    pile = trimesh.util.concatenate([plate.copy().apply_translation([0, 0, 0.2 * k]) for k in range(count)])
    covered = assert_is_the_references(CAMERA, [pose_at(0.3, 0.2, 300.0)], [(pile.vertices, pile.faces)])
    assert covered == pytest.approx(20 * 14 * 4, rel=0.1)


def test_a_mirrored_body_does_not_cancel_another() -> None:
    box = trimesh.creation.box((20.0, 14.0, 9.0))
    mirrored = pose_at(1.0, 2.0, 310.0, (0.2, 0.1, 0.3))
    mirrored[:3, 0] *= -1.0
    box_mesh = (box.vertices, box.faces)
    poses = [pose_at(0.3, 0.2, 300.0, (0.2, 0.1, 0.3)), mirrored]
    assert assert_is_the_references(CAMERA, poses, [box_mesh, box_mesh]) > 500


def test_a_room_is_left_as_it_was_found() -> None:
    from screwpose.projection import contour_kernels

    bodies = packed_bodies([(SCREW.vertices_mm, SCREW.faces)] * 2)
    room = contour_kernels.room_for(bodies, *SHAPE)
    rng = np.random.default_rng(12)
    for _ in range(6):
        poses = np.array([pose_at(*rng.uniform([-80, -70, 300], [80, 70, 460]), rng.normal(size=3)) for _ in range(2)])
        contour_kernels.draw_scene(CAMERA.projection, poses, bodies, SHAPE[1], room)
        assert room.bits.any()
        assert not room.changes.any()
        assert not room.raised.any()
        contour_kernels.clear(room)
        assert not room.bits.any()
        assert (room.ranges == [SHAPE[0], 0]).all()


def test_an_edge_has_one_face_each_way_and_planes_face_outwards() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    surface = closed_surface(vertices, TETRAHEDRON)
    assert surface is not None
    assert len(surface.edge_vertices) == 6
    np.testing.assert_allclose(np.linalg.norm(surface.planes[:3], axis=0), 1.0)
    assert (surface.planes[:3].T @ vertices.mean(axis=0) < surface.planes[3]).all()
    for (a, b), (along, against) in zip(surface.edge_vertices, surface.edge_faces, strict=True):
        assert (a, b) in zip(TETRAHEDRON[along], np.roll(TETRAHEDRON[along], -1), strict=True)
        assert (b, a) in zip(TETRAHEDRON[against], np.roll(TETRAHEDRON[against], -1), strict=True)
    assert closed_surface(vertices, TETRAHEDRON[:3]) is None
    assert closed_surface(vertices, np.vstack([TETRAHEDRON[:3], TETRAHEDRON[3:, ::-1]])) is None


def test_behind_the_source_is_an_error_but_a_box_that_only_might_be_is_none() -> None:
    mesh = (SCREW.vertices_mm, SCREW.faces)
    with pytest.raises(BehindSourceError, match="not in front of the X-ray source"):
        drawn(CAMERA, [pose_at(0.0, 0.0, 3.0)], [mesh])
    # Vertices along the diagonal of their box, seen across it: two of the box's corners lie behind the source.
    vertices = np.array([[0.0, 0, 0], [100, 100, 0], [104, 100, 0], [100, 100, 9]])
    pose = np.eye(4)
    pose[:3, :3] = [[0.5**0.5, 0.5**0.5, 0.0], [0.0, 0.0, 1.0], [0.5**0.5, -(0.5**0.5), 0.0]]
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    pose[:3, 3] = [-60.0, 5.0, 50.0]
    assert assert_is_the_references(CAMERA, [pose], [(vertices, TETRAHEDRON)]) > 500
