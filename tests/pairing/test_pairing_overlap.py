"""Distances of segments and depths of rods, against dense sampling and by hand."""

import numpy as np

from screwpose.implants.model import Implant, Mesh
from screwpose.pairing.overlap import overlaps_mm, rod_of, segment_distances_mm


def test_distances_are_those_of_dense_points() -> None:
    rng = np.random.default_rng(1)
    starts, ends = rng.uniform(-20, 20, (2, 9, 3))
    ends[3] = starts[3] + (ends[2] - starts[2])  # parallel to another
    ends[4] = starts[4]  # a point
    share = np.linspace(0, 1, 401)[:, None]
    points = [start + share * (end - start) for start, end in zip(starts, ends, strict=True)]
    got = segment_distances_mm(starts, ends)
    for i in range(9):
        for j in range(9):
            if i != j:
                want = np.linalg.norm(points[i][:, None] - points[j][None], axis=2).min()
                np.testing.assert_allclose(got[i, j], want, atol=0.15)
    np.testing.assert_allclose(got, got.T, atol=1e-9)


def test_two_rods_by_hand() -> None:
    # Two that cross at right angles 4 mm apart, of radius 3 and 2: 1 mm deep. The third is far away.
    tips = np.array([[-10.0, 0, 0], [0, -10.0, 4.0], [100.0, 0, 0]])
    centers = np.array([[0.0, 0, 0], [0, 0, 4.0], [100.0, 10, 0]])
    deep = overlaps_mm(tips, centers, np.array([20.0, 20, 20]), np.array([3.0, 2, 2]))
    np.testing.assert_allclose(deep, [[0, 1, 0], [1, 0, 0], [0, 0, 0]], atol=1e-9)
    # Ended at their centres, which lie above each other, they still touch; ended before, they do not.
    short = overlaps_mm(tips, centers, np.array([5.0, 5, 5]), np.array([3.0, 2, 2]))
    np.testing.assert_array_equal(short, np.zeros((3, 3)))


def test_the_rod_of_a_shank() -> None:
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    rings = [np.column_stack([3 * np.cos(turn), np.full(40, y), 3 * np.sin(turn)]) for y in np.linspace(2, 45, 20)]
    tower = np.column_stack([7 * np.cos(turn), np.full(40, 120.0), 7 * np.sin(turn)])
    mesh = Mesh(np.vstack([*rings, tower]), np.array([[0, 1, 2]]))
    rod = rod_of(Implant("rod", mesh, np.zeros(3), np.array([0, 22.5, 0])))
    np.testing.assert_allclose([rod.length_mm, rod.radius_mm], [120.0, 3.0])
