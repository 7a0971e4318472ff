"""A benchmark run: what is not done yet is done, here or on many workers, and summed up."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from screwpose._threads import available_threads
from screwpose.benchmark.gate import check_against, read_baseline
from screwpose.benchmark.record import CaseRecord
from screwpose.benchmark.request import BenchRequest, sets_of
from screwpose.benchmark.run_folder import RunFolder, opened
from screwpose.benchmark.run_progress import Forecast
from screwpose.benchmark.sets import BenchmarkSet
from screwpose.benchmark.tasks import CaseTask, MethodOutcome, is_unforeseen, outcomes_of
from screwpose.errors import InputError
from screwpose.registration import Progress

Work = Iterator[tuple[CaseTask, Iterable[MethodOutcome]]]
"""Cases as they are taken up, each with what came of it, method by method."""


@dataclass(frozen=True, eq=False)
class BenchRun:
    """A finished run.

    Parameters
    ----------
    records : one a case and method, in the order of the request.
    notes : what was found amiss in a folder that was gone on in.
    worse : in what the run is worse than its baseline, one sentence each.
    """

    path: Path
    request: BenchRequest
    sets: dict[str, BenchmarkSet]
    records: list[CaseRecord]
    notes: tuple[str, ...]
    worse: tuple[str, ...] = ()

    @property
    def failed(self) -> list[CaseRecord]:
        """The cases that could not be computed."""
        return [one for one in self.records if one.error is not None]

    @property
    def unforeseen(self) -> list[CaseRecord]:
        """Those of them that failed by a bug."""
        return [one for one in self.records if is_unforeseen(one)]


def run_bench(
    request: BenchRequest,
    out: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    keep_cases: bool = False,
    baseline: str | Path | None = None,
    progress: Progress | None = None,
) -> BenchRun:
    """Run methods over cases, and write records, tables and report into `out`.

    Every record is on disk as soon as its case is done. A run that was stopped goes on with `resume`; the records of a
    request are the same, but for times, however often it was stopped and however many workers there were.

    Parameters
    ----------
    workers : processes on this machine; 1: in this one.
    scheduler : the address of a dask scheduler, ``tcp://host:port``, in place of `workers`.
    resume : go on in the folder of the same request.
    keep_cases : keep the cases themselves, in ``cases/``; they can be made again from their seed at any time.
    baseline : the measures.json of an earlier run to compare with.
    progress : called with the share that is done and a few words; what it raises stops the run.

    Raises
    ------
    InputError
        What every case needs is not there: a set's data, a scheduler, the same program on the workers, a number of
        threads.
    OutputError
        The folder cannot be written, holds something else, or another run.
    """
    available_threads()  # a setting that is wrong is wrong for every case
    sets = sets_of(request)
    before = None if baseline is None else read_baseline(baseline)
    with opened(Path(out), request, resume) as folder:
        tasks = folder.tasks(keep_cases)
        forecast = Forecast(request.cases, request.cases - len(tasks), progress or _tell_nobody)
        for task, outcomes in _work(tasks, workers, scheduler, forecast):
            for outcome in outcomes:
                folder.keep(task, outcome)
            forecast.case_done()
        run = _summed_up(folder, sets, baseline, progress or _tell_nobody)
    return run if before is None else replace(run, worse=tuple(check_against(before, run.records)))


def usual_workers() -> int:
    """All cores that this process may use; 1 without the extra `cluster`."""
    return cores() if can_use_workers() else 1


def can_use_workers() -> bool:
    """Whether the extra `cluster` is installed."""
    return find_spec("distributed") is not None


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _work(tasks: list[CaseTask], workers: int, scheduler: str | None, forecast: Forecast) -> Work:
    wanted = min(workers, len(tasks))
    if not tasks or (wanted <= 1 and scheduler is None):
        return _here(tasks, forecast)
    if not can_use_workers():
        raise InputError(
            "the package `distributed` is not installed",
            field="--workers" if scheduler is None else "--scheduler",
            expected="the extra `cluster`",
            remedy="Install screwpose[cluster], or run with --workers 1.",
        )
    from screwpose.benchmark.cluster import on_scheduler, on_this_machine

    return on_this_machine(tasks, wanted, forecast) if scheduler is None else on_scheduler(tasks, scheduler, forecast)


def _here(tasks: list[CaseTask], forecast: Forecast) -> Work:
    for task in tasks:
        yield task, outcomes_of(task, forecast.within_case(task.name))


def _summed_up(
    folder: RunFolder, sets: dict[str, BenchmarkSet], baseline: str | Path | None, tell: Progress
) -> BenchRun:
    from screwpose.benchmark.outputs import write_outputs

    records = folder.records()
    tell(1.0, "writing tables and report")
    write_outputs(folder.path, records, sets, baseline=baseline)
    return BenchRun(folder.path, folder.request, sets, records, folder.notes)


def _tell_nobody(_fraction: float, _what: str) -> None:
    pass
