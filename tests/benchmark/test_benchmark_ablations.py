"""The study of the recipe's parts: each part can be taken out, and a part that is none is an error."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from screwpose.files.case import View
from screwpose.geometry import Camera
from screwpose.images.radiograph import Radiograph
from screwpose.pairing.thickness import _targets_of

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


def test_other_sharp_images_are_other_ones(ablations: ModuleType) -> None:
    """As `prepare_thickness` asks for them: a stand-in that took nothing out would make a row that says so."""
    greys = np.linspace(0.0, 0.9, 80 * 90, dtype=np.float32).reshape(80, 90) ** 2
    camera = Camera(np.array([[900.0, 0, 45, 0], [0, 900, 40, 0], [0, 0, 1, 0]]))
    view = View("AP", camera, Radiograph(greys), np.ones(greys.shape, bool))
    whole = _targets_of([2], view)
    for name in ("sharp end on the log, not the greys", "one gain and one noise everywhere"):
        (part,) = [one for one in ablations.parts() if one.name == name]
        with part.in_force():
            less = _targets_of([2], view)
        np.testing.assert_array_equal(less[0].along_u, whole[0].along_u)
        assert whole[1].is_local
        assert not (less[1].is_local and np.array_equal(less[1].along_u, whole[1].along_u))


def test_a_part_that_is_none_is_an_error_and_not_an_empty_table(
    ablations: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["ablations.py", "--only", "no such part", "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as left:
        ablations.main()
    assert left.value.code == 2
    assert "--only 'no such part': no part begins so; there are: the whole recipe;" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
