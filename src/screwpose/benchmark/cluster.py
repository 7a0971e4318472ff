"""Cases on many processes or machines, through dask.distributed (the extra `cluster`).

What comes of a case travels back to the process that asked, which alone writes: no file system has to be shared. A
task whose worker dies is done again by another; each case comes back once.
"""

import contextlib
import logging
import os
import pickle
import secrets
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from importlib import import_module
from multiprocessing import resource_tracker
from typing import Any

from screwpose.benchmark.run_progress import Forecast
from screwpose.benchmark.tasks import CaseTask, MethodOutcome, failed_tasks, outcomes_of
from screwpose.errors import InputError

_CONNECT_S = 5.0
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
# Dask has its workers give every freed array back to the system at once; images made and dropped a hundred times a
# second then cost more in page faults than in arithmetic (measured: registration 7 s in place of 3).
_KEEP_MEMORY = {"MALLOC_TRIM_THRESHOLD_": str(1 << 30), "MALLOC_MMAP_THRESHOLD_": str(1 << 30)}

Work = Iterator[tuple[CaseTask, Sequence[MethodOutcome]]]


def on_this_machine(tasks: list[CaseTask], workers: int, forecast: Forecast) -> Work:
    """Do the cases in processes of this machine; they can be reached from it alone."""
    distributed = import_module("distributed")
    forecast.say(f"starting {workers} workers")
    with (
        _quiet_logs(),
        _deaf_to_ctrl_c(lambda: _local_cluster(workers)) as cluster,
        distributed.Client(cluster) as client,
    ):
        try:
            yield from _gathered(client, tasks, forecast)
        except BaseException:
            # Closing lets every worker end its case first, which may take a minute. Nothing of it would be kept.
            for nanny in list(cluster.workers.values()):
                with contextlib.suppress(OSError, TypeError):  # it is gone, or was never there
                    os.kill(nanny.pid, signal.SIGKILL)
            raise


def _local_cluster(workers: int) -> Any:
    # A process that is forked after threads have run can hang: numba's have.
    settings = {
        "distributed.worker.multiprocessing-method": "spawn",
        "distributed.nanny.pre-spawn-environ": _ONE_THREAD | _KEEP_MEMORY,
    }
    with import_module("dask").config.set(settings):
        return import_module("distributed").LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,  # a worker that is killed for its size would be killed again by the same case
            env=_ONE_THREAD,
            silence_logs=logging.CRITICAL,
        )


def _deaf_to_ctrl_c(start: Callable[[], Any]) -> Any:
    """What `start` returns, made in a thread that no Ctrl-C reaches, nor the processes that it starts, then or later.

    A terminal sends Ctrl-C to all of them. This process alone is to answer it, while it waits here too.
    """
    # Its start opens a thread's ears again, so it must not come with the first worker's.
    resource_tracker.ensure_running()
    made: list[Any] = []
    failed: list[Exception] = []

    def run() -> None:
        if hasattr(signal, "pthread_sigmask"):  # not on Windows
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            made.append(start())
        except Exception as error:  # noqa: BLE001  raised again below, in the thread that asked
            failed.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return made[0]


def on_scheduler(tasks: list[CaseTask], address: str, forecast: Forecast) -> Work:
    """Do the cases on the workers of a cluster that runs already.

    Raises
    ------
    InputError
        No scheduler answers at the address, or it stopped answering.
    """
    distributed = import_module("distributed")
    with _quiet_logs():
        try:
            # A client of no address at all would be ten seconds in closing, and not in silence.
            distributed.comm.get_address_host_port(address)
            client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"no dask scheduler answers at {address!r} ({_first_line(error)})",
                field="--scheduler",
                expected="the address of one that runs, as tcp://host:8786",
                remedy="Start one with `dask scheduler`, or leave --scheduler out to run on this machine.",
            ) from error
        with client:
            _wait_for_workers(client, address, forecast)
            yield from _gathered(client, tasks, forecast)


def _gathered(client: Any, tasks: list[CaseTask], forecast: Forecast) -> Work:
    """Every case once, as they are done."""
    distributed = import_module("distributed")
    gone = (CancelledError, distributed.comm.CommClosedError, TimeoutError)
    # Keys of our own: a case that was done before, with another program perhaps, is not taken from the scheduler.
    run = secrets.token_hex(4)
    packed = [pickle.dumps(task) for task in tasks]
    futures = client.map(_courier(), packed, key=[f"{task.name}-{run}" for task in tasks], pure=False)
    task_of = dict(zip((future.key for future in futures), tasks, strict=True))
    finished = distributed.as_completed(futures, loop=client.loop)
    del futures
    forecast.say()
    for future in finished:
        task = task_of[future.key]
        try:
            outcomes = pickle.loads(future.result())
        except distributed.KilledWorker as error:
            outcomes = list(failed_tasks(task, f"the worker process died, and so did those that tried again ({error})"))
        except ImportError as error:
            raise InputError(
                f"a worker cannot import the program ({error})",
                field="--scheduler",
                remedy="Install the same version of screwpose, and of your own methods, on every worker.",
            ) from error
        except gone as error:
            raise InputError(
                "the dask scheduler has stopped answering",
                field="--scheduler",
                remedy="What is done is kept: go on with --resume when it runs again.",
            ) from error
        yield task, outcomes
        future.release()


def _courier() -> Callable[[bytes], bytes]:
    """The function that is sent to the workers, with task and outcomes as bytes.

    It is made in here so that it travels with its code. A worker on which screwpose is not installed, or broken, can
    then say so; were the function or the task looked up by name there, the worker would fail before it can answer.
    """

    def solve_case(packed: bytes) -> bytes:
        import pickle

        task = pickle.loads(packed)
        from screwpose.benchmark.cluster import on_worker

        return pickle.dumps(on_worker(task))

    return solve_case


def on_worker(task: CaseTask) -> list[MethodOutcome]:
    """Do one case in a worker's process.

    Raises
    ------
    InputError
        The worker has several threads: compiled loops would disturb each other, and the times would mean nothing.
    """
    import cv2

    threads = import_module("distributed").get_worker().state.nthreads
    if threads != 1:
        raise InputError(
            f"a worker runs {threads} cases at a time in one process",
            field="--scheduler",
            expected="one thread a worker",
            remedy="Start the workers with `dask worker --nthreads 1 --nworkers N`.",
        )
    cv2.setNumThreads(1)
    return list(outcomes_of(task))


def _wait_for_workers(client: Any, address: str, forecast: Forecast) -> None:
    while not client.scheduler_info()["workers"]:
        forecast.say(f"no worker at {address} yet: waiting")
        with contextlib.suppress(TimeoutError):
            client.wait_for_workers(1, timeout=2)


@contextlib.contextmanager
def _quiet_logs() -> Iterator[None]:
    """Keep dask's own words off the terminal: what matters is said by an error of ours.

    After an error or Ctrl-C they stay off: what comes undone behind us is no news, and comes late, from other threads.
    """
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    yield
    for name, level in before.items():
        logging.getLogger(name).setLevel(level)


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]
