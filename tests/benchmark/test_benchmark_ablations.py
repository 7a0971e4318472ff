"""The study of the recipe's parts: each part can be taken out, and a part that is none is an error."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def ablations(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("ablations")


def test_every_part_is_where_it_is_taken_out(ablations: ModuleType) -> None:
    parts = ablations.parts()
    assert len(parts) > 10
    for part in parts:
        before = [looked_up(place) for place, _ in part.replaced]
        with part.in_force():  # a name that is not there fails here
            assert [looked_up(place) for place, _ in part.replaced] == [value for _, value in part.replaced]
        assert [looked_up(place) for place, _ in part.replaced] == before


def looked_up(place: str) -> object:
    module, name = place.split(":")
    return getattr(importlib.import_module(module), name)


def test_a_part_that_is_none_is_an_error_and_not_an_empty_table(
    ablations: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["ablations.py", "--only", "no such part", "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as left:
        ablations.main()
    assert left.value.code == 2
    assert "--only 'no such part': no part begins so; there are: the whole recipe;" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
