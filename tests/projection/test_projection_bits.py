"""The bit-row silhouette held to the reference, pixel for pixel but for centres within 1e-3 px of an edge."""

import numpy as np
import pytest

from screwpose.geometry import Camera, rigid
from screwpose.implants import ScrewDesign, make_screw
from screwpose.projection import reference
from screwpose.projection.contour import closed_surface
from screwpose.projection.silhouette import packed, silhouette, silhouette_bits, unpacked

ONE = np.array([[0, 1, 2]])


def distance_to_edges_px(corners: np.ndarray, u: int, v: int) -> float:
    ends = np.roll(corners, -1, axis=1)
    along = ends - corners
    t = np.sum(([u, v] - corners) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-300)
    nearest = corners + np.clip(t, 0, 1)[..., None] * along
    return float(np.linalg.norm([u, v] - nearest, axis=2).min())


def assert_same_but_on_edges(vertices: np.ndarray, faces: np.ndarray, shape: tuple[int, int], *, closed: bool) -> int:
    want = reference.silhouette(vertices, faces, shape)
    got = unpacked(silhouette_bits(vertices, faces, shape, closed), shape[1])
    for v, u in np.argwhere(got != want):
        assert distance_to_edges_px(vertices[faces], u, v) < 1e-3
    return int(want.sum())


@pytest.mark.parametrize("columns", [1, 63, 64, 65, 200])
def test_random_triangles(columns: int) -> None:
    rng = np.random.default_rng(columns)
    for _ in range(60):
        vertices = rng.uniform(-30, 1.3 * columns + 30, (12, 2))
        vertices[:4] = np.round(vertices[:4])  # corners on centres
        assert_same_but_on_edges(vertices, rng.integers(0, 12, (7, 3)), (70, columns), closed=False)


def test_posed_screws_from_both_sides_and_one() -> None:
    rng = np.random.default_rng(5)
    mesh = make_screw(ScrewDesign(segments=16, slot_lengths_mm=(30.0, 24.0), tower_length_mm=50.0)).mesh
    assert closed_surface(mesh.vertices_mm, mesh.faces) is not None
    camera = Camera.from_matrix(np.array([[600.0, 0, 100, 0], [0, 600.0, 80, 0], [0, 0, 1, 0]]))
    for _ in range(4):
        pose = np.eye(4)
        pose[:3, :3] = rigid.exp_rotation(rng.normal(size=3))
        pose[:3, 3] = rng.uniform([-20, -20, 380], [20, 20, 460])
        pixels = camera.project(rigid.transform(pose, mesh.vertices_mm))
        for closed in (False, True):
            assert assert_same_but_on_edges(pixels, mesh.faces, (160, 200), closed=closed) > 500
        assert assert_same_but_on_edges(pixels, mesh.faces[::2], (160, 200), closed=False) > 300


def test_degenerate_flat_and_far_triangles() -> None:
    for corners in (
        [[0.0, 0], [4, 4], [8, 8]],
        [[2.0, 3], [7, 3], [5, 3]],
        [[2.0, 3], [7, 3], [5, 6]],
        [[2.0, 6], [7, 6], [5, 3]],
        [[-1e7, -1e7], [3e7, -1e7], [-1e7, 3e7]],
        [[1e9, 1e9], [2e9, 1e9], [1e9, 2e9]],
    ):
        assert_same_but_on_edges(np.array(corners), ONE, (20, 130), closed=False)
    assert not silhouette(np.zeros((0, 2)), np.zeros((0, 3), dtype=np.int64), (5, 5)).any()


def test_bits_are_where_the_docstring_says() -> None:
    mask = np.zeros((2, 130), dtype=bool)
    mask[1, [0, 63, 64, 129]] = True
    bits = packed(mask)
    assert bits.shape == (2, 3)
    assert [int(word) for word in bits[1]] == [1 | 1 << 63, 1, 2]
    np.testing.assert_array_equal(unpacked(bits, 130), mask)
