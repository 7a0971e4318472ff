"""Path lengths against closed forms and against a plain ray caster (Moeller & Trumbore 1997) written here."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from screwpose._types import FloatArray
from screwpose.errors import BehindSourceError, MeshError
from screwpose.geometry.camera import Camera
from screwpose.implants.parametric import make_screw
from screwpose.simulation.pathlength import path_length_mm, path_length_patch

SIZE = (160, 120)  # width, height
K = np.array([[400.0, 0.0, 79.0], [0.0, 410.0, 60.5], [0.0, 0.0, 1.0]])


def camera(rotation: FloatArray | None = None, depth_mm: float = 500.0) -> Camera:
    rotation = np.eye(3) if rotation is None else rotation
    return Camera.from_matrix(K @ np.column_stack([rotation, [0.0, 0.0, depth_mm]]), SIZE)


def triangles(body: trimesh.Trimesh) -> FloatArray:
    return np.asarray(body.vertices)[np.asarray(body.faces)]


def cast(view: Camera, corners: FloatArray, pixels: FloatArray) -> FloatArray:
    """Path length along the ray of each pixel: leaving distances minus entering ones."""
    a, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    source = view.center_in_world_mm
    lengths = []
    for direction in view.ray_directions_in_world(pixels):
        p = np.cross(direction, e2)
        determinant = np.einsum("ij,ij->i", e1, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("ij,ij->i", source - a, p) / determinant
            q = np.cross(source - a, e1)
            v = q @ direction / determinant
            t = np.einsum("ij,ij->i", e2, q) / determinant
            hit = (u >= 0) & (v >= 0) & (u + v <= 1)
        # The determinant is minus the direction along the face's normal: negative where the ray leaves.
        lengths.append(-np.sum(np.sign(determinant[hit]) * t[hit]))
    return np.array(lengths)


def grid(step: int = 1) -> FloatArray:
    v, u = np.mgrid[: SIZE[1] : step, : SIZE[0] : step]
    return np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)


def test_sphere_lies_between_its_inner_and_outer_radius():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=40.0)
    got = path_length_mm(camera(), triangles(sphere), SIZE, supersample=1).ravel()
    directions = camera().ray_directions_in_world(grid())
    offset = np.linalg.norm(np.cross(directions, -camera().center_in_world_mm), axis=1)
    inner_radius = np.min(np.einsum("ij,ij->i", sphere.face_normals, sphere.triangles[:, 0]))

    def chord(radius: float) -> FloatArray:
        return 2.0 * np.sqrt(np.maximum(radius**2 - offset**2, 0.0))

    assert (got <= chord(40.0) + 1e-9).all()
    assert (got >= chord(inner_radius) - 1e-9).all()
    assert got.max() > 79.5
    assert np.count_nonzero(got) > 1000


@pytest.mark.parametrize("tilt_deg", [0.0, 17.0, 42.0])
def test_slab_is_its_thickness_over_the_cosine(tilt_deg):
    slab = trimesh.creation.box((900.0, 900.0, 7.0))
    rotation = Rotation.from_euler("xyz", [tilt_deg, 5.0, 30.0], degrees=True).as_matrix()
    corners = triangles(slab) @ rotation.T
    got = path_length_mm(camera(), corners, SIZE, supersample=1).ravel()
    want = 7.0 / np.abs(camera().ray_directions_in_world(grid()) @ rotation[:, 2])
    np.testing.assert_allclose(got, want, atol=2e-9)


def test_cylinder_across_the_beam():
    cylinder = trimesh.creation.cylinder(radius=20.0, height=400.0, sections=720)
    turned = triangles(cylinder)[:, :, [2, 0, 1]]  # its axis along x, so along the columns
    got = path_length_mm(camera(), turned, SIZE, supersample=1)
    directions = camera().ray_directions_in_world(grid())
    across = directions[:, 1:]  # what of the ray is in the cylinder's section
    source = camera().center_in_world_mm[1:]
    b = across @ source
    aa = np.sum(across**2, axis=1)
    discriminant = b**2 - aa * (source @ source - 20.0**2)
    want = 2.0 * np.sqrt(np.maximum(discriminant, 0.0)) / aa
    # 720 corners: the section is up to 20 (1 - cos(pi / 720)) = 0.0002 mm inside the circle.
    well_inside = want > 8.0
    np.testing.assert_allclose(got.ravel()[well_inside], want[well_inside], atol=2e-3)
    assert well_inside.sum() > 2000


def test_screw_against_a_ray_caster():
    screw = make_screw().mesh
    rotation = Rotation.from_euler("xyz", [38.0, 65.0, -20.0], degrees=True).as_matrix()
    corners = (screw.vertices_mm - [0.0, 80.0, 0.0])[screw.faces]
    view = camera(rotation, depth_mm=400.0)
    got = path_length_mm(view, corners, SIZE, supersample=1)
    rng = np.random.default_rng(5)
    on_metal = np.argwhere(got > 0.0)[:, ::-1]
    pixels = np.concatenate([rng.choice(on_metal, 120, replace=False), rng.integers(0, SIZE, (30, 2))])
    want = cast(view, corners, pixels.astype(np.float64))
    np.testing.assert_allclose(got[pixels[:, 1], pixels[:, 0]], want, atol=1e-8)
    assert want.max() > 8.0


def test_left_handed_projection_mirrors_the_image():
    screw = make_screw().mesh
    corners = (screw.vertices_mm - [0.0, 80.0, 3.0])[screw.faces]
    mirrored = Camera(np.diag([-1.0, 1.0, 1.0]) @ camera().projection + np.outer([158.0, 0, 0], camera().projection[2]))
    assert not mirrored.is_right_handed
    got = path_length_mm(mirrored, corners, SIZE, supersample=1)
    np.testing.assert_allclose(got[:, 158::-1], path_length_mm(camera(), corners, SIZE, 1)[:, :159], atol=1e-9)
    assert got.max() > 5.0


def test_vertices_and_edges_exactly_on_samples():
    """Every vertex projects exactly to a pixel's centre, so that most samples inside lie on edges or vertices."""
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=9.0)
    u, v = np.round(np.asarray(sphere.vertices)[:, :2]).T
    depth = 1024.0 + 64.0 * np.round(np.asarray(sphere.vertices)[:, 2])
    vertices = np.column_stack([u * depth / 1024.0, v * depth / 1024.0, depth])
    exact = np.array([[1024.0, 0.0, 32.0, 0.0], [0.0, 1024.0, 32.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    view = Camera.from_matrix(exact, (64, 64))
    corners = vertices[np.asarray(sphere.faces)]
    got = path_length_mm(view, corners, (64, 64), supersample=1)  # an edge counted twice or never is refused as open
    rows, columns = np.nonzero(got)
    assert len(rows) > 200
    # The length is continuous but at vertical walls: a hair beside the edges the ray caster is sure of itself.
    around = [np.column_stack([columns, rows]) + 1e-6 * np.array(step) for step in ((1.0, 0.37), (-1.0, -0.37))]
    beside = np.array([cast(view, corners, pixels) for pixels in around])
    inside = (beside > 1.0).all(axis=0)
    assert inside.sum() > 150
    np.testing.assert_array_less(beside.min(axis=0)[inside] - 0.01, got[rows, columns][inside])
    np.testing.assert_array_less(got[rows, columns][inside], beside.max(axis=0)[inside] + 0.01)


def test_nested_and_overlapping_bodies():
    outer = trimesh.creation.box((60.0, 60.0, 60.0))
    cavity = trimesh.creation.box((20.0, 20.0, 20.0))
    hollow = np.concatenate([triangles(outer), triangles(cavity)[:, ::-1]])
    both = np.concatenate([triangles(outer), triangles(cavity)])
    alone, inner = (path_length_mm(camera(), triangles(body), SIZE) for body in (outer, cavity))
    np.testing.assert_allclose(path_length_mm(camera(), hollow, SIZE), alone - inner, atol=1e-9)
    np.testing.assert_allclose(path_length_mm(camera(), both, SIZE), alone + inner, atol=1e-9)
    assert inner.max() == pytest.approx(20.0, rel=1e-3)


def test_samples_are_spread_evenly_over_the_pixel():
    """Sub-sample (i, j) of 3 x 3 lies ((i - 1) / 3, (j - 1) / 3) px from the pixel's centre."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=30.0)
    offsets = [(i / 3.0, j / 3.0) for j in (-1, 0, 1) for i in (-1, 0, 1)]
    total = np.zeros(SIZE[::-1])
    for du, dv in offsets:
        shift = np.array([[1.0, 0.0, -du], [0.0, 1.0, -dv], [0.0, 0.0, 1.0]])
        total += path_length_mm(Camera(shift @ camera().projection), triangles(sphere), SIZE, supersample=1)
    np.testing.assert_allclose(path_length_mm(camera(), triangles(sphere), SIZE, supersample=3), total / 9, atol=1e-8)


def test_a_body_across_the_border_is_cut_by_it():
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=60.0)
    sphere.apply_translation((70.0, -50.0, 0.0))
    whole_size, move = (400, 400), np.array([[1.0, 0, 120.0], [0, 1.0, 120.0], [0, 0, 1.0]])
    whole = path_length_mm(Camera(move @ camera().projection), triangles(sphere), whole_size, supersample=2)
    got = path_length_mm(camera(), triangles(sphere), SIZE, supersample=2)
    np.testing.assert_allclose(got, whole[120:240, 120:280], atol=1e-8)
    assert np.count_nonzero(whole) > np.count_nonzero(got) > 500


def test_a_body_outside_the_image_leaves_it_empty():
    sphere = trimesh.creation.icosphere(radius=5.0)
    sphere.apply_translation((400.0, 0.0, 0.0))
    assert path_length_patch(camera(), triangles(sphere), SIZE).samples_mm.size == 0
    assert not path_length_mm(camera(), triangles(sphere), SIZE).any()


def test_behind_the_source_is_refused():
    box = trimesh.creation.box((20.0, 20.0, 1200.0))  # from 100 mm behind the source to 1100 before it
    with pytest.raises(BehindSourceError, match=r"faces reach to a depth of -100 mm: they are not in front of the"):
        path_length_mm(camera(), triangles(box), SIZE)


def test_an_open_mesh_is_refused():
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=30.0)
    with pytest.raises(
        MeshError, match=r"^\d+ rays do not leave the mesh as often as they enter it; expected a closed"
    ):
        path_length_mm(camera(), triangles(sphere)[5:], SIZE)


def test_a_mesh_inside_out_is_refused():
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=30.0)
    with pytest.raises(MeshError, match=r"^a path length of -5\d\.\d+ mm; expected .* the mesh is inside out\.$"):
        path_length_mm(camera(), triangles(sphere)[:, ::-1], SIZE)
