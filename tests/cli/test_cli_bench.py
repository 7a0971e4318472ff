"""`screwpose bench`: what it writes and says, how it is stopped and goes on, and what it refuses."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import pytest
from typer.testing import CliRunner, Result

from screwpose.cli import app
from tests.benchmark.bench_cases import records_in, write_own_cases
from tests.benchmark.bench_methods import PLACE

RUN = CliRunner()
NEAR, INSTANT, BUGGY, BEHIND = (f"{PLACE}:{name}" for name in ("near", "instant", "buggy", "behind"))


def program(*arguments: str | Path) -> Result:
    result = RUN.invoke(app, ["bench", *(str(argument) for argument in arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def said(result: Result) -> str:
    """The error, on one line."""
    return " ".join(result.stderr.split())


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_own_cases(Path("phantoms"), 3)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """A summary alone in the place of tables and page."""
    summary = {
        "format": "screwpose-summary/1",
        "sets": {},
        "seed": 1,
        "started": "today",
        "machine": "this one",
        "software": {"name": "screwpose", "version": "0"},
    }

    def write(folder: Path, *_: object, **__: object) -> None:
        (folder / "summary.json").write_text(json.dumps(summary))

    monkeypatch.setattr("screwpose.benchmark.outputs.write_outputs", write)


def test_a_run_of_own_cases_by_two_methods(own: Path) -> None:
    result = program("--cases", own, "--method", f"{NEAR}, {INSTANT}", "-o", "run", "--workers", "1")
    assert result.exit_code == 0, result.output
    assert {"run.json", "records", "results", "summary.json", "cases.csv", "report.html"} <= {
        entry.name for entry in Path("run").iterdir()
    }
    text = " ".join(result.stdout.split())
    assert "own-phantoms, near: 3 cases; right 100.0%; sure and wrong 0.0%; refused 0.0%; tip 0." in text
    assert "own-phantoms, instant: 3 cases; right 0.0%; sure and wrong 0.0%; refused 100.0%" in text
    assert text.endswith("Everything is in run: open run/report.html")
    assert max(map(len, result.stdout.splitlines())) <= 80
    lines = result.stderr.splitlines()
    assert any(re.fullmatch(r" *\d+%  2 of 3 cases, about \d+ s left.*", line) for line in lines)
    again = program("-o", "run", "--resume", "--json")
    assert json.loads(again.stdout) == json.loads(Path("run/summary.json").read_text())
    assert again.stderr == ""


def test_the_list_needs_no_folder() -> None:
    text = " ".join(program("--list").stdout.split())
    assert "pairs (version 1, 1000 cases): two screws" in text
    assert "epipolar: pairing by epipolar distance alone" in text
    listed = json.loads(program("--list", "--json").stdout)
    assert listed["sets"]["hard"]["size"] == 500
    assert {"paper", "epipolar", "default"} <= set(listed["methods"])


@pytest.mark.usefixtures("brief")
def test_a_bug_in_a_case_is_counted_and_leaves_by_1(own: Path) -> None:
    result = program("--cases", own, "--method", f"{BUGGY},{NEAR}", "-o", "run", "--workers", "1")
    assert result.exit_code == 1
    assert "1 could not be computed, and count as refused:" in result.stdout
    assert "own-phantoms-0001 (case-1), buggy: KeyError: 'case-1'" in result.stdout
    assert "screwpose: 1 of 6 failed by an error that is not foreseen, a bug" in said(result)
    assert len(records_in(Path("run"))) == 6


@pytest.mark.usefixtures("brief")
def test_bad_cases_are_named_and_not_fatal(own: Path) -> None:
    (own / "case-0/truth.json").unlink()
    result = program("--cases", own, "--method", BEHIND, "-o", "run", "--workers", "1")
    assert result.exit_code == 0
    text = " ".join(result.stdout.split())
    assert "2 could not be computed, and count as refused: own-phantoms-0000 (case-0), behind: " in text
    assert "case-0/truth.json: there is no such file" in text
    assert "own-phantoms-0001 (case-1), behind: a vertex has depth -3 mm" in text


@pytest.mark.usefixtures("brief")
def test_a_half_written_record_is_said(own: Path) -> None:
    program("--cases", own, "--method", NEAR, "-o", "run", "--workers", "1")
    whole = records_in(Path("run"))
    record = Path("run/records/near/own-phantoms-0001.json")
    record.write_text(record.read_text()[:200])
    result = program("-o", "run", "--resume", "--workers", "1")
    assert result.exit_code == 0
    assert "own-phantoms-0001.json: not JSON" in result.stdout
    assert "the case is done again" in " ".join(result.stdout.split())
    assert records_in(Path("run")) == whole


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--set", "papr"], 3, "--set: there is no benchmark set 'papr'; expected one of .* Did you mean paper?"),
        (["--method", "defualt"], 3, "--method: there is no method 'defualt'; .* Did you mean default?"),
        (["--set", "paper", "--cases", "phantoms"], 3, "both --set and --cases are given"),
        (["--cases", "nothing"], 3, "nothing: --cases: the folder cannot be read"),
        (["--cases", "phantoms", "--workers", "2", "--scheduler", "tcp://x:1"], 3, "both --workers and --scheduler"),
        (["--cases", "phantoms", "--baseline", "none.json"], 3, "none.json: there is no such file"),
        (["--cases", "phantoms", "--faces", "7"], 3, "--faces: a model of 7 triangles is no screw"),
        (["--landmark-sigma", "inf"], 2, "Invalid value for '?--landmark-sigma'?"),
        (["--max-shift", "inf"], 2, "Invalid value for '?--max-shift'?"),
        (["--count", "0"], 2, "Invalid value for '?--count'?"),
        (["--workers", "0"], 2, "Invalid value for '?--workers'?"),
    ],
    ids=str,
)
def test_bad_input_is_one_clear_error_and_nothing_is_begun(
    own: Path, arguments: list[str], code: int, words: str
) -> None:
    result = program("-o", "run", *arguments)
    assert result.exit_code == code
    assert re.search(words.replace("?", r"\?") if code == 3 else words, said(result))
    assert not Path("run/records").exists()
    if code == 3:
        assert said(result).count("screwpose: ") == 1


def test_a_folder_to_write_into_is_asked_for(own: Path) -> None:
    result = program("--cases", own)
    assert result.exit_code == 2
    assert "a folder to write into is missing" in said(result)


@pytest.mark.usefixtures("brief")
def test_another_request_is_refused_and_nothing_is_lost(own: Path) -> None:
    asked = ("--cases", own, "--method", NEAR, "-o", "run", "--workers", "1")
    program(*asked)
    before = records_in(Path("run"))
    begun = program(*asked)
    assert begun.exit_code == 4
    assert "run: holds a benchmark run that was begun" in said(begun)
    assert "Go on with it by --resume" in said(begun)
    for more, difference in (
        (("--seed", "2"), "--seed: 1 in the folder, 2 now"),
        (("--faces", "500"), "--faces: 1000 in the folder, 500 now"),
        (("--method", INSTANT), f"--method: {NEAR} in the folder, {INSTANT} now"),
        (("--set", "paper"), "--set: own-phantoms in the folder, paper now"),
    ):
        other = program("-o", "run", "--resume", *more)
        assert other.exit_code == 4
        assert f"run: holds another run ({difference})" in said(other)
    assert records_in(Path("run")) == before
    assert program(*asked, "--resume").exit_code == 0  # all of it said again is the same request


@pytest.mark.usefixtures("brief")
def test_being_worse_than_the_baseline_leaves_by_6(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from screwpose.benchmark import runner

    Path("earlier.json").write_text("{}")
    monkeypatch.setattr(runner, "read_baseline", lambda _path: "earlier")
    monkeypatch.setattr(runner, "check_against", lambda _before, _records: ["own, near: right 50 % was 100 %."])
    result = program("--cases", own, "--method", NEAR, "-o", "run", "--workers", "1", "--baseline", "earlier.json")
    assert result.exit_code == 6
    assert "Worse than the baseline: own, near: right 50 % was 100 %." in said(result)


@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_leaves_at_once_and_says_how_to_go_on(own: Path, tmp_path: Path, workers: str) -> None:
    """The whole group of processes hears it, as in a terminal."""
    if workers == "2":
        pytest.importorskip("distributed")
    root = Path(__file__).resolve().parents[2]
    command = [sys.executable, "-m", "screwpose", "bench", "--cases", str(own), "--method", f"{PLACE}:sleepy"]
    running = subprocess.Popen(
        [*command, "-o", "run", "--workers", workers],
        env={**os.environ, "PYTHONPATH": str(root)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        given_up = monotonic() + 40
        while not records_in(tmp_path / "run") and monotonic() < given_up:
            sleep(0.1)
        start = monotonic()
        os.killpg(running.pid, signal.SIGINT)
        out, err = running.communicate(timeout=20)
    finally:
        running.kill()
    assert running.returncode == 130
    assert monotonic() - start < 10
    last = err.splitlines()[-1]
    stopped = re.fullmatch(
        r"screwpose: stopped; (\d) of 3 records are done and kept\. Go on with: screwpose bench -o run --resume", last
    )
    assert stopped, err
    assert "Traceback" not in err
    assert out == ""
    assert len(records_in(tmp_path / "run")) == int(stopped[1]) < 3
