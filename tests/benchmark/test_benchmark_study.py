"""A run of one small set from cases to summary and tables."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from screwpose.benchmark import run_study, summarise, write_study
from screwpose.benchmark import sets as benchmark_sets
from screwpose.benchmark.sets import BenchmarkSet, case_seed
from screwpose.benchmark.study import Study
from screwpose.errors import BehindSourceError
from screwpose.pairing import LandmarkNoise
from screwpose.registration import SearchOptions
from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from screwpose.solve import SolveOptions


def make_small(seed: int, index: int, folder: Path) -> Path:
    scene = two_screw_scene(case_seed("small", seed, index), landmark_noise_px=0.4, image_size=(256, 256))
    return write_case(scene, folder)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Study, Path, list[tuple[int, int]]]:
    folder = tmp_path_factory.mktemp("run")
    told: list[tuple[int, int]] = []
    options = SolveOptions(
        method="paper",
        noise=LandmarkNoise(sigma_px=0.6),
        faces=300,
        search=SearchOptions(generations=1, population=1),
    )
    with pytest.MonkeyPatch.context() as patch:
        small = BenchmarkSet("small", 1, make_small, None, "simulated", "two small cases")
        patch.setitem(benchmark_sets.SETS, "small", small)
        study = run_study("small", options, 2, 5, folder, lambda done, cases, *_: told.append((done, cases)))
    write_study(study, folder)
    return study, folder, told


def test_the_summary_counts_all_and_agrees_with_the_rows(run: tuple[Study, Path, list[tuple[int, int]]]) -> None:
    study, folder, told = run
    summary = json.loads((folder / "summary.json").read_text())
    method = summary["sets"]["small"]["methods"]["paper"]
    assert (method["cases"], method["screws"], summary["seed"]) == (2, 4, 5)
    rates = method["pairing"]
    np.testing.assert_allclose(rates["confident"] + rates["ambiguous"] + rates["refused"], 1.0)
    np.testing.assert_allclose(rates["right"], np.mean([one.right for one in study.outcomes]))
    with (folder / "screws.csv").open() as file:
        rows = list(csv.DictReader(file))
    tips = [float(row["tip_mm"]) for row in rows if row["tip_mm"]]
    assert rates["pairs_right"] == len(tips) / 4
    if tips:
        np.testing.assert_allclose(method["tip_mm"]["median"], np.median(tips))
        np.testing.assert_allclose(method["tip_mm"]["max"], max(tips))
    assert set(told) == {(0, 2), (1, 2)}
    assert summarise(study).model_dump(mode="json", exclude_none=True) == summary


def test_every_case_and_its_report_are_there(run: tuple[Study, Path, list[tuple[int, int]]]) -> None:
    _, folder, _ = run
    for index in range(2):
        assert (folder / "cases" / f"small-{index:04d}" / "truth.json").is_file()
        assert (folder / "results" / f"small-{index:04d}" / "report.html").is_file()
    assert "Pre" in (folder / "tables.md").read_text()
    table2 = (folder / "table2.csv").read_text().splitlines()
    assert len(table2) == 1 + 2 * 2  # two combinations a case


def test_a_case_that_cannot_be_computed_is_counted_as_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def behind(*_: object) -> None:
        raise BehindSourceError("a vertex has depth -3 mm")

    small = BenchmarkSet("small", 1, make_small, None, "simulated", "two small cases")
    monkeypatch.setitem(benchmark_sets.SETS, "small", small)
    monkeypatch.setattr("screwpose.benchmark.study.solve", behind)
    study = run_study("small", SolveOptions(method="paper"), 1, 5, tmp_path)
    write_study(study, tmp_path)
    rates = json.loads((tmp_path / "summary.json").read_text())["sets"]["small"]["methods"]["paper"]["pairing"]
    assert (rates["refused"], rates["right"], rates["pairs_right"]) == (1.0, 0.0, 0.0)
    assert study.outcomes[0].answer.warnings[-1] == "a vertex has depth -3 mm"
