"""A simulated case on disk, read by others."""

import json

import cv2
import numpy as np
import pytest
import trimesh

from screwpose.errors import OutputError
from screwpose.files.case import read_case
from screwpose.files.schema import CaseFile, TruthFile
from screwpose.simulation import (
    Imperfections,
    SceneOptions,
    SimulatedCase,
    simulate_scene,
    two_screw_scene,
    write_case,
)


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
    with pytest.raises(OutputError, match=r"thesis: the folder is not empty and holds no scene\.json"):
        write_case(simulated, thesis)
    assert (thesis / "chapter1.txt").read_text() == "years of work"
    # Somebody's own case with its measured truth is not ours to replace.
    own = tmp_path / "own"
    own.mkdir()
    for name in ("case.json", "truth.json"):
        (own / name).write_bytes((folder / name).read_bytes())
    with pytest.raises(OutputError, match=r"own: the folder is not empty and holds no scene\.json"):
        write_case(simulated, own)


def test_polyaxial_screws_have_parts_a_pivot_and_leaning_truth(tmp_path):
    options = SceneOptions(polyaxial=1.0, tower_tilt_deg=(8.0, 8.0), image_size=(96, 96), overlap_lat=(0.0, 1.0))
    made = simulate_scene(options, Imperfections(), 2, with_anatomy=False)
    case = read_case(write_case(made, tmp_path / "case"))
    truth = TruthFile.model_validate_json((tmp_path / "case" / "truth.json").read_text())
    (implant,) = case.implants.values()
    assert [part.name for part in implant.parts] == ["shank", "tower"]
    for screw in truth.screws:
        assert screw.parts is not None
        shank, tower = (np.array(screw.parts[name]) for name in ("shank", "tower"))
        np.testing.assert_array_equal(shank, screw.world_from_cad)
        turn = np.linalg.inv(shank) @ tower
        assert np.degrees(np.arccos((np.trace(turn[:3, :3]) - 1.0) / 2.0)) == pytest.approx(8.0, abs=1e-6)
        pivot = np.append(implant.pivot_mm, 1.0)
        np.testing.assert_allclose(turn @ pivot, pivot, atol=1e-9)
    # The X-ray shows the tower where its own pose puts it, not where the shank's would.
    tower_mesh = implant.parts[1].mesh
    top = tower_mesh.vertices_mm[tower_mesh.vertices_mm[:, 1] > tower_mesh.vertices_mm[:, 1].max() - 3.0].mean(axis=0)
    view = made.views["LAT"]
    for screw in truth.screws:
        leaning, upright = (
            np.append(top, 1.0) @ np.array(pose).T for pose in (screw.parts["tower"], screw.world_from_cad)
        )
        off = np.linalg.norm(view.camera.project(leaning[:3]) - view.camera.project(upright[:3]))
        assert off > 1.0


def test_needles_show_which_screw_is_which(tmp_path):
    options = SceneOptions(needles=True, image_size=(192, 192))
    made = simulate_scene(options, Imperfections(), 5, with_anatomy=False)
    write_case(made, tmp_path / "case")
    told = json.loads((tmp_path / "case" / "needles.json").read_text())["acquisitions"]
    truth = json.loads((tmp_path / "case" / "truth.json").read_text())
    assert sorted(str(one["labels"]) for one in told) == sorted(str(screw["labels"]) for screw in truth["screws"])
    assert len(told) == 2
    for acquisition, screw in zip(made.needles.values(), made.screws, strict=True):
        pose = screw.world_from_cad
        # Along the tower, from the middle of it to beyond its end.
        for view, xray in acquisition.xrays.items():
            camera = made.views[view].camera
            darker = made.views[view].xray.transmission - xray.transmission > 0.05
            assert np.count_nonzero(darker) > 5
            v, u = np.nonzero(darker)
            line = camera.project(pose[:3, 3] + np.linspace(60.0, 230.0, 200)[:, None] * pose[:3, 1])
            away = np.hypot(u[:, None] - line[:, 0], v[:, None] - line[:, 1]).min(axis=1)
            assert away.max() < 12.0 / camera.mm_per_px_at(pose[:3, 3] + 100.0 * pose[:3, 1]) + 1.5
    for one in told:
        for name in ("ap.png", "lat.png"):
            assert (tmp_path / "case" / one["folder"] / name).is_file()


def test_clutter_is_there_and_leaves_the_rest_alone(tmp_path):
    bare = simulate_scene(SceneOptions(image_size=(128, 128)), Imperfections(), 4, with_anatomy=False)
    full = simulate_scene(SceneOptions(image_size=(128, 128), clutter=(5, 5)), Imperfections(), 4, with_anatomy=False)
    for one, other in zip(bare.screws, full.screws, strict=True):
        np.testing.assert_array_equal(one.world_from_cad, other.world_from_cad)
    more = bare.views["AP"].xray.transmission - full.views["AP"].xray.transmission
    assert more.min() > -1e-9
    assert np.count_nonzero(more > 0.2) > 50
    write_case(full, tmp_path / "case")
    assert json.loads((tmp_path / "case" / "scene.json").read_text())["clutter"] == 5
