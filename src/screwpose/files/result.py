"""What was answered: the result file's content and, in memory, the posed scenes behind it; a benchmark's summary."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from screwpose._types import FloatArray
from screwpose.files.atomic import write_json
from screwpose.files.schema import RESULT_FORMAT, SUMMARY_FORMAT, ResultFile, SummaryFile
from screwpose.files.wording import read_model


@dataclass(frozen=True, eq=False)
class PosedImplant:
    """A CAD model at a place: `labels` by view name, `world_from_cad` (4, 4) in mm."""

    labels: Mapping[str, str]
    model: str
    world_from_cad: FloatArray


@dataclass(frozen=True, eq=False)
class CombinationScene:
    """The implants of one combination before (`pre`) and after (`post`) registration; `id` as in the result file."""

    id: int
    pre: tuple[PosedImplant, ...]
    post: tuple[PosedImplant, ...]


@dataclass(frozen=True, eq=False)
class Result:
    """The answer.

    Parameters
    ----------
    answer : what result.json says.
    scenes : the combinations that it scored, in its order, best first.
    """

    answer: ResultFile
    scenes: tuple[CombinationScene, ...]


def with_load_time(result: Result, seconds: float) -> Result:
    """The result with the time that reading the case took, in front and in the total."""
    timing = result.answer.timing_s
    timed = {"load": seconds, **timing, "total": timing.get("total", 0.0) + seconds}
    return replace(result, answer=result.answer.model_copy(update={"timing_s": timed}))


def write_result(path: str | Path, answer: ResultFile) -> Path:
    """Write result.json, in one step; returns its path.

    Parameters
    ----------
    path : the file, or a folder that is there already, in which it becomes ``result.json``.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    return write_json(_file_in(path, "result.json"), answer)


def read_result(path: str | Path) -> ResultFile:
    """Read and check a result file, or the ``result.json`` of a folder.

    Raises
    ------
    CaseError
        It is missing or breaks the format; the message names the field.
    """
    return read_model(_file_in(path, "result.json"), ResultFile, RESULT_FORMAT)


def write_summary(path: str | Path, summary: SummaryFile) -> Path:
    """Write the summary.json of a benchmark run, in one step; as `write_result`."""
    return write_json(_file_in(path, "summary.json"), summary)


def read_summary(path: str | Path) -> SummaryFile:
    """Read and check the summary of a benchmark run; as `read_result`."""
    return read_model(_file_in(path, "summary.json"), SummaryFile, SUMMARY_FORMAT)


def _file_in(path: str | Path, name: str) -> Path:
    path = Path(path)
    return path / name if path.is_dir() else path
