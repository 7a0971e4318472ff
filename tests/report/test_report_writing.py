"""The folder: which files, in which case, and that it can be stopped."""

import json
from dataclasses import replace

import numpy as np
import pytest

import screwpose.report
from screwpose.errors import CancelledError, OutputError
from screwpose.files.atomic import atomic_folder
from screwpose.files.schema import ResultFile
from screwpose.report import Comparison, write_report
from tests.report.scene import make_case, make_refused, make_result

OVERLAYS = [
    f"overlays/{view}_combination{number}_{stage}.png"
    for number in (1, 2)
    for stage in ("pre", "post")
    for view in ("AP", "LAT")
]


def names(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_everything_is_written_and_told(tmp_path):
    case, truth = make_case()
    result = make_result(case, truth)
    told = []
    comparison = Comparison(true_pairs=tuple(one.labels for one in truth))
    with atomic_folder(tmp_path / "out") as folder:
        paths = write_report(folder, case, result, comparison, lambda fraction, what: told.append((fraction, what)))
        assert names(folder) == {path.relative_to(folder).as_posix() for path in paths}
    out = tmp_path / "out"
    assert names(out) == {
        "result.json",
        *OVERLAYS,
        "overlays/combination1.png",
        "overlays/combination2.png",
        "combinations.csv",
        "combinations.md",
        "meshes/screw_AP-1_LAT-a.stl",
        "meshes/screw_AP-2_LAT-b.stl",
        "report.html",
    }
    assert ResultFile.model_validate(json.loads((out / "result.json").read_text())) == result.answer
    assert "set,combination,pairs,truth,chosen" in (out / "combinations.csv").read_text()
    fractions = [fraction for fraction, _ in told]
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0
    np.testing.assert_array_equal(fractions, sorted(fractions))


def test_a_refused_answer_is_reported_with_its_landmarks(tmp_path):
    case, _ = make_case()
    write_report(tmp_path, case, make_refused(case))
    assert names(tmp_path) == {
        "result.json",
        "overlays/AP_landmarks.png",
        "overlays/LAT_landmarks.png",
        "report.html",
    }


def test_of_many_combinations_the_best_few_are_drawn(tmp_path):
    case, truth = make_case(screws=6)
    result = make_result(case, truth, combinations=6)
    pairing = result.answer.pairing.model_dump() | {"pairs": result.answer.combinations[5].pairs}
    write_report(tmp_path, case, make_result(case, truth, combinations=6, pairing=pairing))
    drawn = sorted(path.name for path in (tmp_path / "overlays").glob("combination?.png"))
    # The chosen one is drawn although it stands last.
    assert drawn == [f"combination{number}.png" for number in (1, 2, 3, 6)]
    assert "4 of 6 combinations are drawn" in (tmp_path / "report.html").read_text()
    assert len((tmp_path / "combinations.csv").read_text().splitlines()) == 7


def test_writing_can_be_stopped(tmp_path):
    case, truth = make_case()

    def stop(fraction, what):
        if fraction > 0.2:
            raise CancelledError("stopped by hand")

    with pytest.raises(CancelledError, match="stopped by hand"):
        write_report(tmp_path, case, make_result(case, truth), progress=stop)
    assert not (tmp_path / "report.html").exists()


def test_view_names_that_are_no_file_names_stay_apart_and_inside(tmp_path):
    case, _ = make_case()
    renamed = {"../x": "AP", "..:x": "LAT"}
    case = replace(
        case,
        views={new: replace(case.views[old], name=new) for new, old in renamed.items()},
        annotations={new: case.annotations[old] for new, old in renamed.items()},
    )
    folder = tmp_path / "deep" / "out"
    folder.mkdir(parents=True)
    write_report(folder, case, make_refused(case))
    assert {path.name for path in (folder / "overlays").iterdir()} == {"_x_landmarks.png", "_x_2_landmarks.png"}
    assert names(tmp_path) == {f"deep/out/{name}" for name in names(folder)}


def test_a_place_that_cannot_be_written_is_our_error(tmp_path):
    case, truth = make_case()
    (tmp_path / "overlays").write_text("in the way")
    with pytest.raises(OutputError, match=r"overlays: the folder cannot be made \(File exists\)"):
        write_report(tmp_path, case, make_result(case, truth))


def test_the_public_names_are_these():
    assert screwpose.report.__all__ == [
        "Comparison", "Palette", "ScrewComparison", "Table", "combination_table", "crop_around", "overlay",
        "pairing_table", "write_meshes", "write_report",
    ]  # fmt: skip
    for name in screwpose.report.__all__:
        assert getattr(screwpose.report, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = screwpose.report.nothing
