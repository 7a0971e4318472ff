"""The capture range: displacements are as large as they say, and rates count what came home."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from screwpose._types import FloatArray
from screwpose.benchmark.capture import (
    REGISTRATIONS,
    CaptureTrial,
    bounds_for,
    capture_plot,
    capture_rates,
    capture_trials,
    displaced,
)
from screwpose.benchmark.scoring import pose_error
from screwpose.benchmark.sets_base import BenchmarkSet
from screwpose.files.case import Case
from screwpose.geometry import rigid
from screwpose.registration import SearchOptions
from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from tests.benchmark.worked import BAR, TRUE_POSES, truth_of, write_files

SET = BenchmarkSet("hand", 1, lambda _seed, _index, folder: write_files(folder, truth_of()), 2, "", "")


def test_a_displacement_is_exactly_as_large_as_it_says() -> None:
    rng = np.random.default_rng(3)
    shifts = []
    for _ in range(200):
        error = pose_error(BAR, displaced(BAR, TRUE_POSES[1], 4.0, 7.0, rng), TRUE_POSES[1])
        assert error.center_mm == pytest.approx(4.0)
        assert np.linalg.norm(error.turn_in_cad_deg) == pytest.approx(7.0)
        shifts.append(error.shift_in_cad_mm / 4.0)
    # Even over the sphere: no direction is preferred, and each coordinate has a mean square of a third.
    np.testing.assert_allclose(np.mean(shifts, axis=0), 0.0, atol=0.13)
    np.testing.assert_allclose(np.mean(np.square(shifts), axis=0), 1 / 3, atol=0.08)


def test_the_bounds_hold_the_truth_and_never_shrink() -> None:
    wide = bounds_for(SearchOptions(), 10.0, 20.0)
    assert (wide.max_shift_mm, wide.max_tilt_deg, wide.max_roll_deg) == (12.5, 25.0, 25.0)
    assert bounds_for(SearchOptions(), 0.0, 0.0) == SearchOptions()


def test_what_stays_where_it_starts_ends_as_far_off(tmp_path: Path) -> None:
    seen: list[tuple[str, float]] = []

    def stay(_: Case, models: Sequence[str], starts: Sequence[FloatArray], options: SearchOptions) -> list[FloatArray]:
        seen.append((",".join(models), options.max_shift_mm))
        return list(starts)

    trials = capture_trials(SET, [0.0, 3.0], [0.0], count=5, seed=1, registration=stay)
    assert len(trials) == 2 * 2 * 2  # cases (the set has two), displacements, screws
    assert [one.tip_mm for one in trials] == pytest.approx([0, 0, 3, 3] * 2)
    assert [one.is_success for one in trials] == [True, True, False, False] * 2
    assert seen[:2] == [("bar,bar", 2.0), ("bar,bar", 3.75)]


def test_what_comes_home_is_a_success() -> None:
    def home(_: Case, __: Sequence[str], starts: Sequence[FloatArray], ___: SearchOptions) -> list[FloatArray]:
        assert np.linalg.norm(rigid.transform(starts[0], BAR.center_mm) - [-12, 15, 0]) == pytest.approx(5.0)
        return list(TRUE_POSES)

    [rate] = capture_rates(capture_trials(SET, [5.0], [10.0], count=2, seed=1, registration=home))
    assert (rate.cases, rate.screws, rate.successes, rate.rate) == (2, 4, 4, 1.0)


def test_rates_by_hand() -> None:
    trials = [
        CaptureTrial("s", index, 2.0, 5.0, tip, axis)
        for index, tip, axis in ((0, 0.2, 0.1), (0, 0.9, 1.1), (1, 1.1, 0.1), (1, 0.4, 0.2))
    ]
    [rate] = capture_rates(trials)
    assert (rate.cases, rate.screws, rate.successes) == (2, 4, 2)
    # Wilson for one of two: the interval counts cases, not screws.
    assert (rate.low, rate.high) == (pytest.approx(0.0945, abs=1e-3), pytest.approx(0.9055, abs=1e-3))
    assert rate.median_tip_mm == pytest.approx(0.65)
    assert capture_plot([rate]).startswith(b"\x89PNG")


def test_the_script_writes_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "capture_range.py"
    spec = importlib.util.spec_from_file_location("capture_range", path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    monkeypatch.setattr(script, "get_set", lambda _: SET)
    monkeypatch.setitem(script.REGISTRATIONS, "evolution", lambda _case, _models, starts, _options: starts)
    script.main(["--set", "hand", "--count", "1", "--shifts", "0,2", "--turns", "0", "-o", str(tmp_path / "out")])
    assert sorted(one.name for one in (tmp_path / "out").iterdir()) == [
        "capture_range.csv",
        "capture_range.png",
        "trials.csv",
    ]
    assert (tmp_path / "out" / "capture_range.csv").read_text().splitlines()[1].startswith("hand,0.0,0.0,1,2,2,1.0")


def test_thickness_comes_home_from_a_millimetre_without_marks() -> None:
    def make(_seed: int, _index: int, folder: Path) -> Path:
        return write_case(two_screw_scene(21, image_size=(448, 448)), folder)

    cases = BenchmarkSet("one", "1", make, 1, "simulated", "")
    trials = capture_trials(cases, [1.0], [2.0], count=1, seed=1, registration=REGISTRATIONS["thickness"])
    assert len(trials) == 2
    assert max(one.tip_mm for one in trials) < 0.3
