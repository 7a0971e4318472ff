"""`default` against `paper` in whole cases: what the command makes of the times."""

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def whole_case(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("whole_case")


def test_the_part_against_paper_says_each_case_and_all(
    whole_case: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engines = importlib.import_module("engines")
    asked = []

    def whole_cases(*request: object) -> list[list[object]]:
        asked.append(request)
        times = {"default": 1.0, "paper, bit rows": 3.0, "paper, OpenCV": 120.0}
        return [
            [
                engines.Timed("cases", case, job, s * 1e6, s * 0.9e6, s * 1.2e6, s * factor, s * 0.8, s * 1.5, 3)
                for job, s in times.items()
            ]
            for case, factor in enumerate((1.0, 1.1, 1.2))
        ]

    monkeypatch.setattr(engines, "whole_cases", whole_cases)
    out = tmp_path / "out"
    given = ["--seed", "7", "--cases", "3", "--rounds", "2", "--parts", "paper", "--opencv", "-o", str(out)]
    monkeypatch.setattr(sys, "argv", ["whole_case.py", *given])
    whole_case.main()
    assert asked == [("pairs", 7, 3, 2, True)]
    lines = (out / "whole_case.md").read_text().splitlines()
    assert "| 1 | paper, OpenCV | 120.00 (108.00 to 144.00) | 132.0 (96.0 to 180.0) |" in lines
    assert "| paper, bit rows | 3.00 (3.00 to 3.00; p90 3.00) | 3.30 (3.15 to 3.45; p90 3.54) |" in lines
    kept = json.loads((out / "whole_case.json").read_text())
    assert (kept["blocks"], len(kept["paper"])) == ({}, 9)


def test_every_step_that_is_timed_is_there(whole_case: ModuleType) -> None:
    for step, place in whole_case._STEPS.items():
        module, name = place.split(":")
        assert callable(getattr(importlib.import_module(module), name, None)), step


def test_the_power_of_growth_by_hand(whole_case: ModuleType) -> None:
    screws = [2.0, 4.0, 8.0]
    assert whole_case.power_of_growth(screws, [3.0, 12.0, 48.0]) == pytest.approx(2.0)
    assert whole_case.power_of_growth(screws, [1.0, 1.0, 1.0]) == pytest.approx(0.0)
    rows = {
        count: [{"solve_s": 0.5 * count, "steps_s": {"plausibility": 0.01, "combinations": 0.01 * count**2 - 0.01}}]
        for count in (2, 4, 8, 12, 16)
    }
    page = whole_case.growth_page({f"{count} screws": {"records": found} for count, found in rows.items()})
    assert "| solve | 1.000 | 2.000 | 4.000 | 6.000 | 8.000 | 1.00 |" in page.splitlines()
    assert page.splitlines()[-1].endswith("| 2.00 |")
