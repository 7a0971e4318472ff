"""The program's commands: what they write, what they say where, and how they leave."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import pytest
from typer.testing import CliRunner, Result

from screwpose import __version__
from screwpose.cli import app, terminal
from screwpose.errors import CancelledError, OutputError
from tests.cli import bad_inputs as bad
from tests.cli.case_folder import QUICK, SIGMA, CaseFolder

RUN = CliRunner()
PROGRAM = Path(sys.executable).parent / "screwpose"
COMMANDS = (["demo"], ["solve"], ["check"], ["simulate"], ["bench"], ["model"], ["model", "inspect"])


def program(*arguments: str | Path) -> Result:
    """Run the program; anything but an orderly exit is a failure here."""
    result = RUN.invoke(app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def names_in(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


# ---- what it says of itself


def test_version() -> None:
    result = program("--version")
    assert (result.exit_code, result.stdout) == (0, f"screwpose {__version__}\n")


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_each_command_explains_itself(command: list[str]) -> None:
    result = program(*command, "--help")
    assert result.exit_code == 0
    assert "Usage: " in result.stdout
    assert result.stderr == ""


def test_the_exit_codes_are_in_the_help() -> None:
    text = " ".join(program("--help").stdout.split())
    for words in (
        "0 done",
        "2 the command line is wrong",
        "3 the input",
        "4 the output",
        "5 refused",
        "130 interrupted",
    ):
        assert words in text


@pytest.mark.parametrize(
    "arguments",
    [["solve"], ["solve", "case"], ["sovle"], ["check", "case", "--sigma", "1"], ["bench", "-o", "x", "--count", "0"]],
    ids=" ".join,
)
def test_a_wrong_command_line_leaves_by_2(arguments: list[str]) -> None:
    result = program(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "Usage: " in result.stderr


# ---- solve


def test_solve_writes_everything_and_says_so(case: CaseFolder) -> None:
    """Names of files, models and labels that would be markup, paths or line breaks elsewhere: all of it at once."""
    for mistake in (bad.odd_labels, bad.odd_model_name, bad.odd_file_names, bad.view_named_path):
        mistake(case)
    for part in ("views", "annotations"):
        case.data[part]["../X"] = case.data[part].pop("LAT")  # differs from the other view's name by a capital alone
    case.save()
    result = program("solve", case.folder, "-o", "out", *QUICK)
    assert result.exit_code == 0, result.output
    assert names_in(Path()) == ["case", "out"]
    assert {"result.json", "report.html", "overlays", "meshes", "combinations.md"} <= set(names_in(Path("out")))
    written = [path for path in Path("out").rglob("*") if path.is_file()]
    assert len({str(path).lower() for path in written}) == len(written)
    assert len(list(Path("out/meshes").iterdir())) == 2
    page = Path("out/report.html").read_text()
    assert "<script>alert(1)" not in page
    assert "<b>ü" not in page
    # Words on standard output, in lines of 80 columns; progress on standard error.
    assert result.stdout.startswith("two-screws-7: confident")
    assert "Open out/report.html" in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 80
    lines = result.stderr.splitlines()
    assert len(lines) >= 4
    assert all(re.match(r" *\d+%  \S", line) for line in lines)


@pytest.mark.usefixtures("brief_report")
def test_solve_for_machines_replaces_an_earlier_output(case: CaseFolder) -> None:
    earlier = Path("out")
    (earlier / "overlays").mkdir(parents=True)
    (earlier / "result.json").write_text("{}")
    (earlier / "overlays" / "of-earlier.png").write_text("")
    result = program("solve", case.folder / "case.json", "-o", "out", "--json", "--method", "paper", *QUICK)
    assert result.exit_code == 0
    assert result.stderr == ""
    told = json.loads(result.stdout)
    assert told == {"out": "out", "result": json.loads((earlier / "result.json").read_text())}
    assert told["result"]["timing_s"]["load"] > 0
    assert not (earlier / "overlays" / "of-earlier.png").exists()


@pytest.fixture
def cheap(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A report that is one file; lists how often it was reached."""
    reached: list[str] = []

    def write(folder: Path, *_: object) -> None:
        reached.append("report")
        (folder / "result.json").write_text("{}")

    monkeypatch.setattr("screwpose.report.writing.write_report", write)
    return reached


def test_refused_leaves_by_5_for_machines_too(case: CaseFolder, cheap: list[str]) -> None:
    bad.matrices_in_metres(case)
    case.save()
    result = program("solve", case.folder, "-o", "out", "--json", *QUICK)
    assert result.exit_code == 5
    assert json.loads(result.stdout)["result"]["status"] == "refused"
    quiet = program("solve", case.folder, "-o", "out", "-q", *QUICK)
    assert (quiet.exit_code, quiet.output) == (5, "")
    assert cheap == ["report", "report"]


@pytest.mark.parametrize("command", ["check", "solve"])
def test_an_error_for_machines_is_one_json_object(case: CaseFolder, command: str) -> None:
    bad.unknown_key(case)
    case.save()
    more = ["-o", "out"] if command == "solve" else []
    result = program(command, case.folder, "--json", *more)
    assert (result.exit_code, result.stderr) == (3, "")
    told = json.loads(result.stdout)
    error = told if command == "solve" else told["findings"][0]
    assert error["error"] == "CaseError"
    assert error["file"] == "case/case.json"
    assert error["field"] == "views.AP.polarty"
    assert "unknown key" in error["problem"]
    assert error["remedy"] == "Rename it to `polarity`."
    if command == "check":
        assert (told["errors"], told["warnings"]) == (1, 0)


@pytest.mark.parametrize("command", ["check", "solve", "bench"])
def test_a_number_of_threads_that_is_none_is_one_error(
    case: CaseFolder, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SCREWPOSE_THREADS", "many")
    given = {"check": [case.folder], "solve": [case.folder, "-o", "out"], "bench": ["--set", "pairs", "-o", "out"]}
    result = program(command, *given[command])
    assert result.exit_code == 3
    told = " ".join(result.output.split())
    assert "SCREWPOSE_THREADS: the environment variable is 'many'; expected a positive integer" in told
    assert "Traceback" not in told
    assert not Path("out").exists()


def test_an_output_error_for_machines(case: CaseFolder) -> None:
    Path("out").write_text("a file")
    result = program("solve", case.folder, "-o", "out", "--json")
    assert result.exit_code == 4
    assert json.loads(result.stdout) == {
        "error": "OutputError",
        "message": "out: a file stands where the output folder is to be. Choose another folder.",
    }


def test_quiet_is_quiet(case: CaseFolder) -> None:
    assert program("check", case.folder, "-q", *SIGMA).output == ""
    bad.black_image(case)
    assert "all-black" in program("check", case.folder, "-q").stdout


# ---- the output folder


def foreign_folder() -> Path:
    Path("mine").mkdir()
    Path("mine/thesis.txt").write_text("years of work")
    return Path("mine")


@pytest.mark.parametrize("command", ["solve", "demo", "simulate", "bench"])
def test_a_foreign_folder_is_refused_before_the_work(case: CaseFolder, command: str) -> None:
    out = foreign_folder()
    result = program(command, *([case.folder] if command == "solve" else []), "-o", out)
    assert result.exit_code == 4
    assert len(result.stderr.splitlines()) == 1  # no progress: no work
    assert re.search(
        r"screwpose: mine: the folder is not empty and holds no \w+\.json, so it is no earlier", result.stderr
    )
    assert (names_in(Path()), names_in(out)) == (["case", "mine"], ["thesis.txt"])
    assert (out / "thesis.txt").read_text() == "years of work"


@pytest.mark.parametrize("command", ["solve", "demo", "simulate", "bench"])
def test_a_file_in_the_folders_place_is_refused(case: CaseFolder, command: str) -> None:
    Path("out").write_text("a file")
    for out in ("out", "out/below"):
        result = program(command, *([case.folder] if command == "solve" else []), "-o", out)
        assert result.exit_code == 4
        assert "file" in result.stderr.splitlines()[-1]
    assert Path("out").read_text() == "a file"


def test_a_folder_that_cannot_be_written_is_found_before_the_work(
    case: CaseFolder, monkeypatch: pytest.MonkeyPatch, cheap: list[str]
) -> None:
    def refused(self: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "mkdir", refused)  # tests may run as root, whom no mode stops
    result = program("solve", case.folder, "-o", "out", *QUICK)
    assert result.exit_code == 4
    assert result.stderr == (
        "screwpose: out: cannot be written: Permission denied. Choose a folder that you may write to.\n"
    )
    assert cheap == []


# ---- interruption


def raising(error: BaseException) -> Callable[..., None]:
    def stop(*_: object, **__: object) -> None:
        raise error

    return stop


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "screwpose: interrupted; nothing half-written was left"),
        (CancelledError("stopped"), 130, "screwpose: stopped"),
        (OutputError("out: the disk is full."), 4, "screwpose: out: the disk is full."),
    ],
    ids=["ctrl-c", "cancelled", "disk"],
)
@pytest.mark.parametrize("where", ["while placing", "in the report"])
def test_nothing_half_written_is_left(
    case: CaseFolder, monkeypatch: pytest.MonkeyPatch, where: str, error: BaseException, code: int, said: str
) -> None:
    if where == "in the report":
        # In the middle of the report: one file is there already. A refused case is there soon.
        bad.matrices_in_metres(case)
        case.save()

        def write(folder: Path, *_: object) -> None:
            (folder / "result.json").write_text("{}")
            raise error

        monkeypatch.setattr("screwpose.report.writing.write_report", write)
    else:
        monkeypatch.setattr("screwpose.solve.place", raising(error))
    Path("out").mkdir()
    Path("out/result.json").write_text("an earlier answer")
    result = program("solve", case.folder, "-o", "out", *QUICK)
    assert result.exit_code == code
    assert result.stderr.splitlines()[-1] == said
    assert names_in(Path()) == ["case", "out"]
    assert names_in(Path("out")) == ["result.json"]
    assert Path("out/result.json").read_text() == "an earlier answer"


def test_an_interrupted_demo_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("screwpose.solve.place", raising(KeyboardInterrupt()))
    assert program("demo", "--size", "128", *QUICK).exit_code == 130
    assert names_in(tmp_path) == []


def test_progress_that_raises_stops_the_work(case: CaseFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal._Lines, "__call__", raising(KeyboardInterrupt()))
    assert program("solve", case.folder, "-o", "out", *QUICK).exit_code == 130
    assert names_in(Path()) == ["case"]


# ---- the other commands


def test_demo_makes_solves_and_scores_a_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = program("demo", "-o", "demo", "--size", "256", *QUICK)
    assert result.exit_code == 0, result.output
    text = " ".join(result.stdout.split())
    assert "Against the truth (simulated): AP 1 / LAT a: paired right, tip " in text
    assert "solve it again with screwpose solve demo/case -o OUT" in text
    assert {"case", "result.json", "report.html"} <= set(names_in(Path("demo")))
    assert {"case.json", "truth.json", "scene.json", "ap.png", "lat.png", "models"} == set(names_in(Path("demo/case")))


def test_simulate_makes_a_case_that_has_nothing_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = program("simulate", "-o", "made", "--seed", "3", "--size", "128", "--landmark-noise", "0.2", "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout) == {"case": "made/case.json", "truth": "made/truth.json"}
    assert program("check", "made", *SIGMA).stdout == "made: nothing wrong was found\n"


def test_model_inspect_proposes_landmarks(case: CaseFolder) -> None:
    result = program("model", "inspect", case.mesh_file, "--json", "-o", "screw.png")
    assert result.exit_code == 0
    facts = json.loads(result.stdout)
    assert facts["mesh"]["watertight"]
    assert facts["landmarks"]["tip_mm"] == pytest.approx([0, 0, 0], abs=0.5)
    assert Path("screw.png").read_bytes().startswith(b"\x89PNG")
    told = program("model", "inspect", case.mesh_file)
    assert '"tip": [' in told.stdout
    assert Path(f"{case.mesh_file.stem}_inspect.png").is_file()


def test_model_inspect_of_nothing(case: CaseFolder) -> None:
    assert "cannot be read" in program("model", "inspect", "nothing.stl").stderr
    unit = program("model", "inspect", case.mesh_file, "--unit", "-1")
    assert unit.exit_code == 3
    assert "the unit '-1' is not known; expected mm, cm, m, inch" in unit.stderr
    assert program("model", "inspect", case.mesh_file, "-o", "no/such/folder.png").exit_code == 4


# ---- the installed program


def test_the_installed_program(case: CaseFolder) -> None:
    bad.black_image(case)
    start = perf_counter()
    done = subprocess.run(
        [PROGRAM, "check", "case"], capture_output=True, text=True, check=False, timeout=60, cwd=Path.cwd()
    )
    assert done.returncode == 3
    assert done.stdout.startswith("error: case/ap.png: views.AP.image: all 256 x 256 pixels have the value 0")
    assert done.stderr == ""
    assert perf_counter() - start < 20


def test_the_installed_program_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "screwpose", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"screwpose {__version__}\n"
