"""What is true: the poses of a simulated or measured case. Solving never reads them; scoring alone does."""

from pathlib import Path

from screwpose.files.atomic import write_json
from screwpose.files.schema import TRUTH_FORMAT, TruthFile
from screwpose.files.wording import read_model


def read_truth(path: str | Path) -> TruthFile:
    """Read and check a truth file, or the ``truth.json`` of a folder.

    Raises
    ------
    CaseError
        It is missing or breaks the format; the message names the field.
    """
    return read_model(_truth_file(path), TruthFile, TRUTH_FORMAT)


def write_truth(path: str | Path, truth: TruthFile) -> Path:
    """Write a truth file, or the ``truth.json`` of a folder, in one step; returns its path.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    return write_json(_truth_file(path), truth)


def _truth_file(path: str | Path) -> Path:
    path = Path(path)
    return path / "truth.json" if path.is_dir() else path
