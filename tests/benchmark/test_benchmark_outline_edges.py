"""The edge finder of benchmarks/real_biplane.py, on a sphere whose outline is known in closed form."""

import importlib.util
from pathlib import Path

import numpy as np
import trimesh

from screwpose.geometry import Camera
from screwpose.implants.model import Mesh

_PATH = Path(__file__).resolve().parents[2] / "benchmarks" / "outline_edges.py"
_SPEC = importlib.util.spec_from_file_location("outline_edges", _PATH)
edges = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(edges)

SHAPE = (400, 400)
CAMERA = Camera.from_matrix(np.array([[2000.0, 0, 199.5, 0], [0, 2000, 199.5, 0], [0, 0, 1, 0]]), SHAPE)
RADIUS_PX = 2000.0 * 20.0 / np.sqrt(600.0**2 - 20.0**2)  # tangents from 600 mm to a sphere of 20 mm


def ball() -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=5, radius=20.0)
    return Mesh(np.asarray(made.vertices, float), np.asarray(made.faces, np.int64))


def pose() -> np.ndarray:
    there = np.eye(4)
    there[2, 3] = 600.0
    return there


def test_the_outline_is_the_spheres() -> None:
    points, normals = edges.outline(CAMERA, ball(), pose(), SHAPE)
    away = points - 199.5
    radius = np.linalg.norm(away, axis=1)
    assert len(points) > 300
    assert abs(radius.mean() - RADIUS_PX) < 0.03
    assert np.abs(radius - RADIUS_PX).max() < 0.25
    assert (normals * away).sum(axis=1).min() > 0.99 * radius.min()


def test_an_edge_that_lies_further_out_is_found_there() -> None:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    away = np.hypot(columns - 199.5 - 0.8, rows - 199.5)  # moved by 0.8 px in u, and 0.3 px larger
    image = np.clip(0.5 + RADIUS_PX + 0.3 - away, 0.0, 1.0).astype(np.float32)
    points, normals = edges.outline(CAMERA, ball(), pose(), SHAPE)
    found = edges.edge_distances(image, np.ones(SHAPE, bool), points, normals)
    np.testing.assert_allclose(found.shift_px, [0.8, 0.0], atol=0.05)
    assert abs(np.nanmean(found.distances_px) - 0.3) < 0.05
    assert 0.3 < found.median_px < 0.9


def test_points_near_the_border_of_the_region_are_left_out() -> None:
    points, normals = edges.outline(CAMERA, ball(), pose(), SHAPE)
    region = np.zeros(SHAPE, bool)
    region[:, :200] = True
    found = edges.edge_distances(np.zeros(SHAPE, np.float32), region, points, normals)
    assert 0 < len(found.points_px) < len(points)
    assert found.points_px[:, 0].max() < 200 - edges.REACH_PX
