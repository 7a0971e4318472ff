"""A simulated case on disk, read by others."""

import json

import cv2
import numpy as np
import pytest
import trimesh

from screwpose.errors import OutputError
from screwpose.files.case import read_case
from screwpose.files.schema import CaseFile, TruthFile
from screwpose.simulation import SimulatedCase, two_screw_scene, write_case


@pytest.fixture(scope="module")
def simulated() -> SimulatedCase:
    return two_screw_scene(11, image_size=(96, 96), with_anatomy=False)


def test_files_hold_what_was_simulated(simulated, tmp_path):
    path = write_case(simulated, tmp_path / "case")
    assert path == tmp_path / "case" / "case.json"
    names = sorted(str(p.relative_to(tmp_path / "case")) for p in (tmp_path / "case").rglob("*") if p.is_file())
    (model,) = simulated.implants
    assert names == ["ap.png", "case.json", "lat.png", f"models/{model}.stl", "scene.json", "truth.json"]

    case = json.loads(path.read_text())
    CaseFile.model_validate(case)
    assert case["format"] == "screwpose-case/1"
    for name, view in simulated.views.items():
        np.testing.assert_array_equal(case["views"][name]["projection"], view.camera.projection)
        data = np.frombuffer((path.parent / case["views"][name]["image"]).read_bytes(), dtype=np.uint8)
        np.testing.assert_array_equal(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), view.xray.pixels)
        for entry, mark in zip(case["annotations"][name], simulated.annotations[name], strict=True):
            assert entry["label"] == mark.label
            np.testing.assert_array_equal([entry["tip"], entry["center"]], [mark.tip_px, mark.center_px])
    implant = simulated.implants[model]
    np.testing.assert_array_equal(case["models"][model]["tip"], implant.tip_mm)
    np.testing.assert_array_equal(case["models"][model]["center"], implant.center_mm)
    stl = trimesh.load_mesh(path.parent / case["models"][model]["mesh"])
    assert len(stl.faces) == len(implant.mesh.faces)
    np.testing.assert_allclose(stl.bounds[1], implant.mesh.vertices_mm.max(axis=0), atol=1e-4)
    assert stl.is_watertight


def test_the_projects_own_reader_takes_it(simulated, tmp_path):
    case = read_case(write_case(simulated, tmp_path / "case"))
    assert case.id == simulated.id
    (model,) = simulated.implants
    assert len(case.implants[model].mesh.faces) == len(simulated.implants[model].mesh.faces)
    for name, view in simulated.views.items():
        image = case.views[name].radiograph.pixels
        # Metal bright inside: what was darkest is brightest, pixel for pixel.
        np.testing.assert_allclose(image, 1.0 - view.xray.pixels / 255.0, atol=1e-6)


def test_truth_names_labels_and_poses(simulated, tmp_path):
    write_case(simulated, tmp_path / "case")
    truth = json.loads((tmp_path / "case" / "truth.json").read_text())
    TruthFile.model_validate(truth)
    assert truth["case"] == simulated.id
    for entry, screw in zip(truth["screws"], simulated.screws, strict=True):
        assert entry["labels"] == dict(screw.labels)
        np.testing.assert_array_equal(entry["world_from_cad"], screw.world_from_cad)


def test_a_case_is_written_over_by_a_case_only(simulated, tmp_path):
    folder = tmp_path / "case"
    write_case(simulated, folder)
    (folder / "stray.txt").write_text("from an earlier run")
    write_case(simulated, folder)
    assert not (folder / "stray.txt").exists()
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "chapter1.txt").write_text("years of work")
    with pytest.raises(OutputError, match=r"thesis: the folder is not empty and holds no truth\.json"):
        write_case(simulated, thesis)
    assert (thesis / "chapter1.txt").read_text() == "years of work"
