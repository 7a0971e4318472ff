"""Cases on several processes: what a worker's death, a missing scheduler or a wrong worker leads to."""

import socket
from pathlib import Path
from time import perf_counter

import pytest

from screwpose.benchmark import BenchRequest, make_request, run_bench
from screwpose.benchmark.cluster import on_scheduler
from screwpose.benchmark.record import CaseRecord
from screwpose.benchmark.run_folder import opened
from screwpose.benchmark.run_progress import Forecast
from screwpose.errors import InputError
from tests.benchmark.bench_cases import records_in, write_own_cases
from tests.benchmark.bench_methods import KILLS_ALWAYS, KILLS_ONCE, NOTES, PLACE

distributed = pytest.importorskip("distributed")
dask = pytest.importorskip("dask")


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_own_cases(tmp_path_factory.mktemp("cluster") / "phantoms", 5)


@pytest.fixture(autouse=True)
def _without_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("screwpose.benchmark.outputs.write_outputs", lambda *_, **__: [])


def test_a_worker_that_is_killed_midway_costs_no_case(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = make_request(cases=own, methods=[f"{PLACE}:near", f"{PLACE}:instant"])
    serial = run_bench(request, tmp_path / "serial")
    notes = tmp_path / "notes"
    notes.mkdir()
    monkeypatch.setenv(NOTES, str(notes))
    monkeypatch.setenv(KILLS_ONCE, "case-2")
    written: list[CaseRecord] = []
    keep = "screwpose.benchmark.run_folder.write_record"
    from screwpose.benchmark import run_folder

    write_record = run_folder.write_record
    monkeypatch.setattr(keep, lambda path, record: (written.append(record), write_record(path, record))[1])
    spread = run_bench(request, tmp_path / "spread", workers=2)

    attempts = [path.name for path in notes.glob("case-2.*")]
    assert len(attempts) >= 2  # it was killed, and tried again: by another process
    assert len({name.split(".")[-1] for name in attempts}) >= 2
    assert [(one.method, one.index) for one in spread.records] == [
        (method, index) for method in ("near", "instant") for index in range(5)
    ]
    assert len(written) == 10  # none twice
    assert len({(one.method, one.index) for one in written}) == 10
    assert records_in(tmp_path / "spread") == records_in(tmp_path / "serial")
    assert spread.failed == serial.failed == []
    assert any(one.screws[0].errors is not None for one in spread.records)  # there was something to compare


def test_a_case_that_kills_every_worker_is_recorded(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(KILLS_ALWAYS, "case-0")
    request = make_request(cases=own, methods=[f"{PLACE}:instant"], count=3)
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        run = run_bench(request, tmp_path / "run", workers=2)
    assert len(run.records) == 3
    dead = [one for one in run.records if one.index == 0]
    assert len(dead) == 1
    assert run.unforeseen == run.failed
    assert dead[0] in run.unforeseen
    assert dead[0].error is not None
    assert dead[0].error.startswith("unforeseen: the worker process died, and so did those that tried again")
    assert dead[0].case == "case-0"


def tasks_and_forecast(request: BenchRequest, folder: Path) -> tuple[list, Forecast]:
    with opened(folder, request, resume=False) as run:
        tasks = run.tasks(keep_cases=False)
    return tasks, Forecast(len(tasks), 0, lambda *_: None)


def test_a_scheduler_that_is_not_there_is_one_clear_error_in_seconds(own: Path, tmp_path: Path) -> None:
    with socket.socket() as taken:  # bound and not listening: nobody answers
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        request = make_request(cases=own, methods=[f"{PLACE}:instant"])
        start = perf_counter()
        with pytest.raises(
            InputError, match=rf"--scheduler: no dask scheduler answers at '{address}' .*tcp://host:8786"
        ):
            run_bench(request, tmp_path / "run", scheduler=address)
        assert perf_counter() - start < 10
    assert not (tmp_path / "run").exists()  # nothing was done: what is asked next may begin there


@pytest.mark.parametrize("address", ["nonsense://x", "nonsense", "tcp://host"])
def test_what_is_no_address_is_said_at_once(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    request = make_request(cases=own, methods=[f"{PLACE}:instant"])
    # A client that cannot begin takes ten seconds to close, and ends in a traceback.
    monkeypatch.setattr(distributed, "Client", None)
    with pytest.raises(InputError, match=rf"no dask scheduler answers at '{address}'"):
        run_bench(request, tmp_path / "run", scheduler=address)


def test_a_running_cluster_takes_the_cases(own: Path, tmp_path: Path) -> None:
    request = make_request(cases=own, methods=[f"{PLACE}:instant"])
    here = run_bench(request, tmp_path / "here")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        protocol="tcp://",
    ) as cluster:
        there = run_bench(request, tmp_path / "there", scheduler=cluster.scheduler_address)
    assert len(there.records) == 5
    assert records_in(tmp_path / "there") == records_in(tmp_path / "here")
    assert here.failed == there.failed == []


def test_a_scheduler_that_goes_away_keeps_what_is_done(own: Path, tmp_path: Path) -> None:
    tasks, forecast = tasks_and_forecast(make_request(cases=own, methods=[f"{PLACE}:instant"]), tmp_path / "run")
    cluster = distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        protocol="tcp://",
    )
    work = on_scheduler(tasks, cluster.scheduler_address, forecast)
    task, outcomes = next(work)
    assert [(outcome.method, outcome.record.index) for outcome in outcomes] == [("instant", task.index)]
    start = perf_counter()
    cluster.close()
    with pytest.raises(InputError, match=r"--scheduler: the dask scheduler has stopped answering\. .* --resume"):
        list(work)
    assert perf_counter() - start < 20


def test_a_worker_with_threads_is_refused(own: Path, tmp_path: Path) -> None:
    tasks, forecast = tasks_and_forecast(make_request(cases=own, methods=[f"{PLACE}:instant"]), tmp_path / "run")
    with (
        distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=2,
            processes=False,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            protocol="tcp://",
        ) as cluster,
        pytest.raises(InputError, match=r"a worker runs 2 cases at a time in one process; .*--nthreads 1") as refused,
    ):
        list(on_scheduler(tasks, cluster.scheduler_address, forecast))
    assert refused.value.field == "--scheduler"


def test_without_the_extra_workers_are_refused_by_name(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("screwpose.benchmark.runner.can_use_workers", lambda: False)
    request = make_request(cases=own, methods=[f"{PLACE}:instant"])
    with pytest.raises(
        InputError, match=r"--workers: the package `distributed` is not installed.*screwpose\[cluster\]"
    ):
        run_bench(request, tmp_path / "run", workers=2)
    with pytest.raises(InputError, match="--scheduler: the package `distributed` is not installed"):
        run_bench(request, tmp_path / "run", scheduler="tcp://127.0.0.1:1", resume=True)
