"""The mesh report, against boxes whose faults were made by hand, and against trimesh on real meshes."""

import re
import time

import numpy as np
import pytest
import trimesh

from screwpose.implants import Mesh, make_screw, mesh_report, read_mesh
from screwpose.implants.health import scale_problems
from tests.data import shared_data

BOX = trimesh.creation.box((30.0, 40.0, 50.0))
CORNERS, FACES = np.asarray(BOX.vertices), np.asarray(BOX.faces, dtype=np.int64)


def box(faces: np.ndarray = FACES, corners: np.ndarray = CORNERS) -> Mesh:
    return Mesh(corners, faces)


def problems(mesh: Mesh) -> str:
    return " | ".join(mesh_report(mesh).problems)


def test_a_sound_box() -> None:
    report = mesh_report(box())
    assert (report.vertices, report.faces, report.bodies) == (8, 12, 1)
    assert report.watertight
    assert report.extent_mm == (30.0, 40.0, 50.0)
    np.testing.assert_allclose(report.volume_mm3, 60_000.0)
    assert report.problems == ()


def test_a_hole() -> None:
    report = mesh_report(box(FACES[1:]))
    assert not report.watertight
    assert report.open_edges == 3
    assert "not closed: 3 open edges" in report.problems[0]
    assert "Close them" in report.problems[0]


def test_inside_out() -> None:
    report = mesh_report(box(FACES[:, ::-1]))
    assert report.inverted_bodies == 1
    assert report.inconsistent_edges == 0
    np.testing.assert_allclose(report.volume_mm3, -60_000.0)
    assert "1 of 1 bodies inside out" in report.problems[0]


def test_one_face_turned_over() -> None:
    faces = FACES.copy()
    faces[4] = faces[4, ::-1]
    report = mesh_report(box(faces))
    assert report.inconsistent_edges == 3
    assert report.inverted_bodies == 0
    assert report.watertight
    assert "At 3 edges the neighbouring faces disagree" in report.problems[0]


def test_a_hollow_is_no_inverted_body_but_a_neighbour_inside_out_is() -> None:
    hollow = box(np.concatenate([FACES, FACES[:, ::-1] + 8]), np.concatenate([CORNERS, 0.5 * CORNERS]))
    assert mesh_report(hollow).bodies == 2
    assert mesh_report(hollow).inverted_bodies == 0
    np.testing.assert_allclose(mesh_report(hollow).volume_mm3, 60_000.0 * 7 / 8)
    beside = box(np.concatenate([FACES, FACES[:, ::-1] + 8]), np.concatenate([CORNERS, 0.5 * CORNERS + 100.0]))
    assert mesh_report(beside).inverted_bodies == 1


def test_degenerate_and_duplicate_faces() -> None:
    corners = np.concatenate([CORNERS, [CORNERS[FACES[0, :2]].mean(axis=0)]])
    flat = np.array([[FACES[0, 0], FACES[0, 1], 8], [0, 0, 1]])
    report = mesh_report(box(np.concatenate([FACES, flat, FACES[3:4, [1, 2, 0]]]), corners))
    assert report.degenerate_faces == 2
    assert report.duplicate_faces == 1
    assert "2 faces have no area" in " ".join(report.problems)
    assert "1 faces are there twice" in " ".join(report.problems)


def test_an_edge_of_four_faces() -> None:
    """Two tetrahedra that share an edge."""
    corners = np.array([[0, 0, 0], [0, 0, 30], [20, 0, 15], [10, 10, 15], [-20, 0, 15], [-10, -10, 15]], dtype=float)
    tetra = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 0, 2]])
    other = np.array([[0, 1, 5], [1, 4, 5], [4, 0, 5], [1, 0, 4]])
    report = mesh_report(Mesh(corners, np.concatenate([tetra, other])))
    assert report.non_manifold_edges == 1
    assert report.open_edges == 0
    assert not report.watertight
    assert "1 edges belong to more than two faces" in report.problems[0]


@pytest.mark.parametrize(
    ("length_mm", "text"),
    [
        (0.0612, r"It is 0\.0612 mm long, where screws measure 20 to 250 mm: is it in metres\?.*61\.2 mm"),
        (
            2.4,
            r"is it in inches\? \(in inches it would be 61 mm; in centimetres it would be 24 mm\.\) State its unit\.",
        ),
        (6.1, r"in inches it would be 155 mm; in centimetres it would be 61 mm"),
        (61.0, None),
        (161.0, None),
        (300.0, "too long for a screw"),
        (610.0, "it is too large"),
        (0.001, "it is too short"),
    ],
)
def test_scale(length_mm: float, text: str | None) -> None:
    found = scale_problems(length_mm)
    if text is None:
        assert found == ()
    else:
        assert len(found) == 1
        assert re.search(text, found[0]), found


@pytest.mark.parametrize(("scale", "unit"), [(0.001, "metres"), (1 / 25.4, "inches")])
def test_a_screw_in_another_unit_is_noticed_however_it_lies(scale: float, unit: str) -> None:
    mesh = make_screw().mesh
    turn = np.array([[1, -1, 1], [1, 1, 0], [-1, 1, 2]]) / np.sqrt([[3], [2], [6]])
    assert f"is it in {unit}?" in problems(Mesh(scale * mesh.vertices_mm @ turn, mesh.faces))


@pytest.mark.parametrize(
    "name", ["jtml_biplane/tibia0.stl", "jtml_biplane/femur0.stl", "screws_lassoan/scaled_550x40.stl"]
)
def test_real_meshes_agree_with_trimesh(name: str) -> None:
    mesh = read_mesh(shared_data(name))
    report, other = mesh_report(mesh), trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    groups = trimesh.grouping.group_rows(other.edges_sorted, require_count=1)
    assert report.open_edges == len(groups)
    assert report.watertight == other.is_watertight
    assert report.bodies == len(trimesh.graph.connected_components(other.edges, nodes=np.arange(len(other.vertices))))
    np.testing.assert_allclose(report.extent_mm, other.extents)


def test_real_inverted_winding_is_found() -> None:
    mesh = read_mesh(shared_data("jtml_biplane/tibia0.stl"))
    assert mesh_report(mesh).problems == ()
    assert "1 of 1 bodies inside out" in problems(Mesh(mesh.vertices_mm, mesh.faces[:, ::-1]))


def test_it_is_quick_on_73000_faces() -> None:
    mesh = read_mesh(shared_data("jtml_biplane/femur0.stl"))
    mesh_report(mesh)
    start = time.process_time()
    mesh_report(mesh)
    assert time.process_time() - start < 1.0  # 0.1 s alone; the margin is for a loaded machine
