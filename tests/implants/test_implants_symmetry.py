"""The order of rotational symmetry of shapes whose order is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from screwpose.implants.design import ScrewDesign
from screwpose.implants.mesh import read_mesh
from screwpose.implants.model import Mesh
from screwpose.implants.parametric import make_screw
from screwpose.implants.symmetry import CONTINUOUS, distance_to_triangles_mm, surface_sample, symmetry_order
from tests.data import shared_data

ORIGIN, AXIS = np.zeros(3), np.array([0.0, 0.0, 1.0])


def prism(sides: int, radius_mm: float = 10.0, height_mm: float = 30.0) -> Mesh:
    """A regular prism about z."""
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = radius_mm * np.column_stack([np.cos(angles), np.sin(angles)])
    vertices = [[*p, z] for z in (0.0, height_mm) for p in ring] + [[0, 0, 0], [0, 0, height_mm]]
    faces = []
    for k in range(sides):
        n = (k + 1) % sides
        faces += [
            (k, n, sides + n),
            (k, sides + n, sides + k),
            (2 * sides, n, k),
            (2 * sides + 1, sides + k, sides + n),
        ]
    return Mesh(np.array(vertices), np.array(faces))


@pytest.mark.parametrize(("sides", "order"), [(2 * 48, CONTINUOUS), (6, 6), (4, 4), (3, 3)])
def test_prisms(sides: int, order: int) -> None:
    assert symmetry_order(prism(sides), ORIGIN, AXIS, tolerance_mm=0.3) == order


def test_a_flat_bar_has_two_and_an_eccentric_one_none() -> None:
    bar = prism(4)
    flat = Mesh(bar.vertices_mm * [1.0, 0.5, 1.0], bar.faces)
    assert symmetry_order(flat, ORIGIN, AXIS, tolerance_mm=0.3) == 2
    assert symmetry_order(Mesh(bar.vertices_mm + [2.0, 0, 0], bar.faces), ORIGIN, AXIS, tolerance_mm=0.3) == 1


def test_the_frame_does_not_matter() -> None:
    R = Rotation.from_rotvec([0.4, -0.9, 0.3]).as_matrix()
    moved = Mesh(prism(3).vertices_mm @ R.T + [5.0, -7.0, 2.0], prism(3).faces)
    assert symmetry_order(moved, np.array([5.0, -7.0, 2.0]), R @ AXIS, tolerance_mm=0.3) == 3
    assert symmetry_order(moved, ORIGIN, AXIS, tolerance_mm=0.3) == 1


@pytest.mark.parametrize(
    ("design", "order"),
    [
        (ScrewDesign(), 1),  # slots of two lengths, and a notch
        (ScrewDesign(slot_lengths_mm=(50.0, 50.0)), 1),  # the notch alone
        (ScrewDesign(slot_lengths_mm=(50.0, 50.0), notch_depth_mm=0.0), 2),
        (ScrewDesign(tower=False), 2),  # the rod channel; the thread does not count
        (ScrewDesign(tower=False, shank_diameter_mm=8.5, tulip_diameter_mm=14.0), 2),
    ],
)
def test_screws(design: ScrewDesign, order: int) -> None:
    screw = make_screw(design)
    assert symmetry_order(screw.mesh, screw.tip_mm, screw.axis) == order


def test_a_tight_tolerance_sees_the_thread() -> None:
    screw = make_screw(ScrewDesign(tower=False))
    assert symmetry_order(screw.mesh, screw.tip_mm, screw.axis, tolerance_mm=0.3) == 1


def test_a_real_screw_whose_head_has_a_rod_channel() -> None:
    mesh = read_mesh(shared_data("screws_lassoan/scaled_625x45.stl"))
    low, high = mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0)
    along = int(np.argmax(high - low))
    axis = np.eye(3)[along]
    assert symmetry_order(mesh, 0.5 * (low + high), axis) in (1, 2)


def test_distances_from_a_triangle_by_hand() -> None:
    triangle = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]])
    points = np.array([[1.0, 1, 2], [-3, -4, 0], [2, -1, 0], [4, 3, 0], [0, 0, 0]])
    # Above the inside; off a corner; off an edge; off the hypotenuse 3x + 4y = 12 by (12 + 12 - 12) / 5; on it.
    found = distance_to_triangles_mm(points, np.repeat(triangle[None], len(points), axis=0))
    np.testing.assert_allclose(found, [2.0, 5.0, 1.0, 2.4, 0.0], atol=1e-12)


def test_a_sample_is_even_by_area() -> None:
    mesh = prism(4, radius_mm=np.sqrt(2.0), height_mm=6.0)  # sides 2 x 6, ends 2 x 2
    points, faces = surface_sample(mesh, 5600, np.random.default_rng(4))
    ends = np.isclose(points[:, 2], 0.0) | np.isclose(points[:, 2], 6.0)
    assert abs(int(ends.sum()) - 800) <= 8  # 8 of 56 square mm, drawn in even steps
    # Even inside the triangles too: the middle of each lies at its centroid.
    for face in np.unique(faces):
        inside = points[faces == face]
        np.testing.assert_allclose(inside.mean(axis=0), mesh.triangles_mm[face].mean(axis=0), atol=0.25)
