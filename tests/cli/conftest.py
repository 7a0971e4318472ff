"""One small simulated case for all tests of the program."""

from pathlib import Path

import pytest

from screwpose.files import Result, write_result
from screwpose.simulation.scenes import two_screw_scene
from screwpose.simulation.writing import write_case
from tests.cli.case_folder import CaseFolder


@pytest.fixture(scope="session")
def good_case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a good case, 256 x 256 px; to be left as it is."""
    folder = tmp_path_factory.mktemp("cli") / "good"
    write_case(two_screw_scene(7, landmark_noise_px=0.4, image_size=(256, 256)), folder)
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
