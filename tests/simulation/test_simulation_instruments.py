"""Instruments: of the size they say, closed, beside the screws and not over them."""

import numpy as np
import pytest
import trimesh

from screwpose._types import FloatArray
from screwpose.implants.design import ScrewDesign
from screwpose.implants.model import Implant, Mesh
from screwpose.implants.parametric import make_screw
from screwpose.simulation import instruments_meshes as meshes
from screwpose.simulation import solids
from screwpose.simulation.bodies import Body, Layer
from screwpose.simulation.instruments import KeepOut, keep_out_of, random_clutter
from screwpose.simulation.needles import needle_along

ALL = {
    "k_wire": meshes.k_wire,
    "rod": meshes.rod,
    "jamshidi_needle": meshes.jamshidi_needle,
    "retractor_blade": meshes.retractor_blade,
    "tubular_retractor": meshes.tubular_retractor,
    "haemostat": meshes.haemostat,
    "towel_clamp": meshes.towel_clamp,
    "wound_hook": meshes.wound_hook,
}
# Two screws of one level with 90 mm towers, converging by 15 degrees: tip, direction, radius.
SCREWS = [
    (np.array([side * 6.0, 0.0, 3.0]), np.array([side * np.sin(0.26), np.cos(0.26), 0.05]), 8.0) for side in (1.0, -1.0)
]


def volume(mesh: Mesh) -> float:
    return float(trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).volume)


def in_world(body: Body) -> Mesh:
    return Mesh(body.vertices_in_world_mm, body.mesh.faces)


@pytest.mark.parametrize("name", ALL)
def test_instruments_are_closed_and_light(name):
    made = ALL[name]()
    assert solids.solid(made).volume() == pytest.approx(volume(made))
    assert volume(made) > 100.0
    assert len(made.faces) < 4000


def test_k_wire_is_a_cylinder_with_a_point():
    made = meshes.k_wire(250.0, 2.0)
    np.testing.assert_allclose(np.ptp(made.vertices_mm, axis=0), [2.0, 2.0, 250.0], atol=0.02)
    # 245 mm of a cylinder of 1 mm radius, and a cone of 5 mm; 24 corners have 1.1 % less.
    by_hand = np.pi * (245.0 + 5.0 / 3.0)
    assert volume(made) == pytest.approx(by_hand, rel=0.02)
    assert np.linalg.norm(made.vertices_mm[made.vertices_mm[:, 2] == 0.0][:, :2], axis=1).max() < 0.1


@pytest.mark.parametrize("bend", [None, 120.0])
def test_rod_has_its_length_diameter_and_weight(bend):
    made = meshes.rod(80.0, 5.5, bend)
    # Along the rod: blunt cones take a quarter of the diameter at each end.
    by_hand = np.pi * 2.75**2 * (80.0 - 2.75) + 2 * np.pi * 2.75**2 * (0.25 * 5.5) / 3.0
    assert volume(made) == pytest.approx(by_hand, rel=0.01)
    if bend is None:
        np.testing.assert_allclose(np.ptp(made.vertices_mm, axis=0), [5.5, 5.5, 80.0], atol=0.06)
    else:
        # The blunt ends' points: the arc's sagitta, r (1 - cos a), and on along the tangent.
        angle = 0.5 * (80.0 - 2.75) / 120.0
        by_hand_y = 120.0 * (1.0 - np.cos(angle)) + 0.25 * 5.5 * np.sin(angle)
        by_hand_z = 120.0 * np.sin(angle) + 0.25 * 5.5 * np.cos(angle)
        np.testing.assert_allclose(made.vertices_mm[-2:, 1], by_hand_y, atol=0.05)
        np.testing.assert_allclose(np.abs(made.vertices_mm[-2:, 2]), by_hand_z, atol=0.05)


def test_tube_and_needle_are_hollow():
    tube = meshes.tubular_retractor(60.0, 22.0, 0.8)
    middle = solids.solid(tube).slice(30.0)
    assert middle.area() == pytest.approx(np.pi * (11.0**2 - 10.2**2), rel=0.02)
    needle = solids.solid(meshes.jamshidi_needle(130.0, 4.0, 0.4)).slice(60.0)
    stylet = np.pi * (0.6 * 1.6) ** 2
    assert needle.area() == pytest.approx(np.pi * (2.0**2 - 1.6**2) + stylet, rel=0.02)


def test_blade_is_as_wide_and_thick_as_asked():
    made = solids.solid(meshes.retractor_blade(80.0, 20.0, 1.5))
    section = made.slice(40.0)
    assert section.area() == pytest.approx(20.0 * 1.5, rel=0.02)
    low, _, high, _ = section.bounds()
    assert high - low == pytest.approx(20.0)


def test_clutter_keeps_off_the_screws_and_off_itself():
    seen = 0
    for seed in range(5):
        bodies = random_clutter(np.random.default_rng(seed), SCREWS, 6)
        assert 3 <= len(bodies) <= 6
        seen += len(bodies)
        made = [solids.solid(in_world(body)) for body in bodies]
        for tip, direction, radius in SCREWS:
            direction = direction / np.linalg.norm(direction)
            for body in bodies:
                # Points on the surface against the screw's axis, apart from how the clutter itself measures.
                points, _ = trimesh.sample.sample_surface(
                    trimesh.Trimesh(body.vertices_in_world_mm, body.mesh.faces, process=False), 2000, seed=0
                )
                along = np.clip((points - tip) @ direction, 0.0, 220.0)
                distance = np.linalg.norm(points - tip - along[:, None] * direction, axis=1)
                assert distance.min() > radius + 0.9
        for first in range(len(made)):
            for second in range(first):
                assert made[first].min_gap(made[second], 5.0) > 0.9
        assert all(body.layer is Layer.INSTRUMENT and body.sharp for body in bodies)
        assert {body.material.name for body in bodies} <= {"steel", "titanium", "cobalt-chrome", "aluminium"}
    assert seen > 22


def covered(bodies: list[Body], tip: FloatArray, direction: FloatArray, radius: float, axes: tuple[int, int]) -> float:
    """Share of points on a screw's axis and flanks over which an instrument lies, drawn by OpenCV in parallel rays."""
    import cv2

    image = np.zeros((1500, 1500), dtype=np.uint8)
    for body in bodies:
        corners = (5.0 * (body.vertices_in_world_mm[:, axes] + [50.0 if axes[0] == 1 else 150.0, 150.0])).round()
        for triangle in corners.astype(np.int32)[body.mesh.faces]:
            cv2.fillConvexPoly(image, triangle, 1)
    screw = np.zeros_like(image)
    direction = direction / np.linalg.norm(direction)
    ends = np.stack([tip, tip + 220.0 * direction])[:, axes] + [50.0 if axes[0] == 1 else 150.0, 150.0]
    first, second = (5.0 * ends).round().astype(int).tolist()
    cv2.line(screw, first, second, 1, round(10.0 * radius))
    return float((image & screw).sum() / screw.sum())


def test_clutter_hides_no_screw():
    most = 0.0
    for seed in range(4):
        bodies = random_clutter(np.random.default_rng(seed), SCREWS, 8)
        for tip, direction, radius in SCREWS:
            most = max(most, *(covered(bodies, tip, direction, radius, axes) for axes in ((0, 2), (1, 2))))
    assert 0.05 < most < 0.44  # four tenths, and the lines' round-off; some of it does cover


def test_clutter_follows_the_generator_and_the_count():
    first, again, other = (
        [b.vertices_in_world_mm for b in random_clutter(np.random.default_rng(seed), SCREWS, 3)] for seed in (3, 3, 4)
    )
    assert len(first) == len(again)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, two)
    assert len(first) != len(other) or first[0].shape != other[0].shape or np.abs(first[0] - other[0]).max() > 1.0
    assert random_clutter(np.random.default_rng(3), SCREWS, 0) == []


def test_keep_out_of_an_implant_holds_it():
    implant = make_screw(ScrewDesign(), "s")
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    pose[:3, 3] = [5.0, -7.0, 30.0]
    item = keep_out_of(implant, pose)
    points = implant.mesh.vertices_mm @ pose[:3, :3].T + pose[:3, 3]
    axis = (item.end_mm - item.start_mm) / np.linalg.norm(item.end_mm - item.start_mm)
    along = (points - item.start_mm) @ axis
    assert along.min() > -1e-6
    assert along.max() < np.linalg.norm(item.end_mm - item.start_mm) + 1e-6
    radial = np.linalg.norm(points - item.start_mm - along[:, None] * axis, axis=1)
    assert radial.max() == pytest.approx(item.radius_mm)
    assert isinstance(item, KeepOut)
    assert 5.0 < item.radius_mm < 12.0


def posed(implant: Implant, pose: FloatArray) -> Mesh:
    return Mesh(implant.mesh.vertices_mm @ pose[:3, :3].T + pose[:3, 3], implant.mesh.faces)


@pytest.mark.parametrize("angle", [0.0, 1.0, 4.0])
def test_needle_lies_along_the_tower(angle):
    implant = make_screw(ScrewDesign(), "s")
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    pose[:3, 3] = [5.0, -7.0, 30.0]
    needle = needle_along(implant, pose, angle_rad=angle)
    gap = solids.solid(in_world(needle)).min_gap(solids.solid(posed(implant, pose)), 5.0)
    assert 0.05 < gap < 2.5  # beside it; against slots and corners of a tower some tenths more
    axis = pose[:3, :3] @ implant.axis
    points = needle.vertices_in_world_mm
    direction = np.linalg.svd(points - points.mean(axis=0))[2][0]
    assert abs(direction @ axis) == pytest.approx(1.0, abs=1e-4)
    heights = (points - pose[:3, 3] - pose[:3, :3] @ implant.tip_mm) @ axis
    top = float(((implant.mesh.vertices_mm - implant.tip_mm) @ implant.axis).max())
    assert heights.max() == pytest.approx(top + 40.0)
    assert heights.min() > 2.0 * implant.length_mm  # above the shank
    assert needle.layer is Layer.INSTRUMENT
