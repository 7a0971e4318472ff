"""Attenuation, detector and geometry against closed forms."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import screwpose.simulation
from screwpose._types import FloatArray
from screwpose.geometry.camera import Camera
from screwpose.implants.model import Mesh
from screwpose.simulation import CArm, Detector, carm_camera, rays, render, render_views, transmission
from screwpose.simulation.materials import (
    MATERIALS,
    MUSCLE,
    TITANIUM,
    energy_bins,
)
from screwpose.simulation.xray import Body, Layer

SIZE = (200, 160)
CARM = CArm(pixel_mm=1.5, image_size=SIZE)
AP = carm_camera(CARM, np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0]))
LAT = carm_camera(CARM, np.zeros(3), np.array([1.0, 0.1, 0.05]), np.array([0.0, 0.02, -1.0]), (3.0, -2.0))


def box(size_mm: tuple[float, float, float], at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    made = trimesh.creation.box(size_mm)
    return Mesh(np.asarray(made.vertices) + at_mm, np.asarray(made.faces, dtype=np.int64))


def sphere(radius_mm: float) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def behind(*layers: tuple[str, float]) -> float:
    """What comes through layers (material, mm) at 90 kV: the law of Beer and Lambert, energy by energy."""
    bins = energy_bins(90.0)
    integral = sum(MATERIALS[name].attenuation_per_mm_in(bins) * length for name, length in layers)
    return float(bins.weights @ np.exp(-integral))


def centroid(weights: FloatArray) -> FloatArray:
    """(u, v) of the centre of gravity, integer pixel centres."""
    v, u = np.indices(weights.shape)
    return np.array([(u * weights).sum(), (v * weights).sum()]) / weights.sum()


def test_simulator_shares_nothing_with_the_solver():
    folder = Path(screwpose.simulation.__file__).parent
    solver = ("projection", "similarity", "registration", "pairing", "solve")
    imported = set()
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                imported.update(f"{node.module}.{name.name}" for name in node.names)
            elif isinstance(node, ast.Import):
                imported.update(name.name for name in node.names)
    assert any(name.startswith("screwpose.geometry") for name in imported)  # the search can find
    assert not [name for name in imported if name.startswith(tuple(f"screwpose.{part}" for part in solver))]


def test_public_names_are_there():
    for name in screwpose.simulation.__all__:
        assert getattr(screwpose.simulation, name).__class__ is not None


def test_carm_camera_puts_isocenter_and_source_where_asked():
    np.testing.assert_allclose(AP.project(np.zeros(3)), [99.5, 79.5], atol=1e-10)  # the centre of 200 x 160 pixels
    np.testing.assert_allclose(LAT.project(np.zeros(3)), [102.5, 77.5], atol=1e-10)
    np.testing.assert_allclose(AP.center_in_world_mm, [0.0, -650.0, 0.0], atol=1e-9)
    # Seen from the front: the patient's left (x) is right in the image, the head (z) is up; magnified 1000 / 650.
    step_px = 10.0 * (1000.0 / 650.0) / 1.5
    np.testing.assert_allclose(AP.project(np.array([10.0, 0.0, 0.0])), [99.5 + step_px, 79.5], atol=1e-9)
    np.testing.assert_allclose(AP.project(np.array([0.0, 0.0, 10.0])), [99.5, 79.5 - step_px], atol=1e-9)
    assert AP.is_right_handed
    assert LAT.is_right_handed


@pytest.mark.parametrize("camera", [AP, LAT], ids=["AP", "LAT"])
@pytest.mark.parametrize("at_mm", [(0.0, 0.0, 0.0), (31.3, -20.7, 24.9), (-40.2, 33.3, -30.1)])
def test_a_small_ball_is_seen_where_the_projection_says(camera, at_mm):
    """Catches a shift by half a pixel between P and the image: (0, 0) is the CENTRE of the top-left pixel."""
    pose = np.eye(4)
    pose[:3, 3] = at_mm
    ball = Body(sphere(2.5), MATERIALS["steel"], world_from_body=pose)
    detector = Detector(
        image_size=SIZE, supersample=7, scatter_fraction=0.0, counts_per_px=1e9, electronic_noise=0.0, bits=16
    )
    seen = render(camera, [ball], detector, np.random.default_rng(1))
    want = camera.project(np.array(at_mm))
    assert np.linalg.norm(centroid(1.0 - seen.transmission) - want) < 0.03
    # The beam falls off towards the corners: compare with what is beside the ball.
    u, v = np.round(want).astype(int)
    dark = np.median(seen.pixels[v - 8 : v + 9, u - 8 : u + 9]) - seen.pixels[v - 6 : v + 7, u - 6 : u + 7].astype(
        float
    )
    assert np.linalg.norm(centroid(np.maximum(dark, 0.0)) + [u - 6, v - 6] - want) < 0.05


def test_a_slab_obeys_beer_and_lambert():
    slab = Body(box((900.0, 4.0, 900.0)), TITANIUM)
    got = transmission(AP, [slab], SIZE)
    cosine = AP.ray_directions_in_world(np.array([[20.0, 30.0]]))[0, 1]
    # The mean over a pixel's rays is that of its middle but for curvature.
    assert got[30, 20] == pytest.approx(behind(("titanium", 4.0 / cosine)), rel=1e-5)
    assert 0.1 < got[30, 20] < 0.25


def test_titanium_hardens_the_beam():
    first, last = -np.log(behind(("titanium", 1.0))), -np.log(behind(("titanium", 20.0))) / 20.0
    assert first > 1.8 * last > 0.3


def test_rays_average_after_the_exponential():
    """A wall covers the left third of a pixel's rays, another one the right third: no ray crosses both."""
    v, u = 80, 100
    # Far-away thin walls would need exact edges; a wall's edge planes pass the source, so it is cut sharply.
    edges = [AP.ray_directions_in_world(np.array([[u + du, 79.5]]))[0] for du in (-1 / 6, 1 / 6)]
    source = AP.center_in_world_mm

    def wedge(left: FloatArray, right: FloatArray) -> Mesh:
        corners = [
            source + d / d[1] * y + [0.0, 0.0, z] for y in (640.0, 650.0) for z in (-60.0, 60.0) for d in (left, right)
        ]
        hull = trimesh.convex.convex_hull(np.array(corners))
        return Mesh(np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64))

    far_left, far_right = (AP.ray_directions_in_world(np.array([[u + du, 79.5]]))[0] for du in (-30.0, 30.0))
    left, right = Body(wedge(far_left, edges[0]), TITANIUM), Body(wedge(edges[1], far_right), TITANIUM)
    one, two = (transmission(AP, bodies, SIZE, 3)[v, u] for bodies in ([left], [left, right]))
    full = transmission(AP, [left], SIZE, 3)[v, u - 5]
    assert full == pytest.approx(behind(("titanium", 10.0)), rel=0.01)
    assert one == pytest.approx((2.0 + full) / 3.0, rel=1e-3)
    assert two == pytest.approx((1.0 + 2.0 * full) / 3.0, rel=1e-3)


def test_metal_in_tissue_replaces_it():
    tissue = [
        Body(box((300.0, 100.0, 300.0)), MUSCLE, sharp=False, layer=Layer.MUSCLE),
        Body(box((120.0, 40.0, 120.0)), MATERIALS["cortical bone"], sharp=False, layer=Layer.CORTEX),
    ]
    # 20 mm of metal: half of them in the bone, half in the muscle behind it.
    metal = box((30.0, 20.0, 30.0), (0.0, 20.0, 0.0))
    got = transmission(AP, [*tissue, Body(metal, TITANIUM, layer=Layer.IMPLANT)], SIZE)[80, 100]
    want = behind(("titanium", 20.0), ("muscle", 50.0), ("cortical bone", 30.0))
    assert got == pytest.approx(want, rel=1e-4)
    counted_twice = behind(("titanium", 20.0), ("muscle", 100.0), ("cortical bone", 40.0))
    assert counted_twice < 0.8 * want


def test_views_side_by_side_are_those_one_by_one():
    moved = np.eye(4)
    moved[:3, 3] = [4.0, -3.0, 2.0]
    still = [Body(sphere(30.0), MUSCLE, sharp=False, texture=0.1), Body(box((9.0, 9.0, 9.0)), TITANIUM, layer=90)]
    after = [replace(body, world_from_body=moved) for body in still]
    detector, cameras, bodies = Detector(image_size=SIZE), {"AP": AP, "LAT": LAT}, {"AP": still, "LAT": after}
    together = render_views(cameras, bodies, detector, {name: np.random.default_rng(7) for name in cameras})
    for name, camera in cameras.items():
        alone = render(camera, bodies[name], detector, np.random.default_rng(7))
        assert together[name].pixels.tobytes() == alone.pixels.tobytes()
    unmoved = render_views(cameras, still, detector, {name: np.random.default_rng(7) for name in cameras})
    assert unmoved["AP"].pixels.tobytes() == together["AP"].pixels.tobytes()
    assert unmoved["LAT"].pixels.tobytes() != together["LAT"].pixels.tobytes()


def test_tissues_sampled_once_a_pixel_agree_with_full_sampling():
    ball = Body(sphere(40.0), MUSCLE)
    fine, coarse = (transmission(AP, [replace(ball, sharp=sharp)], SIZE, 5) for sharp in (True, False))
    assert np.abs(fine - coarse).max() < 0.1  # at the rim, in open air
    assert np.abs(fine - coarse).mean() < 5e-4
    assert fine.min() < 0.25


def test_texture_varies_the_density_about_its_mean():
    """A slab thinner than its grains shows the density itself; one of many grains averages them."""
    thin, thick = (
        Body(box((900.0, depth, 900.0)), MUSCLE, sharp=False, texture=0.1, texture_mm=8.0) for depth in (0.5, 80.0)
    )
    spread = []
    for slab in (thin, thick):
        plain = -np.log(transmission(AP, [slab], SIZE, textured=False))
        grainy = -np.log(transmission(AP, [slab], SIZE)) / plain - 1.0
        assert abs(grainy.mean()) < 0.02
        spread.append(grainy.std())
        beside = np.mean(grainy[:, 1:] * grainy[:, :-1]) / grainy.var()
        far = np.mean(grainy[:, 60:] * grainy[:, :-60]) / grainy.var()
        assert beside > 0.7 > 0.25 > abs(far)
    assert spread[0] == pytest.approx(0.1, rel=0.1)
    assert 0.2 < spread[1] / spread[0] < 0.6


def test_coarse_grains_may_be_interpolated(monkeypatch):
    """Grains of 8 px, read on every third pixel, are those read on every pixel; so is what metal leaves of them."""
    bodies = [
        Body(box((900.0, 60.0, 900.0)), MUSCLE, sharp=False, texture=0.1, texture_mm=8.0),
        Body(box((40.0, 20.0, 40.0)), TITANIUM, layer=Layer.IMPLANT),
    ]
    even = transmission(AP, bodies, SIZE, textured=False)
    mapped = transmission(AP, bodies, SIZE)
    monkeypatch.setattr(rays, "_MAP_STEP_PX", 1000)  # coarser than any grain: none is mapped
    marched = transmission(AP, bodies, SIZE)
    contrast = np.log(marched / even)
    assert contrast.std() > 0.01
    assert np.log(mapped / marched).std() < 0.08 * contrast.std()
    assert (mapped != marched).any()


def test_both_views_see_the_same_grains():
    """The same body from two sides: a view turned with the body shows the same, one of a still body does not."""
    slab = Body(box((200.0, 3.0, 200.0)), MUSCLE, sharp=False, texture=0.2, texture_mm=6.0)
    turn = np.eye(4)
    turn[:3, :3] = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    from_the_side = carm_camera(CARM, np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]))
    front = transmission(AP, [slab], SIZE)
    turned = transmission(from_the_side, [replace(slab, world_from_body=turn)], SIZE)
    np.testing.assert_allclose(turned, front, rtol=1e-5)
    from_behind = carm_camera(CARM, np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0]))
    middle = (slice(40, 120), slice(50, 150))
    behind_it = transmission(from_behind, [slab], SIZE)[:, ::-1][middle]
    alike, other = (
        np.corrcoef(front[middle].ravel(), image.ravel())[0, 1]
        for image in (behind_it, transmission(AP, [replace(slab, texture_seed=9)], SIZE)[middle])
    )
    assert alike > 0.95
    assert abs(other) < 0.3


def test_the_beam_falls_off_with_the_cube_of_the_cosine():
    detector = Detector(
        image_size=SIZE, counts_per_px=1e9, electronic_noise=0.0, bits=16, display="log", log_decades=2.0
    )
    seen = render(AP, [], detector, np.random.default_rng(0)).pixels / 65535.0
    signal = 10.0 ** (2.0 * seen)  # the grey is linear in its logarithm at and below the reference
    cosine = AP.ray_directions_in_world(np.array([[0.0, 0.0]]))[0, 1]
    assert signal[0, 0] / signal[80, 100] == pytest.approx(cosine**3, rel=2e-3)
    assert cosine**3 < 0.97


def test_same_generator_same_bytes():
    ball = Body(sphere(30.0), MUSCLE, sharp=False, texture=0.05)
    first, again, other = (
        render(AP, [ball], Detector(image_size=SIZE), np.random.default_rng(seed)).pixels for seed in (4, 4, 5)
    )
    assert first.tobytes() == again.tobytes()
    assert np.mean(first != other) > 0.1


def test_a_camera_without_skew_or_with():
    """Any P, not only that of a C-arm: skewed pixels and all."""
    skewed = Camera(np.array([[1.0, 0.1, -5.0], [0.0, 1.1, 2.0], [0.0, 0.0, 1.0]]) @ AP.projection)
    pose = np.eye(4)
    pose[:3, 3] = [12.0, 5.0, -9.0]
    got = transmission(skewed, [Body(sphere(4.0), TITANIUM, world_from_body=pose)], SIZE)
    assert np.linalg.norm(centroid(1.0 - got) - skewed.project(pose[:3, 3])) < 0.02
