"""A run from its request to its records: what is done, kept, done again, refused."""

import json
from pathlib import Path

import pytest

from screwpose.benchmark import BenchRequest, BenchRun, make_request, run_bench
from screwpose.benchmark import tasks as bench_tasks
from screwpose.benchmark.record import read_record
from screwpose.benchmark.run_folder import opened
from screwpose.benchmark.run_progress import Forecast, told_duration
from screwpose.benchmark.sets import BenchmarkSet, case_seed
from screwpose.errors import CancelledError, CaseError, GeometryError, InputError, OutputError
from screwpose.files.result import read_result
from tests.benchmark.bench_cases import records_in, write_own_cases
from tests.benchmark.bench_methods import NOTES, PLACE

NEAR, INSTANT = f"{PLACE}:near", f"{PLACE}:instant"


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_own_cases(tmp_path_factory.mktemp("run") / "phantoms", 3)


@pytest.fixture(autouse=True)
def outputs(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Without the page, which has tests of its own; lists how many records it was to be made of."""
    made: list[int] = []
    monkeypatch.setattr(
        "screwpose.benchmark.outputs.write_outputs", lambda _, records, *__, **___: made.append(len(records))
    )
    return made


@pytest.fixture
def attempts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one file for every time that a method took up a case."""
    folder = tmp_path / "attempts"
    folder.mkdir()
    monkeypatch.setenv(NOTES, str(folder))
    return folder


def request(own: Path, *methods: str, **more: object) -> BenchRequest:
    return make_request(cases=own, methods=methods or [NEAR], **more)  # type: ignore[arg-type]


def files_in(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


# ---- what is written


def test_records_and_results_are_where_the_layout_says(own: Path, tmp_path: Path, outputs: list[int]) -> None:
    told: list[tuple[float, str]] = []
    run = run_bench(request(own, NEAR, INSTANT), tmp_path / "run", progress=lambda *said: told.append(said))
    cases = [f"own-phantoms-{index:04d}" for index in range(3)]
    assert files_in(tmp_path / "run") == {
        "run.json",
        *(f"records/{method}/{case}.json" for method in ("near", "instant") for case in cases),
        *(f"results/{method}/{case}/result.json" for method in ("near", "instant") for case in cases),
    }
    assert outputs == [6]
    assert [(one.method, one.index) for one in run.records] == [(m, i) for m in ("near", "instant") for i in range(3)]
    record = read_record(tmp_path / "run/records/near/own-phantoms-0002.json")
    assert record == run.records[2]
    assert (record.set, record.set_version, record.case, record.seed) == ("own-phantoms", "1", "case-2", 1)
    assert record.right
    assert record.seconds >= record.timing_s["load"] > 0  # reading the case counts
    answer = read_result(tmp_path / "run/results/near/own-phantoms-0002")
    assert answer.timing_s["total"] == pytest.approx(2.0 + record.timing_s["load"])
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert any(words.startswith("2 of 3 cases, about ") for _, words in told)


def test_each_case_has_its_own_seed_and_the_options(own: Path, tmp_path: Path) -> None:
    run = run_bench(request(own, INSTANT, seed=7), tmp_path / "run")
    assert [one.reasons for one in run.records] == [
        (f"seed {case_seed('own-phantoms-search', 7, index)}, 1000 faces",) for index in range(3)
    ]


def test_the_same_request_gives_the_same_records(own: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        run_bench(request(own), tmp_path / name)
    first = records_in(tmp_path / "one")
    assert records_in(tmp_path / "two") == first
    run_bench(request(own, seed=2), tmp_path / "other")
    assert records_in(tmp_path / "other") != first  # the comparison can see a difference


def made_set(monkeypatch: pytest.MonkeyPatch, own: Path, error: Exception | None = None) -> BenchRequest:
    """A set whose cases are made, in place of `paper`."""

    def make(seed: int, index: int, folder: Path) -> Path:
        if error is not None and index == 1:
            raise error
        for file in (own / f"case-{index}").iterdir():
            folder.mkdir(exist_ok=True)
            (folder / file.name).write_bytes(file.read_bytes())
        return folder / "case.json"

    from screwpose.benchmark import sets

    monkeypatch.setitem(sets.SETS, "paper", BenchmarkSet("paper", 9, make, 3, "by hand", "three"))
    return make_request(sets=["paper"], methods=[NEAR, INSTANT])


def test_cases_are_kept_if_asked(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = made_set(monkeypatch, own)
    assert [(one.version, one.count) for one in asked.sets] == [("9", 3)]
    run_bench(asked, tmp_path / "kept", keep_cases=True)
    assert files_in(tmp_path / "kept/cases") == {
        f"paper-000{index}/{name}"
        for index in range(3)
        for name in ("AP.png", "LAT.png", "bar.stl", "case.json", "truth.json")
    }
    assert (tmp_path / "kept/cases/paper-0001/AP.png").read_bytes() == (own / "case-1/AP.png").read_bytes()
    run_bench(asked, tmp_path / "not")
    assert not (tmp_path / "not/cases").exists()


# ---- what goes wrong in a case


def failed(run: BenchRun) -> list[tuple[str, int]]:
    return [(one.method, one.index) for one in run.failed]


def test_a_foreseen_error_is_a_record_with_its_text(own: Path, tmp_path: Path) -> None:
    run = run_bench(request(own, f"{PLACE}:behind", INSTANT), tmp_path / "run")
    assert failed(run) == [("behind", 1)]
    assert run.unforeseen == []
    (one,) = run.failed
    assert (one.error, one.status, one.pairs_true) == ("a vertex has depth -3 mm", "refused", 2)
    assert one.strata is not None
    assert not (tmp_path / "run/results/behind/own-phantoms-0001").exists()


def test_an_unforeseen_error_is_a_record_with_its_traceback(own: Path, tmp_path: Path) -> None:
    run = run_bench(request(own, f"{PLACE}:buggy"), tmp_path / "run")
    assert failed(run) == [("buggy", 1)]
    assert run.unforeseen == run.failed
    (one,) = run.failed
    assert one.error is not None
    assert one.error.startswith("unforeseen: KeyError: 'case-1'\nTraceback (most recent call last)")
    assert "bench_methods.py" in one.error
    assert one.pairs_true == 2


def test_bad_cases_of_a_user_are_counted_and_named(tmp_path: Path) -> None:
    own = write_own_cases(tmp_path / "phantoms", 4)
    (own / "case-0/truth.json").unlink()
    (own / "case-1/case.json").write_text('{"format": "screwpose-case/1", ')
    (own / "case-2/AP.png").unlink()
    (own / "notes").mkdir()
    run = run_bench(request(own), tmp_path / "run")
    assert [(one.case, one.index) for one in run.failed] == [("case-0", 0), ("case-1", 1), ("case-2", 2)]
    assert "case-0/truth.json: there is no such file" in str(run.failed[0].error)
    assert "case-1/case.json: not JSON: line 1" in str(run.failed[1].error)
    assert "case-2/case.json: views.AP.image: there is no file `AP.png`" in str(run.failed[2].error)
    assert [one.pairs_true for one in run.failed] == [0, 2, 2]  # as far as their truth can be read
    assert [one.index for one in run.records] == [0, 1, 2, 3]
    assert run.unforeseen == []


def test_a_case_that_cannot_be_made_is_a_record(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_bench(made_set(monkeypatch, own, GeometryError("no room for a screw")), tmp_path / "run")
    assert failed(run) == [("near", 1), ("instant", 1)]
    assert {one.error for one in run.failed} == {"the case cannot be made: no room for a screw"}
    run = run_bench(made_set(monkeypatch, own, ZeroDivisionError("0")), tmp_path / "bug")
    assert len(run.unforeseen) == 2


@pytest.mark.parametrize(
    "error",
    [CaseError("SCREWPOSE_DATA is not set"), OutputError("/tmp: the disk is full"), CancelledError("stop")],
    ids=repr,
)
def test_what_every_case_would_end_by_stops_the_run(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    asked = made_set(monkeypatch, own, error)
    with pytest.raises(type(error), match=str(error)):
        run_bench(asked, tmp_path / "run")
    assert len(records_in(tmp_path / "run")) == 2  # of the case before
    assert (tmp_path / "run" / "run.json").is_file()
    run = run_bench(made_set(monkeypatch, own), tmp_path / "run", resume=True)
    assert (len(run.records), run.failed) == (6, [])


# ---- going on


def test_a_run_goes_on_where_it_was(own: Path, tmp_path: Path, attempts: Path, outputs: list[int]) -> None:
    whole = run_bench(request(own, NEAR, INSTANT), tmp_path / "whole")
    before = len(list(attempts.iterdir()))

    def stop(fraction: float, _what: str) -> None:
        if fraction > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_bench(request(own, NEAR, INSTANT), tmp_path / "run", progress=stop)
    assert outputs == [6]
    done = records_in(tmp_path / "run")
    assert 0 < len(done) < 6
    seen: list[str] = []
    run = run_bench(
        request(own, NEAR, INSTANT), tmp_path / "run", resume=True, progress=lambda _, what: seen.append(what)
    )
    assert len(list(attempts.iterdir())) - before == 6  # each once
    assert records_in(tmp_path / "run") == records_in(tmp_path / "whole")
    assert [one.index for one in run.records] == [one.index for one in whole.records]
    assert run.notes == ()
    run_bench(request(own, NEAR, INSTANT), tmp_path / "run", resume=True)  # nothing is left but the outputs
    assert len(list(attempts.iterdir())) - before == 6
    assert outputs == [6, 6, 6]


def test_a_half_written_record_is_done_again_and_said(own: Path, tmp_path: Path, attempts: Path) -> None:
    run_bench(request(own), tmp_path / "run")
    whole = records_in(tmp_path / "run")
    records = tmp_path / "run/records/near"
    text = (records / "own-phantoms-0001.json").read_text()
    (records / "own-phantoms-0001.json").write_text(text[: len(text) // 2])
    (records / ".own-phantoms-0002.json.ab12.partial").write_text(text[:10])
    run = run_bench(request(own), tmp_path / "run", resume=True)
    (note,) = run.notes
    assert "records/near/own-phantoms-0001.json: not JSON: line " in note
    assert note.endswith("This record is of no use: the case is done again.")
    assert records_in(tmp_path / "run") == whole
    assert len(list(attempts.glob("case-1.*"))) == 2
    assert len(list(attempts.glob("case-2.*"))) == 1
    assert files_in(records) == {f"own-phantoms-000{index}.json" for index in range(3)}


def test_the_record_of_another_case_is_done_again(own: Path, tmp_path: Path) -> None:
    run_bench(request(own), tmp_path / "run")
    whole = records_in(tmp_path / "run")
    records = tmp_path / "run/records/near"
    (records / "own-phantoms-0002.json").write_text((records / "own-phantoms-0001.json").read_text())
    run = run_bench(request(own), tmp_path / "run", resume=True)
    assert len(run.notes) == 1
    assert "own-phantoms-0002.json: this is the record of another case or run" in run.notes[0]
    assert records_in(tmp_path / "run") == whole


def test_a_new_method_file_is_not_mixed_up_with_the_others(own: Path, tmp_path: Path, attempts: Path) -> None:
    """A case that lacks one method's record is solved by that method alone."""
    run_bench(request(own, NEAR, INSTANT), tmp_path / "run")
    before = len(list(attempts.glob("case-1.*")))
    (tmp_path / "run/records/instant/own-phantoms-0001.json").unlink()
    run_bench(request(own, NEAR, INSTANT), tmp_path / "run", resume=True)
    assert len(list(attempts.glob("case-1.*"))) - before == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 2}, r"--seed: 1 in the folder, 2 now"),
        ({"count": 2}, r"--count: own-phantoms 3 in the folder, own-phantoms 2 now"),
        ({"methods": [NEAR, INSTANT]}, r"--method: .*:near in the folder, .*:near, .*:instant now"),
    ],
    ids=str,
)
def test_another_request_in_the_same_folder_is_refused(own: Path, tmp_path: Path, change: dict, said: str) -> None:
    run_bench(request(own), tmp_path / "run")
    before = records_in(tmp_path / "run")
    asked = make_request(**{"cases": own, "methods": [NEAR], **change})
    with pytest.raises(OutputError, match=rf"run: holds another run \({said}\)\. Ask for the same as before"):
        run_bench(asked, tmp_path / "run", resume=True)
    assert records_in(tmp_path / "run") == before


def test_a_run_is_not_begun_over_another(own: Path, tmp_path: Path) -> None:
    run_bench(request(own), tmp_path / "run")
    before = files_in(tmp_path / "run")
    with pytest.raises(OutputError, match=r"run: holds a benchmark run that was begun .* Go on with it by --resume"):
        run_bench(request(own), tmp_path / "run")
    assert files_in(tmp_path / "run") == before


@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_that_is_not_a_benchs_is_left_alone(own: Path, tmp_path: Path, resume: bool) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(
        OutputError, match=r"the folder is not empty and holds no run\.json, so it is no earlier output"
    ):
        run_bench(request(own), tmp_path, resume=resume)
    assert files_in(tmp_path) == {"thesis.txt"}
    run_bench(request(own), tmp_path / "new", resume=True)  # where nothing is yet, a run is begun
    assert len(records_in(tmp_path / "new")) == 3


def test_a_run_json_that_is_none_is_named(own: Path, tmp_path: Path) -> None:
    run_bench(request(own), tmp_path / "run")
    (tmp_path / "run/run.json").write_text('{"format": "screwpose-run/1", "sead": 1}')
    with pytest.raises(CaseError, match=r"run\.json: .*the key is missing|run\.json: sead: unknown key"):
        run_bench(request(own), tmp_path / "run", resume=True)
    assert len(records_in(tmp_path / "run")) == 3


def test_two_runs_do_not_share_a_folder(own: Path, tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    with (
        opened(tmp_path / "run", request(own), resume=False),
        pytest.raises(OutputError, match="run: another run is at work in this folder"),
    ):
        run_bench(request(own), tmp_path / "run", resume=True)
    run_bench(request(own), tmp_path / "run", resume=True)


def test_a_folder_that_cannot_be_written_is_found_before_the_work(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, attempts: Path
) -> None:
    def refused(self: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "mkdir", refused)  # tests may run as root, whom no mode stops
    with pytest.raises(
        OutputError, match=r"run: cannot be written: Permission denied\. Choose a folder that you may write"
    ):
        run_bench(request(own), tmp_path / "run")
    assert list(attempts.iterdir()) == []


def test_a_disk_that_fills_up_stops_the_run_and_costs_nothing(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from screwpose.benchmark import run_folder

    write = run_folder.write_record

    def full(path: Path, record: object) -> Path:
        if path.name.endswith("2.json"):
            raise OutputError(f"{path}: cannot be written: No space left on device.")
        return write(path, record)  # type: ignore[arg-type]

    monkeypatch.setattr(run_folder, "write_record", full)
    with pytest.raises(OutputError, match="No space left on device"):
        run_bench(request(own), tmp_path / "run")
    monkeypatch.setattr(run_folder, "write_record", write)
    assert len(records_in(tmp_path / "run")) == 2
    assert len(run_bench(request(own), tmp_path / "run", resume=True).records) == 3


def test_a_worker_of_another_version_is_refused(own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_tasks, "__version__", "9.9")
    with pytest.raises(InputError, match=r"a worker has screwpose 9\.9, and the run is of .*Install the same version"):
        run_bench(request(own), tmp_path / "run")


# ---- the forecast


def test_the_forecast_by_hand() -> None:
    now = [100.0]
    told: list[tuple[float, str]] = []
    forecast = Forecast(10, 4, lambda *said: told.append(said), clock=lambda: now[0])
    forecast.within_case("pairs-0004")(0.1, "placing")
    now[0] = 160.0
    forecast.case_done()  # one in 60 s: five are left
    now[0] = 250.0
    forecast.say("near", 0.5)  # 1.5 in 150 s: 4.5 are left
    assert told[0] == (pytest.approx(0.41), "4 of 10 cases, pairs-0004: placing")
    assert told[1] == (0.5, "5 of 10 cases, about 5 min left")
    assert told[2] == (pytest.approx(0.55), "5 of 10 cases, about 8 min left, near")


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.4, "0 s"), (59.4, "59 s"), (59.6, "1 min"), (5399, "90 min"), (12000, "3 h 20 min")]
)
def test_durations(seconds: float, words: str) -> None:
    assert told_duration(seconds) == (words if words != "90 min" else "1 h 30 min")


def test_run_json_says_what_was_asked(own: Path, tmp_path: Path) -> None:
    run_bench(request(own, NEAR, seed=3), tmp_path / "run")
    asked = json.loads((tmp_path / "run/run.json").read_text())
    assert asked["format"] == "screwpose-run/1"
    assert asked["seed"] == 3
    assert asked["methods"] == [{"name": "near", "source": NEAR}]
    assert asked["own_cases"] == {"folder": str(own), "names": ["case-0", "case-1", "case-2"]}
    assert asked["options"]["generations"] == 60
