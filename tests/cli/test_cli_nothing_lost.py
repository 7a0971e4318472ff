"""An output replaces only what it may: never the case it was made from, never somebody's own case."""

from pathlib import Path

import pytest

from screwpose.cli.jobs import solve_files
from screwpose.errors import OutputError
from screwpose.simulation import two_screw_scene, write_case
from screwpose.solve import SolveOptions


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("case_name", [".", "case", "case/case.json"])
def test_the_case_in_an_earlier_output_is_not_replaced_with_it(tmp_path: Path, case_name: str) -> None:
    out = tmp_path / "demo"
    (out / "case").mkdir(parents=True)
    for name in ("result.json", "case.json", "case/case.json"):
        (out / name).write_text("{}")
    before = files_in(tmp_path)
    with pytest.raises(OutputError, match=r"demo: the case .* lies in this folder.*Write to another folder"):
        solve_files(out / case_name, out, SolveOptions(), lambda *_: None)
    assert files_in(tmp_path) == before


def test_a_simulated_case_does_not_replace_somebodys_own(tmp_path: Path) -> None:
    simulated = two_screw_scene(3, image_size=(128, 128), with_anatomy=False)
    own = tmp_path / "mine"
    own.mkdir()
    (own / "case.json").write_text("{}")
    (own / "ap.dcm").write_bytes(b"the only copy")
    before = files_in(tmp_path)
    with pytest.raises(OutputError, match="mine"):
        write_case(simulated, own)
    assert files_in(tmp_path) == before
    write_case(simulated, tmp_path / "new")
    write_case(simulated, tmp_path / "new")  # an earlier simulated case is replaced
    assert (tmp_path / "new" / "truth.json").is_file()
