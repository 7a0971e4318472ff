"""One case of a run, from its making to its records: the unit that is handed to a process or a machine."""

import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from screwpose import __version__
from screwpose.benchmark.folder_set import OwnCases, own_set
from screwpose.benchmark.methods import get_method
from screwpose.benchmark.record import CaseRecord, failed_case, score_case
from screwpose.benchmark.request import AskedMethod, AskedOptions, AskedSet
from screwpose.benchmark.sets import BenchmarkSet, case_seed, get_set
from screwpose.errors import CancelledError, InputError, OutputError, ScrewposeError
from screwpose.files.case import Case, read_case
from screwpose.files.result import with_load_time
from screwpose.files.schema import ResultFile, TruthFile
from screwpose.files.truth import read_truth
from screwpose.registration import Progress

UNFORESEEN = "unforeseen: "
"""How the error of a record begins where it is no error of ours: a bug, of this program or of a user's method."""


@dataclass(frozen=True)
class CaseTask:
    """Make one case, and solve it by every method that has no record of it yet.

    Parameters
    ----------
    program : the version that the run was begun with.
    keep_case : hand the case's files back.
    """

    program: str
    asked: AskedSet
    index: int
    seed: int
    methods: tuple[AskedMethod, ...]
    options: AskedOptions
    own_cases: OwnCases | None = None
    keep_case: bool = False

    @property
    def name(self) -> str:
        """The case's name in the run's folder."""
        return case_name(self.asked.name, self.index)

    @property
    def case_id(self) -> str:
        """What the case is called as long as its own id is not known: the user's name of its folder, or ours."""
        return self.name if self.own_cases is None else self.own_cases.names[self.index]


@dataclass(frozen=True, eq=False)
class MethodOutcome:
    """What one method made of a case.

    Parameters
    ----------
    answer : None where there is none, because of an error; the record says which.
    case_files : the case's files by their path in its folder, in the first outcome of a case that is to be kept.
    """

    method: str
    record: CaseRecord
    answer: ResultFile | None
    case_files: Mapping[str, bytes]


def case_name(set_name: str, index: int) -> str:
    """``pairs-0007``."""
    return f"{set_name}-{index:04d}"


def is_unforeseen(record: CaseRecord) -> bool:
    """Whether a case failed by a bug, not by an error that is foreseen."""
    return record.error is not None and record.error.startswith(UNFORESEEN)


def outcomes_of(task: CaseTask, progress: Progress | None = None) -> Iterator[MethodOutcome]:
    """Make the case, read it, and solve and score it by each method, one after the other.

    What goes wrong in a case is a record too; what would go wrong in every case stops the run.

    Raises
    ------
    InputError
        The data of the set is not here, or another version of the program or of the set is.
    OutputError
        The scratch folder cannot be written.
    """
    cases = _set_of(task)
    with TemporaryDirectory(prefix="screwpose-") as scratch:
        tell = progress or (lambda _fraction, _what: None)
        tell(0.0, "making the case")
        loaded = _loaded(task, cases, Path(scratch) / "case")
        if isinstance(loaded, _Unreadable):
            for asked in task.methods:
                record = _failed(task, asked.name, loaded.problem, 0.0, truth=loaded.truth)
                yield MethodOutcome(asked.name, record, None, {})
            return
        files = _files_in(Path(scratch) / "case") if task.keep_case else {}
        for number, asked in enumerate(task.methods):
            share = 1 / len(task.methods)
            yield _solved(task, asked, loaded, files, _within(tell, number * share, share, f"{asked.name}: "))
            files = {}


def failed_tasks(task: CaseTask, problem: str) -> Iterator[MethodOutcome]:
    """The outcomes of a case that ended without any: its process died."""
    for asked in task.methods:
        yield MethodOutcome(asked.name, _failed(task, asked.name, UNFORESEEN + problem, 0.0), None, {})


@dataclass(frozen=True, eq=False)
class _Loaded:
    """A case in memory, and the seconds that reading it took."""

    case: Case
    truth: TruthFile
    seconds: float


@dataclass(frozen=True, eq=False)
class _Unreadable:
    """Why a case cannot be had, and its truth as far as that can be."""

    problem: str
    truth: TruthFile | None = None


def _set_of(task: CaseTask) -> BenchmarkSet:
    """The set, as this process has it."""
    if task.program != __version__:
        raise InputError(
            f"a worker has screwpose {__version__}, and the run is of {task.program}",
            remedy="Install the same version on every worker.",
        )
    if task.own_cases is not None:
        return own_set(task.own_cases)
    cases = get_set(task.asked.name)
    if str(cases.version) != task.asked.version:
        raise InputError(
            f"the set {cases.name!r} has version {cases.version} here, and the run is of version {task.asked.version}",
            remedy="Go on with the program that the run was begun with.",
        )
    return cases


def _loaded(task: CaseTask, cases: BenchmarkSet, folder: Path) -> _Loaded | _Unreadable:
    truth = None
    try:
        path = cases.make(task.seed, task.index, folder)
    except (CancelledError, InputError, OutputError):
        raise  # data that is not there, a full disk: every further case would end like this one
    except ScrewposeError as error:
        return _Unreadable(f"the case cannot be made: {error}")
    except Exception as error:  # noqa: BLE001  a bug in one case must not cost the run; the record tells of it
        return _Unreadable(_told(error))
    try:
        truth = read_truth(path.parent / "truth.json")
        start = perf_counter()
        return _Loaded(read_case(path), truth, perf_counter() - start)
    except ScrewposeError as error:
        return _Unreadable(str(error), truth)
    except Exception as error:  # noqa: BLE001  as above
        return _Unreadable(_told(error), truth)


def _solved(
    task: CaseTask, asked: AskedMethod, loaded: _Loaded, files: Mapping[str, bytes], progress: Progress
) -> MethodOutcome:
    method = get_method(asked.source or asked.name)
    options = task.options.solve_options(case_seed(f"{task.asked.name}-search", task.seed, task.index))
    start = perf_counter()
    try:
        solved = method.solve(loaded.case, options, progress)
        seconds = loaded.seconds + perf_counter() - start
        result = with_load_time(solved, loaded.seconds)
        record = score_case(
            loaded.case,
            result,
            loaded.truth,
            set_name=task.asked.name,
            set_version=task.asked.version,
            method=asked.name,
            seed=task.seed,
            index=task.index,
            seconds=seconds,
        )
        return MethodOutcome(asked.name, record, result.answer, files)
    except CancelledError:
        raise
    except ScrewposeError as error:
        problem = str(error)
    except Exception as error:  # noqa: BLE001  as above: a user's method may raise anything
        problem = _told(error)
    # The strata of a case may be what the bug is in.
    case = None if problem.startswith(UNFORESEEN) else loaded.case
    record = _failed(task, asked.name, problem, perf_counter() - start, truth=loaded.truth, case=case)
    return MethodOutcome(asked.name, record, None, files)


def _failed(
    task: CaseTask,
    method: str,
    problem: str,
    seconds: float,
    *,
    truth: TruthFile | None = None,
    case: Case | None = None,
) -> CaseRecord:
    return failed_case(
        task.case_id if truth is None else truth.case,
        problem,
        set_name=task.asked.name,
        set_version=task.asked.version,
        method=method,
        seed=task.seed,
        index=task.index,
        seconds=seconds,
        truth=truth,
        case=case,
    )


def _told(error: Exception) -> str:
    """An error that nobody foresaw, with the place where it was raised."""
    lines = "".join(traceback.format_exception(error))
    return f"{UNFORESEEN}{type(error).__name__}: {error}\n{lines}"


def _files_in(folder: Path) -> dict[str, bytes]:
    if not folder.is_dir():  # a user's own cases lie elsewhere
        return {}
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _within(tell: Progress, first: float, share: float, prefix: str) -> Progress:
    return lambda fraction, what: tell(first + share * fraction, prefix + what)
