"""Placed meshes: read back by another library, against the matrix product."""

from dataclasses import replace

import numpy as np
import pytest

from screwpose.errors import OutputError
from screwpose.files.schema import PartPose
from screwpose.implants.model import Mesh, Part
from screwpose.report.meshes import placed_mesh, safe_name, unique_names, write_meshes
from tests.report.scene import make_case, make_result


def test_each_screw_is_written_in_world_coordinates(tmp_path):
    import trimesh

    case, truth = make_case()
    screws = make_result(case, truth).answer.screws
    paths = write_meshes(tmp_path, screws, case.implants)
    assert [path.name for path in paths] == ["screw_AP-1_LAT-a.stl", "screw_AP-2_LAT-b.stl"]
    for path, posed in zip(paths, truth, strict=True):
        stored = trimesh.load_mesh(path)
        vertices = case.implants["rod"].mesh.vertices_mm
        expected = (posed.world_from_cad @ np.column_stack([vertices, np.ones(len(vertices))]).T).T[:, :3]
        np.testing.assert_allclose(stored.bounds, [expected.min(axis=0), expected.max(axis=0)], atol=1e-4)
        assert len(stored.faces) > 0


def test_parts_stand_where_they_were_registered():
    case, truth = make_case()
    whole = case.implants["rod"]
    first, second = Part("shank", Mesh(whole.mesh.vertices_mm[:24], whole.mesh.faces[:24])), Part("tower", whole.mesh)
    implant = replace(whole, parts=(first, second))
    moved = truth[0].world_from_cad.copy()
    moved[:3, 3] += [0.0, 0.0, 5.0]
    screw = make_result(case, truth).answer.screws[0]
    screw = screw.model_copy(update={"parts": {"tower": PartPose(world_from_cad=moved)}})
    placed = placed_mesh(implant, screw)
    tower = whole.mesh.vertices_mm @ moved[:3, :3].T + moved[:3, 3]
    shank = first.mesh.vertices_mm @ truth[0].world_from_cad[:3, :3].T + truth[0].world_from_cad[:3, 3]
    np.testing.assert_allclose(placed.vertices_mm, np.vstack([shank, tower]), atol=1e-9)
    assert placed.faces.max() == len(placed.vertices_mm) - 1
    np.testing.assert_array_equal(placed.faces[24], whole.mesh.faces[0] + 24)


@pytest.mark.parametrize(
    ("text", "name"), [("AP-1", "AP-1"), ("../../etc", "_.._etc"), ("a/b\\c:d", "a_b_c_d"), ("腰", "_"), ("", "_")]
)
def test_names_are_safe(text, name):
    assert safe_name(text) == name


def test_names_are_unique_also_where_case_does_not_count():
    assert unique_names(["a", "A", "a", "b/", "b:"]) == ["a", "A_2", "a_3", "b_", "b__2"]
    assert len(safe_name("x" * 500)) == 80


def test_a_folder_that_cannot_be_written_is_our_error(tmp_path):
    case, truth = make_case()
    (tmp_path / "meshes").write_text("in the way")
    with pytest.raises(OutputError, match=r"meshes: the folder cannot be made"):
        write_meshes(tmp_path, make_result(case, truth).answer.screws, case.implants)
