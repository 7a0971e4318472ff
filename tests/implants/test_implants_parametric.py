"""Parametric screws: closed, as large as asked, with the features that the registration needs."""

from typing import Any

import numpy as np
import pytest
import trimesh

from screwpose.errors import MeshError
from screwpose.implants import Implant, Mesh, ScrewDesign, make_screw, mesh_report, read_mesh, write_stl

DESIGNS: list[dict[str, Any]] = [
    {},
    {"tower": False},
    {"tower": False, "cannulation_mm": 0.0},
    {"polyaxial": True},
    {"polyaxial": True, "tilt_deg": 25.0, "tilt_direction_deg": 130.0, "cannulation_mm": 0.0},
    {"polyaxial": True, "tilt_deg": 18.34, "tilt_direction_deg": 67.6, "segments": 24, "thread_starts": 2},
    {"shank_diameter_mm": 4.5, "shank_length_mm": 30.0, "pitch_mm": 1.75, "thread_starts": 2, "segments": 32},
    {"shank_diameter_mm": 8.5, "shank_length_mm": 90.0, "tower_length_mm": 130.0, "polyaxial": True},
]


def solid(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def inside(mesh: Mesh, points: Any) -> np.ndarray:
    """Which points are in the metal, by the solid angle of the surface around them (Van Oosterom & Strackee 1983)."""
    found = []
    for point in np.asarray(points, dtype=float):
        a, b, c = np.moveaxis(mesh.triangles_mm - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        dot = np.einsum
        above = dot("ij,ij->i", a, np.cross(b, c))
        below = la * lb * lc + dot("ij,ij->i", a, b) * lc + dot("ij,ij->i", b, c) * la + dot("ij,ij->i", c, a) * lb
        found.append(2.0 * np.arctan2(above, below).sum() > 2.0 * np.pi)
    return np.array(found)


def radii(mesh: Mesh, low: float, high: float) -> np.ndarray:
    y = mesh.vertices_mm[:, 1]
    return np.hypot(*mesh.vertices_mm[(y > low) & (y < high)][:, [0, 2]].T)


@pytest.fixture(scope="module")
def default() -> Implant:
    return make_screw()


@pytest.mark.parametrize("fields", DESIGNS, ids=str)
def test_whole_and_parts_are_closed_and_stay_so_in_stl(fields: dict[str, Any], tmp_path: Any) -> None:
    implant = make_screw(ScrewDesign(**fields), "s")
    assert implant.name == "s"
    assert [part.name for part in implant.parts] == ["shank", "tower" if fields.get("tower", True) else "head"]
    for mesh in (implant.mesh, *(part.mesh for part in implant.parts)):
        other = solid(mesh)
        assert other.is_watertight
        assert other.is_winding_consistent
        assert other.body_count == 1
        assert other.volume > 100.0
        write_stl(mesh, tmp_path / "a.stl")
        assert mesh_report(read_mesh(tmp_path / "a.stl")).watertight
    parts = sum(solid(part.mesh).volume for part in implant.parts)
    whole = solid(implant.mesh).volume
    if fields.get("polyaxial"):
        assert -1e-3 < parts - whole < 0.002 * whole  # the ring where ball and seat touch
        assert implant.pivot_mm is not None
    else:
        np.testing.assert_allclose(parts, whole, rtol=1e-5)
        assert implant.pivot_mm is None


def test_dimensions_of_the_default(default: Implant) -> None:
    assert 8000 <= len(default.mesh.faces) <= 14000
    np.testing.assert_allclose(default.mesh.vertices_mm.min(axis=0), [-6.5, 0.0, -6.0], atol=1e-6)
    np.testing.assert_allclose(default.mesh.vertices_mm.max(axis=0), [6.5, 161.0, 6.0], atol=1e-6)
    np.testing.assert_array_equal(default.tip_mm, 0.0)
    np.testing.assert_array_equal(default.center_mm, [0.0, 22.5, 0.0])
    np.testing.assert_array_equal(default.axis, [0.0, 1.0, 0.0])
    np.testing.assert_allclose(radii(default.mesh, 15.0, 40.0).max(), 3.25, atol=1e-3)  # over the thread
    np.testing.assert_allclose(radii(default.mesh, -0.1, 0.1).min(), 0.8, atol=1e-3)  # the bore
    rim = radii(default.mesh, 160.9, 161.1)  # the tower's wall; the notch cuts some facets between their corners
    np.testing.assert_allclose([rim.min(), rim.max()], [5.0, 6.0], atol=0.02)
    assert radii(default.mesh, -0.1, 0.5).max() < 1.6  # a blunt tip


def test_the_thread_is_right_handed_and_has_its_pitch(default: Implant) -> None:
    """Crests of a right-handed thread about +y climb by one pitch a turn, counter-clockwise seen from the head."""
    mesh = default.mesh
    x, y, z = mesh.vertices_mm.T
    crest = (np.hypot(x, z) > 3.2) & (y > 15.0) & (y < 40.0)
    angle = np.arctan2(-z[crest], x[crest])  # seen from +y, x to the right, -z is up
    phase = np.exp(1j * (2.0 * np.pi * y[crest] / 2.75 - angle))
    assert np.abs(phase.mean()) > 0.9  # all crests on one helix
    mirrored = np.exp(1j * (2.0 * np.pi * y[crest] / 2.75 + angle))
    assert np.abs(mirrored.mean()) < 0.2


def test_the_bore_and_the_rod_channel_are_open(default: Implant) -> None:
    """A guide wire passes from tip to tower, a rod through the tulip; the tower's wall is met from the side."""
    on_axis = np.column_stack([np.zeros(50), np.linspace(0.5, 160.5, 50), np.zeros(50)])
    assert not inside(default.mesh, on_axis).any()
    along_rod = np.column_stack([np.zeros(41), np.full(41, 54.0), np.linspace(-7, 7, 41)])
    assert not inside(default.mesh, along_rod).any()
    assert inside(default.mesh, [[1.9, 20.0, 0.0], [5.5, 100.0, 0.0], [-5.5, 155.0, 0.0]]).all()


def test_the_roll_is_unique(default: Implant) -> None:
    """The slots end at 121 and 103 mm, the notch stands on one side: no turn maps the screw onto itself."""
    wall = {"+z": (0.0, 5.5), "-z": (0.0, -5.5), "+x": (5.5, 0.0), "-x": (-5.5, 0.0)}

    def metal(height: float) -> set[str]:
        points = [(x, height, z) for x, z in wall.values()]
        return {name for name, there in zip(wall, inside(default.mesh, points), strict=True) if there}

    assert metal(100.0) == {"+x", "-x"}
    assert metal(110.0) == {"+x", "-x", "-z"}
    assert metal(130.0) == {"+x", "-x", "+z", "-z"}
    assert metal(156.0) == {"-x", "+z", "-z"}


def test_a_polyaxial_head_leans_about_the_ball_by_its_tilt() -> None:
    straight = make_screw(ScrewDesign(polyaxial=True))
    tilted = make_screw(ScrewDesign(polyaxial=True, tilt_deg=20.0, tilt_direction_deg=90.0))
    np.testing.assert_array_equal(straight.parts[0].mesh.vertices_mm, tilted.parts[0].mesh.vertices_mm)
    assert straight.pivot_mm is not None
    angle = np.deg2rad(20.0)
    towards_z = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    want = (straight.parts[1].mesh.vertices_mm - straight.pivot_mm) @ towards_z.T + straight.pivot_mm
    got = tilted.parts[1].mesh
    np.testing.assert_allclose(got.vertices_mm.min(axis=0), want.min(axis=0), atol=2e-3)
    np.testing.assert_allclose(got.vertices_mm.max(axis=0), want.max(axis=0), atol=2e-3)
    middle = solid(Mesh(want, straight.parts[1].mesh.faces)).center_mass
    np.testing.assert_allclose(solid(got).center_mass, middle, atol=2e-3)
    towards_x = make_screw(ScrewDesign(polyaxial=True, tilt_deg=20.0)).parts[1].mesh.vertices_mm
    assert towards_x[:, 0].max() > 40.0


def test_it_is_deterministic() -> None:
    one, two = (make_screw(ScrewDesign(polyaxial=True, tilt_deg=10.0)).mesh for _ in range(2))
    np.testing.assert_array_equal(one.vertices_mm, two.vertices_mm)
    np.testing.assert_array_equal(one.faces, two.faces)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"shank_diameter_mm": 0.065}, r"shank_diameter_mm: 0\.065 does not go .*; expected 3 to 12"),
        ({"shank_length_mm": np.nan}, "shank_length_mm: nan is no dimension; expected a finite number"),
        ({"cannulation_mm": 4.0}, "cannulation_mm: 4 does not go with the other dimensions"),
        ({"tower_inner_mm": 12.5}, r"tower_inner_mm: 12\.5 .*expected 6\.8 to 12"),
        ({"tower_outer_mm": 10.0}, r"tower_outer_mm: 10 .*expected 10\.8 to 30"),
        ({"slot_lengths_mm": (60.0, 95.0)}, "slot_lengths_mm: 95"),
        ({"tulip_height_mm": 8.0}, "tulip_height_mm: 8 "),
        ({"segments": 50}, "segments: 50 segments; expected a multiple of 4 from 16 to 256"),
        ({"tilt_deg": 5.0}, "tilt_deg: a tilt of 5 degrees for a monoaxial screw. Set polyaxial"),
        ({"polyaxial": True, "tilt_deg": 40.0}, "tilt_deg: 40 .*expected 0 to 25"),
        ({"polyaxial": True, "tulip_diameter_mm": 10.9}, r"tulip_diameter_mm: 10\.9 .*expected 11 to 25"),
    ],
)
def test_what_cannot_be_made_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(MeshError, match=message):
        ScrewDesign(**fields)
