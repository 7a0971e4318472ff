"""`screwpose simulate`: cases of sets, dials, and what is refused."""

import json
from dataclasses import fields
from pathlib import Path

import pytest
from typer.testing import CliRunner

from screwpose.benchmark import sets as benchmark_sets
from screwpose.benchmark.sets_base import BenchmarkSet
from screwpose.cli import making
from screwpose.cli.commands import app
from screwpose.cli.terminal import BAD_INPUT
from screwpose.files.schema import CaseFile, TruthFile
from screwpose.simulation import Imperfections


def program(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["simulate", *words])
    return result.exit_code, result.output


def test_dials_reach_the_case(tmp_path: Path) -> None:
    out = tmp_path / "made"
    words = "--screws 3 --tilt 6 --angle 75 --missing 1 --rotation-error 1.5 --landmark-noise 0 --size 160 --seed 2 -q"
    code, text = program("-o", str(out), *words.split())
    assert (code, text) == (0, "")
    case = CaseFile.model_validate_json((out / "case.json").read_text())
    truth = TruthFile.model_validate_json((out / "truth.json").read_text())
    scene = json.loads((out / "scene.json").read_text())
    assert len(truth.screws) == 3
    assert sum(len(marks) for marks in case.annotations.values()) == 5
    assert all(model.parts and model.pivot for model in case.models.values())
    assert scene["view_angle_deg"] == 75.0
    assert [screw["tower_tilt_deg"] for screw in scene["screws"]] == [6.0] * 3
    assert scene["imperfections"]["rotation_error_deg"] == 1.5
    assert scene["imperfections"]["landmark_noise_px"] == 0.0


def test_every_imperfection_has_its_option(tmp_path: Path) -> None:
    dials = {field.name: 0.01 * (number + 1) for number, field in enumerate(fields(Imperfections))}
    assert sorted(making._DIALS.values()) == sorted(dials)
    words = [f"--{option.replace('_', '-')}={dials[dial]}" for option, dial in making._DIALS.items()]
    code, text = program("-o", str(tmp_path / "made"), "--size", "128", "--seed", "2", "-q", *words)
    assert (code, text) == (0, "")
    assert json.loads((tmp_path / "made" / "scene.json").read_text())["imperfections"] == dials


def test_a_case_of_a_set_is_the_sets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def make(seed: int, index: int, folder: Path) -> Path:
        asked.append((seed, index, folder))
        return folder / "case.json"

    monkeypatch.setitem(benchmark_sets.SETS, "small", BenchmarkSet("small", 1, make, 9, "simulated", "small cases"))
    out = tmp_path / "made"
    code, text = program("--set", "small", "--seed", "2026", "--index", "8", "-o", str(out), "--json")
    assert code == 0
    assert asked == [(2026, 8, out)]
    assert json.loads(text)["case"] == str(out / "case.json")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--set peoples", "--set: there is no benchmark set 'peoples'; expected one of clean, clutter"),
        ("--set paper --index 5", "--index: the set 'paper' has no case 5; expected 0 to 4."),
        ("--set paper --screws 3", "--screws: the set 'paper' decides what its cases are. Leave this option away, or"),
        ("--set paper --cad-length-error 5", "--cad-length-error: the set 'paper' decides"),
        ("--set real", "the set `real` needs the biplane pairs, and SCREWPOSE_DATA is not set"),
        ("--set other", "the set `other` needs other people's screws and spines, and SCREWPOSE_DATA is not set"),
        ("--index 3", "--index: case 3 of no set. Add --set NAME, or use --seed."),
        ("--angle 5", "--angle: 5 is no range for this; expected from 20 to 160"),
        ("--missing 5", "--missing: 5 marks missing of 2 screws; expected at most 1, so that two pairs are left"),
        ("--pincushion -0.08", "--pincushion: -0.08 is out of range; expected more than -0.067, at most 0.5"),
        ("--cad-length-error 100", "--cad-length-error: 100 is out of range; expected from -15 to 15"),
    ],
)
def test_what_cannot_be_made_is_refused(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SCREWPOSE_DATA", raising=False)
    code, text = program("-o", str(tmp_path / "made"), *words.split())
    assert code == BAD_INPUT
    assert message in " ".join(text.split())
    assert not (tmp_path / "made").exists()
