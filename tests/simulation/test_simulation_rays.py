"""Rays through many bodies against closed forms, the plain twin, a ray caster, and winding numbers of open screws."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from screwpose._types import FloatArray
from screwpose.errors import BehindSourceError, MeshError
from screwpose.geometry.camera import Camera
from screwpose.implants.closing import closed_mesh
from screwpose.implants.mesh import read_mesh
from screwpose.implants.model import Mesh
from screwpose.implants.parametric import make_screw
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.materials import MATERIALS, MUSCLE, TITANIUM
from screwpose.simulation.pathlength import path_length_mm
from screwpose.simulation.rays import material_lengths_mm
from tests.data import shared_data

SIZE = (160, 120)  # width, height
K = np.array([[400.0, 0.0, 79.0], [0.0, 410.0, 60.5], [0.0, 0.0, 1.0]])
BONE = MATERIALS["cortical bone"]


def camera(rotation: FloatArray | None = None, depth_mm: float = 500.0) -> Camera:
    rotation = np.eye(3) if rotation is None else rotation
    return Camera.from_matrix(K @ np.column_stack([rotation, [0.0, 0.0, depth_mm]]), SIZE)


def mesh(made: trimesh.Trimesh, at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    return Mesh(np.asarray(made.vertices) + at_mm, np.asarray(made.faces, dtype=np.int64))


def joined(*meshes: Mesh) -> Mesh:
    first = np.cumsum([0, *(len(m.vertices_mm) for m in meshes)])
    faces = [m.faces + start for m, start in zip(meshes, first, strict=False)]
    return Mesh(np.concatenate([m.vertices_mm for m in meshes]), np.concatenate(faces))


def turned(m: Mesh) -> Mesh:
    return Mesh(m.vertices_mm, m.faces[:, ::-1])


def box(size_mm: float, at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    return mesh(trimesh.creation.box((size_mm, size_mm, size_mm)), at_mm)


def ball(radius_mm: float, at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    return mesh(trimesh.creation.icosphere(subdivisions=5, radius=radius_mm), at_mm)


def lengths(*bodies: Body, view: Camera | None = None, supersample: int = 1) -> dict[str, FloatArray]:
    return material_lengths_mm(camera() if view is None else view, bodies, SIZE, supersample)


def grid() -> FloatArray:
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    return np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)


def span(radius_mm: float, at_mm: tuple[float, float, float]) -> tuple[FloatArray, FloatArray]:
    """Where the ray of each pixel enters and leaves a sphere, mm from the source; equal where it misses."""
    directions, source = camera().ray_directions_in_world(grid()), camera().center_in_world_mm
    middle = directions @ (np.array(at_mm) - source)
    half = np.sqrt(np.maximum(radius_mm**2 - np.sum((np.array(at_mm) - source) ** 2) + middle**2, 0.0))
    return (middle - half).reshape(SIZE[::-1]), (middle + half).reshape(SIZE[::-1])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("supersample", [1, 3])
def test_one_closed_body_is_that_of_the_plain_twin(seed, supersample):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=rng).as_matrix()
    screw = Mesh(make_screw().mesh.vertices_mm - [0.0, 80.0, 0.0], make_screw().mesh.faces)
    pose = np.eye(4)
    pose[:3, 3] = rng.uniform(-20.0, 20.0, 3)
    body = Body(screw, TITANIUM, pose, sharp=supersample > 1)
    view = camera(rotation, depth_mm=rng.uniform(300.0, 600.0))
    want = path_length_mm(view, body.triangles_in_world_mm, SIZE, supersample)
    got = lengths(body, view=view, supersample=supersample)["titanium"]
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=2e-9)
    assert want.max() > 5.0
    assert np.count_nonzero(want) > 200


def test_left_handed_projection():
    screw = Body(make_screw().mesh, TITANIUM)
    mirrored = Camera(np.diag([-1.0, 1.0, 1.0]) @ camera().projection + np.outer([158.0, 0, 0], camera().projection[2]))
    got = lengths(screw, view=mirrored)["titanium"]
    np.testing.assert_allclose(got[:, 158::-1], lengths(screw)["titanium"][:, :159], atol=1e-9)
    assert got.max() > 5.0


def test_nested_spheres_of_two_materials():
    """20,480 faces: their planes lie up to 0.03 mm within a sphere of 40 mm, so chords well inside are short by 0.1."""
    near, far = span(40.0, (0.0, 0.0, 0.0))
    near_inner, far_inner = span(15.0, (6.0, -4.0, 9.0))
    got = lengths(
        Body(ball(15.0, (6.0, -4.0, 9.0)), TITANIUM, layer=Layer.IMPLANT),  # the order in the list does not count
        Body(ball(40.0), MUSCLE, layer=Layer.MUSCLE),
    )
    inside = (far - near > 20.0) & ((far_inner - near_inner > 5.0) | (far_inner == near_inner))
    np.testing.assert_allclose(got["titanium"][inside], (far_inner - near_inner)[inside], atol=0.15)
    np.testing.assert_allclose(got["muscle"][inside], (far - near - far_inner + near_inner)[inside], atol=0.2)
    assert np.count_nonzero((far_inner - near_inner)[inside]) > 200


def test_overlapping_spheres_share_by_layer():
    near_a, far_a = span(35.0, (0.0, 0.0, -15.0))
    near_b, far_b = span(30.0, (10.0, 0.0, 20.0))
    shared = np.maximum(np.minimum(far_a, far_b) - np.maximum(near_a, near_b), 0.0)
    inside = (far_a - near_a > 15.0) & (far_b - near_b > 15.0)
    a, b = ball(35.0, (0.0, 0.0, -15.0)), ball(30.0, (10.0, 0.0, 20.0))
    bone_counts = lengths(Body(b, BONE, layer=Layer.CORTEX), Body(a, MUSCLE, layer=Layer.MUSCLE))
    np.testing.assert_allclose(bone_counts["cortical bone"][inside], (far_b - near_b)[inside], atol=0.2)
    np.testing.assert_allclose(bone_counts["muscle"][inside], (far_a - near_a - shared)[inside], atol=0.3)
    # Within a layer the later one counts.
    later = lengths(Body(b, BONE), Body(a, MUSCLE))
    np.testing.assert_allclose(later["muscle"][inside], (far_a - near_a)[inside], atol=0.2)
    np.testing.assert_allclose(later["cortical bone"][inside], (far_b - near_b - shared)[inside], atol=0.3)
    assert shared[inside].max() > 20.0


def test_slab_and_cylinder_within_each_other():
    """A titanium rod of 720 corners across a tilted slab of muscle: lengths are the thickness over the cosine."""
    rotation = Rotation.from_euler("xyz", [31.0, 5.0, 30.0], degrees=True).as_matrix()
    slab = mesh(trimesh.creation.box((900.0, 900.0, 40.0)))
    pose = np.eye(4)
    pose[:3, :3] = rotation
    directions = camera().ray_directions_in_world(grid())
    thickness = (40.0 / np.abs(directions @ rotation[:, 2])).reshape(SIZE[::-1])
    rod = trimesh.creation.cylinder(radius=5.0, height=300.0, sections=720)
    across = directions @ rotation[:, :2]  # the rod stands along the slab's y, in its middle
    source = camera().center_in_world_mm @ rotation
    flat = np.column_stack([across[:, 0], directions @ rotation[:, 2]])
    b, aa, cc = flat @ source[[0, 2]], np.sum(flat**2, axis=1), source[[0, 2]] @ source[[0, 2]] - 25.0
    chord = (2.0 * np.sqrt(np.maximum(b**2 - aa * cc, 0.0)) / aa).reshape(SIZE[::-1])
    lying = Mesh(np.asarray(rod.vertices)[:, [1, 2, 0]], np.asarray(rod.faces, dtype=np.int64))
    got = lengths(Body(slab, MUSCLE, pose, layer=Layer.MUSCLE), Body(lying, TITANIUM, pose, layer=Layer.IMPLANT))
    clear = (chord > 2.0) | (chord == 0.0)
    np.testing.assert_allclose(got["titanium"][clear], chord[clear], atol=2e-3)
    np.testing.assert_allclose(got["muscle"][clear], (thickness - chord)[clear], atol=2e-3)
    assert np.count_nonzero(chord > 2.0) > 500


def test_a_knot_against_trimesh():
    """trimesh's own intersections, of a body that is neither convex nor made here, in a box that it pierces."""
    knot = trimesh.creation.torus(major_radius=22.0, minor_radius=8.0, major_sections=40, minor_sections=18)
    knot.apply_transform(trimesh.transformations.rotation_matrix(1.1, (1.0, 0.4, 0.2)))
    source = camera().center_in_world_mm
    rng = np.random.default_rng(3)
    pixels = np.column_stack([rng.integers(50, 110, 300), rng.integers(35, 90, 300)])
    directions = camera().ray_directions_in_world(pixels.astype(np.float64))
    want = np.zeros(len(pixels))
    for index, direction in enumerate(directions):
        # Planes of all faces at once; barycentric coordinates by trimesh.
        facing = knot.face_normals @ direction
        distance = np.einsum("ij,ij->i", knot.face_normals, knot.triangles[:, 0] - source) / facing
        at = source + distance[:, None] * direction
        inside = (trimesh.triangles.points_to_barycentric(knot.triangles, at, method="cross") >= 0.0).all(axis=1)
        want[index] = np.sum(np.sign(facing[inside]) * distance[inside])
    got = lengths(Body(mesh(knot), BONE))["cortical bone"]
    np.testing.assert_allclose(got[pixels[:, 1], pixels[:, 0]], want, atol=1e-8)
    assert np.count_nonzero(want) > 100
    assert want.max() > 15.0


def test_pieces_of_one_body_that_overlap_count_once():
    a, b = box(30.0), box(30.0, (10.0, 0.0, 10.0))
    both = lengths(Body(joined(a, b), TITANIUM))["titanium"]
    apart = lengths(Body(a, TITANIUM), Body(b, TITANIUM))["titanium"]
    np.testing.assert_allclose(both, apart, atol=1e-9)
    assert both[60, 85] == pytest.approx(40.0, rel=1e-3)  # not 60


def test_cavity_is_empty():
    hollow = joined(box(60.0), turned(box(20.0)))
    alone, inner = (lengths(Body(m, BONE))["cortical bone"] for m in (box(60.0), box(20.0)))
    np.testing.assert_allclose(lengths(Body(hollow, BONE))["cortical bone"], alone - inner, atol=1e-9)
    assert inner.max() == pytest.approx(20.0, rel=1e-3)


def test_a_mesh_inside_out_as_a_whole_is_turned():
    screw = make_screw().mesh
    np.testing.assert_array_equal(
        lengths(Body(turned(screw), TITANIUM))["titanium"], lengths(Body(screw, TITANIUM))["titanium"]
    )
    hollow = joined(box(60.0), turned(box(20.0)))
    assert lengths(Body(turned(hollow), BONE))["cortical bone"].max() > 60.0


def test_open_boxes_are_closed_where_a_face_is_missing():
    whole = box(40.0)
    normals = np.cross(*np.moveaxis(np.diff(whole.triangles_mm, axis=1), 1, 0))
    lidless = Mesh(whole.vertices_mm, whole.faces[normals[:, 0] < 500.0])
    assert len(lidless.faces) == 10
    for rotation in (np.eye(3), Rotation.from_euler("xyz", [20.0, 50.0, 10.0], degrees=True).as_matrix()):
        np.testing.assert_allclose(
            lengths(Body(lidless, TITANIUM), view=camera(rotation))["titanium"],
            lengths(Body(whole, TITANIUM), view=camera(rotation))["titanium"],
            atol=1e-8,
        )
    # A soup of triangles, each with corners of its own, as an STL file lists them.
    soup = Mesh(lidless.triangles_mm.reshape(-1, 3), np.arange(30).reshape(10, 3))
    np.testing.assert_allclose(
        lengths(Body(soup, TITANIUM))["titanium"], lengths(Body(whole, TITANIUM))["titanium"], atol=1e-8
    )


def solid_angle_winding(triangles: FloatArray, points: FloatArray) -> FloatArray:
    """The generalised winding number (Jacobson et al. 2013): the solid angle that faces are seen under, over 4 pi."""
    result = np.zeros(len(points))
    for index, point in enumerate(points):
        a, b, c = np.moveaxis(triangles - point, 1, 0)
        la, lb, lc = (np.sqrt(np.einsum("ij,ij->i", v, v)) for v in (a, b, c))
        ab, bc, ca = (np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a)))
        triple = np.einsum("ij,ij->i", a, np.cross(b, c))
        result[index] = np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum() / (2.0 * np.pi)
    return result


@pytest.mark.parametrize("name", ["scaled_475x30.stl", "scaled_700x50.stl"])
def test_real_screws_that_are_open(name):
    """None of these files is closed. In what an open mesh encloses its winding number is near 1, elsewhere near 0."""
    screw = read_mesh(shared_data(f"screws_lassoan/{name}"))
    assert not trimesh.Trimesh(screw.vertices_mm, screw.faces).is_watertight
    middle = 0.5 * (screw.vertices_mm.min(axis=0) + screw.vertices_mm.max(axis=0))
    screw = Mesh(screw.vertices_mm - middle, screw.faces)
    rotation = Rotation.from_euler("xyz", [25.0, 70.0, 15.0], degrees=True).as_matrix()
    view = camera(rotation, depth_mm=220.0)
    got = lengths(Body(screw, TITANIUM), view=view)["titanium"]
    rng = np.random.default_rng(11)
    on_metal = np.argwhere(got > 0.5)[:, ::-1]
    pixels = rng.choice(on_metal, 14, replace=False)
    step = 0.1
    worst = []
    for (u, v), direction in zip(pixels, view.ray_directions_in_world(pixels.astype(np.float64)), strict=True):
        along = 220.0 + np.arange(-16.0, 16.0, step) + 0.5 * step
        points = view.center_in_world_mm + along[:, None] * direction
        inside = solid_angle_winding(screw.triangles_mm, points) > 0.5
        worst.append(abs(inside.sum() * step - got[v, u]))
    assert max(worst) < 0.3
    assert np.median(worst) < 0.1
    assert 4.0 < got.max() < 32.0


def test_rays_exactly_through_vertices_and_edges():
    """Every vertex projects exactly to a pixel's centre; the twin, which refuses what is counted twice, agrees."""
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=9.0)
    u, v = np.round(np.asarray(sphere.vertices)[:, :2]).T
    depth = 1024.0 + 64.0 * np.round(np.asarray(sphere.vertices)[:, 2])
    vertices = np.column_stack([u * depth / 1024.0, v * depth / 1024.0, depth])
    exact = np.array([[1024.0, 0.0, 32.0, 0.0], [0.0, 1024.0, 32.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    view = Camera.from_matrix(exact, (64, 64))
    body = Body(Mesh(vertices, np.asarray(sphere.faces, dtype=np.int64)), BONE)
    got = material_lengths_mm(view, [body], (64, 64))["cortical bone"]
    want = path_length_mm(view, body.triangles_in_world_mm, (64, 64), 1)
    np.testing.assert_allclose(got, want, atol=1e-9)
    assert np.count_nonzero(want) > 200


def test_sharp_metal_in_tissue_sampled_once_a_pixel():
    """The tissue's crossings are those of the pixel's centre; its length net of metal is exact but for curvature."""
    tissue, metal = ball(40.0), box(12.0, (3.0, 2.0, 1.0))
    fine = lengths(Body(tissue, MUSCLE), Body(metal, TITANIUM, layer=Layer.IMPLANT), supersample=3)
    mixed = lengths(Body(tissue, MUSCLE, sharp=False), Body(metal, TITANIUM, layer=Layer.IMPLANT), supersample=3)
    np.testing.assert_allclose(mixed["titanium"], fine["titanium"], atol=1e-9)
    inside = fine["muscle"] > 40.0
    np.testing.assert_allclose(mixed["muscle"][inside], fine["muscle"][inside], atol=0.05)
    # Some pixels are metal in part: there the mean is of rays with and without.
    assert np.count_nonzero((fine["titanium"] > 1.0) & (fine["titanium"] < 10.0)) > 20


def test_many_crossings_are_sorted():
    """A pile of 120 plates in no order: 240 crossings a ray, which insertion alone would sort slowly."""
    order = np.random.default_rng(2).permutation(120)
    plates = joined(*(mesh(trimesh.creation.box((30.0, 30.0, 0.5)), (0.0, 0.0, float(z) - 60.0)) for z in order))
    got = lengths(Body(plates, TITANIUM), Body(box(140.0), MUSCLE, layer=Layer.FAT))
    assert lengths(Body(box(140.0), MUSCLE), Body(plates, TITANIUM))["titanium"][60, 79] == pytest.approx(60.0, 1e-4)
    assert got["muscle"][60, 79] == pytest.approx(140.0, rel=1e-4)
    assert not got["titanium"][60, 79]


def test_nothing_in_the_beam():
    assert lengths() == {}
    away = lengths(Body(box(5.0, (400.0, 0.0, 0.0)), BONE))
    assert not away["cortical bone"].any()


def test_behind_the_source_is_refused():
    long = mesh(trimesh.creation.box((20.0, 20.0, 1200.0)))
    with pytest.raises(
        BehindSourceError, match=r"^a body of titanium \(12 faces\) reaches to a depth of -100 mm: it is"
    ):
        lengths(Body(long, TITANIUM))


@pytest.mark.parametrize(
    ("damaged", "text"),
    [
        (Mesh(box(9.0).vertices_mm, np.zeros((0, 3), dtype=np.int64)), r"^a mesh without faces; expected triangles"),
        (
            Mesh(np.where(box(9.0).vertices_mm > 4.0, np.nan, 1.0), box(9.0).faces),
            r"^7 of 8 vertices are not finite; expected coordinates in mm",
        ),
        (Mesh(box(9.0).vertices_mm, box(9.0).faces + 1), r"faces name a vertex that is not there; expected indices"),
        (
            Mesh(box(9.0).vertices_mm, np.concatenate([box(9.0).faces[:1, ::-1], box(9.0).faces[1:]])),
            r"^neighbouring faces disagree about the outside at 3 of 18 edges; .* Unify the faces' orientation",
        ),
        (
            joined(box(9.0), turned(box(5.0, (30.0, 0.0, 0.0)))),
            r"^a piece of 12 of the 24 faces is inside out, the others are not; .* Turn that piece round",
        ),
        (
            Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [2, 1, 3]])),
            r"^a mesh of 6 faces that encloses no volume \(0 mm\^3\); expected a body, not a sheet",
        ),
    ],
    ids=["empty", "nan", "index", "orientation", "piece", "sheet"],
)  # fmt: skip
def test_damaged_meshes_are_refused_by_name(damaged, text):
    with pytest.raises(MeshError, match=text):
        closed_mesh(damaged)


def test_importing_the_simulator_stays_cheap():
    """numba takes a second to import: only what traces rays pays for it."""
    code = "import sys, screwpose.simulation.scenes; sys.exit('numba' in sys.modules or 'nibabel' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
