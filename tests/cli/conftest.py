"""One small simulated case for all tests of the program."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from screwpose.files import Result, write_result
from screwpose.files.case import Annotation
from screwpose.geometry.camera import Camera
from screwpose.implants.design import ScrewDesign
from screwpose.simulation import Imperfections, SceneOptions, ScenePlan, plan_scene, write_case, xrayed
from tests.cli.case_folder import CaseFolder


def _planned() -> ScenePlan:
    """Two screws, left and right of one level, where good_case.json says: messages name its numbers, and what a mistake
    looks like depends on them, so that they are not left to the simulator's draws."""
    given = json.loads((Path(__file__).parent / "good_case.json").read_text())
    design = ScrewDesign(shank_diameter_mm=5.5, shank_length_mm=50.0, tower_length_mm=80.0)
    plan = plan_scene(SceneOptions(image_size=(256, 256)), Imperfections(), 7, designs=(design, design))
    cameras = {view: Camera(np.array(rows), (256, 256)) for view, rows in given["projections"].items()}
    marks = {
        view: tuple(
            Annotation(label, np.array(tip), np.array(center), "ms55x50") for label, (tip, center) in of.items()
        )
        for view, of in given["marks"].items()
    }
    screws = tuple(
        replace(screw, world_from_cad=np.array(one["world_from_cad"]))
        for screw, one in zip(plan.screws, given["screws"], strict=True)
    )
    labels = tuple(one["labels"] for one in given["screws"])
    return replace(
        plan, screws=screws, labels=labels, cameras=cameras, true_cameras=cameras, annotations=marks, missing=()
    )


@pytest.fixture(scope="session")
def good_case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a good case, 256 x 256 px; to be left as it is."""
    folder = tmp_path_factory.mktemp("cli") / "good"
    write_case(xrayed(_planned()), folder)
    return folder


@pytest.fixture
def case(good_case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CaseFolder:
    """A copy of it to spoil, in the folder ``case`` below the current one."""
    monkeypatch.chdir(tmp_path)
    return CaseFolder.copied(good_case, Path("case"))


@pytest.fixture
def brief_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer alone: pictures take most of a small case's time, and are tried in test_cli_program.py."""

    def write(folder: Path, _case: object, result: Result, *_: object) -> None:
        write_result(folder / "result.json", result.answer)

    monkeypatch.setattr("screwpose.report.writing.write_report", write)
