"""The folder of a run: what was asked, the records that are done, and who is at work in it.

::

    run.json                            what was asked
    records/<method>/<set>-<index>.json what came of one case by one method: this file says that it is done
    results/<method>/<set>-<index>/     its result.json
    cases/<set>-<index>/                the case itself, if cases are kept

Every file appears whole or not at all, so that a run may be stopped, or die, at any moment.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from screwpose.benchmark.record import CaseRecord, read_record, write_record
from screwpose.benchmark.request import RUN_FILE, BenchRequest, read_request
from screwpose.benchmark.tasks import CaseTask, MethodOutcome, case_name
from screwpose.errors import CaseError, InputError, OutputError
from screwpose.files.atomic import atomic_folder, ensure_can_write_folder, write_bytes, write_json
from screwpose.files.result import write_result

Key = tuple[str, str, int]
"""Method, set, index."""


@dataclass(frozen=True)
class RunFolder:
    """A run on disk.

    Parameters
    ----------
    done : the records that are there, by method, set and index; `keep` adds to them.
    notes : what was found amiss when the folder was opened.
    """

    path: Path
    request: BenchRequest
    done: dict[Key, CaseRecord] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def tasks(self, keep_cases: bool) -> list[CaseTask]:
        """What is left to do: one task a case, in the order of the request, with the methods that it lacks."""
        request = self.request
        tasks = []
        for asked in request.sets:
            for index in range(asked.count):
                missing = tuple(one for one in request.methods if (one.name, asked.name, index) not in self.done)
                if missing:
                    tasks.append(
                        CaseTask(
                            program=request.software.version,
                            asked=asked,
                            index=index,
                            seed=request.seed,
                            methods=missing,
                            options=request.options,
                            own_cases=request.own_cases,
                            keep_case=keep_cases and request.own_cases is None,
                        )
                    )
        return tasks

    def keep(self, task: CaseTask, outcome: MethodOutcome) -> None:
        """Write what came of a case by a method; the record comes last.

        Raises
        ------
        OutputError
            It cannot be written.
        """
        if outcome.case_files:
            _write_files(self.path / "cases" / task.name, outcome.case_files)
        if outcome.answer is not None:
            write_result(_made(self.path / "results" / outcome.method / task.name), outcome.answer)
        write_record(_made(self.path / "records" / outcome.method) / f"{task.name}.json", outcome.record)
        self.done[outcome.method, task.asked.name, task.index] = outcome.record

    def records(self) -> list[CaseRecord]:
        """All records, by method, then set, then index, as the request names them, whatever the order they came in."""
        keys = _keys(self.request)
        return [self.done[key] for key in keys if key in self.done]


@contextlib.contextmanager
def opened(path: Path, request: BenchRequest, resume: bool) -> Iterator[RunFolder]:
    """Begin a run's folder, or go on in it, alone.

    Parameters
    ----------
    resume : go on where the run of the same request stopped. A folder that is not there yet, or empty, is begun.

    Raises
    ------
    OutputError
        The folder cannot be written, holds something else, another request's run, or a run while not to be resumed.
    CaseError
        Its run.json cannot be used.

    Notes
    -----
    A folder that was begun here is taken back where an `InputError` ends the run before its first record.
    """
    stored = stored_request(path)
    if stored is not None:
        if not resume:
            raise OutputError(
                f"{path}: holds a benchmark run that was begun {stored.started}. Go on with it by --resume, or choose "
                "another folder."
            )
        difference = stored.difference(request)
        if difference:
            raise OutputError(
                f"{path}: holds another run ({difference}). Ask for the same as before, or choose another folder."
            )
    with _alone(_made(path)):
        if stored is None:
            write_json(path / RUN_FILE, request)
        else:
            _remove_partials(path)
        done, notes = _found(path, stored or request)
        folder = RunFolder(path, stored or request, done, tuple(notes))
        try:
            yield folder
        except InputError:
            if stored is None and not folder.done:
                _take_back(path)
            raise


def _take_back(path: Path) -> None:
    """What was asked for cannot be done: leave the folder free for what is asked for next."""
    with contextlib.suppress(OSError):
        (path / RUN_FILE).unlink()
        path.rmdir()


def stored_request(path: Path) -> BenchRequest | None:
    """What a folder's run was asked for; None where a run could be begun there.

    Raises
    ------
    OutputError
        The folder cannot be written, or holds something else.
    CaseError
        Its run.json cannot be used.
    """
    if (path / RUN_FILE).is_file():
        return read_request(path / RUN_FILE)
    ensure_can_write_folder(path, marker=RUN_FILE)
    return None


def _keys(request: BenchRequest) -> list[Key]:
    return [
        (method.name, asked.name, index)
        for asked in request.sets
        for method in request.methods
        for index in range(asked.count)
    ]


def _found(path: Path, request: BenchRequest) -> tuple[dict[Key, CaseRecord], list[str]]:
    """The records that are there, and a word on each that cannot be used: its case is done again."""
    done, notes = {}, []
    for key in _keys(request):
        method, set_name, index = key
        file = path / "records" / method / f"{case_name(set_name, index)}.json"
        if not file.exists():
            continue
        try:
            record = read_record(file)
        except CaseError as error:
            notes.append(f"{error} This record is of no use: the case is done again.")
            continue
        if (record.method, record.set, record.index, record.seed) == (*key, request.seed):
            done[key] = record
        else:
            notes.append(f"{file}: this is the record of another case or run: the case is done again.")
    return done, notes


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be made: {error.strerror}. Choose a folder that you may write to."
        ) from error
    return folder


def _write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    with atomic_folder(folder, marker="case.json") as partial:
        for name, data in files.items():
            write_bytes(_made((partial / name).parent) / Path(name).name, data)


def _remove_partials(path: Path) -> None:
    """What a run that was killed had begun to write."""
    for pattern in (".*.partial", "records/*/.*.partial", "results/*/*/.*.partial"):
        for leftover in path.glob(pattern):
            with contextlib.suppress(OSError):
                leftover.unlink()


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep a second run out of the folder. The lock ends with the process, however that ends."""
    try:
        import fcntl
    except ImportError:  # not on Windows
        yield
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be read: {error.strerror}. Choose a folder that you may read and write."
        ) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OutputError(f"{folder}: another run is at work in this folder. Wait for it, or stop it.") from error
        except OSError:
            pass  # a file system without locks: nothing can be said
        yield
    finally:
        os.close(handle)
