"""The files that a run leaves: all there, readable, self-contained, and with what is wrong in them."""

import csv
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from screwpose.benchmark.gate import read_baseline
from screwpose.benchmark.measures_file import Estimate
from screwpose.benchmark.outputs import write_outputs
from screwpose.benchmark.page_worst import draw_worst, worst_records
from screwpose.benchmark.record import CaseRecord, failed_case
from screwpose.benchmark.sets_base import BenchmarkSet
from screwpose.benchmark.summary import measures_file
from screwpose.benchmark.tables import accuracy_table, figure, paper_tables
from screwpose.errors import ImageError
from screwpose.files.atomic import write_json
from screwpose.files.result import Result, read_summary, write_result
from tests.benchmark.worked import (
    SWAPPED,
    TRUE_POSES,
    plain_record,
    record_of,
    result_of,
    shifted,
    truth_of,
    write_files,
)

ANSWERS = {
    0: result_of((shifted(0.5) @ TRUE_POSES[0], TRUE_POSES[1])),
    1: result_of(labels=SWAPPED, poses=(shifted(-4), shifted(4, 3))),
    2: result_of(status="refused"),
}


def make(_seed: int, _index: int, folder: Path) -> Path:
    return write_files(folder, truth_of())


SETS = {"hand": BenchmarkSet("hand", 1, make, None, "worked by hand", "square bars")}


def records_in(folder: Path, answers: dict[int, Result]) -> list[CaseRecord]:
    """The records of two methods, and their results on disk as a run leaves them."""
    records = []
    for method in ("ours", "default"):
        for index, result in answers.items():
            record = record_of(result, index=index).model_copy(update={"method": method})
            place = folder / "results" / method / f"hand-{index:04d}"
            place.mkdir(parents=True)
            write_result(place, result.answer)
            records.append(record)
    reason = "models.bar: <script>alert(1)</script> is not closed\nTraceback: of no use to a reader"
    keys = {"set_name": "hand", "set_version": 1, "method": "ours", "seed": 3, "index": 3, "seconds": 0.1}
    return [*records, failed_case("by-hand", reason, truth=truth_of(), **keys)]  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    (folder / "run.json").write_text(
        '{"started": "2026-11-22T12:00:00+00:00", "options": {"faces": 1000, "generations": 4}}'
    )
    paths = write_outputs(folder, records_in(folder, ANSWERS), SETS)
    assert all(path.is_file() for path in paths)
    return folder


def test_summary_and_measures_are_valid_and_agree(run: Path) -> None:
    summary, measures = read_summary(run), read_baseline(run / "measures.json")
    assert summary.started == measures.started == "2026-11-22T12:00:00+00:00"
    ours = summary.sets["hand"].methods["ours"]
    assert (ours.cases, ours.screws) == (4, 8)
    assert ours.pairing is not None
    assert (ours.pairing.right, ours.pairing.refused, ours.pairing.confident_wrong) == (0.25, 0.5, 0.25)
    assert ours.tip_mm is not None
    assert ours.tip_mm.max == measures.sets["hand"].methods["ours"].errors["tip_mm"].max == pytest.approx(0.5)


def test_rows_and_tables(run: Path) -> None:
    with (run / "cases.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 7
    with (run / "screws.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 14
    text = (run / "tables.md").read_text()
    assert "## hand, ours: Scores of every combination before (pre) and after (post) registration" in text
    with (run / "tables" / "hand-ours-table2.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["truth"], row["chosen"]) for row in rows] == [
        ("correct", "chosen"),
        ("wrong", "rejected"),
        ("wrong", "chosen"),
        ("correct", "rejected"),
    ]
    with (run / "tables" / "hand-ours-table1.csv").open() as file:
        assert list(csv.DictReader(file))[-1]["post_right"] == "1 of 3"  # a refused case has named nothing


class _Page(HTMLParser):
    """What a page would fetch, and its open elements."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.elements: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        for key, value in attrs:
            if key in ("src", "href", "xlink:href") and value and not value.startswith(("#", "data:")):
                self.fetched.append(value)


def test_the_page_holds_all_and_fetches_nothing(run: Path) -> None:
    html = (run / "report.html").read_text()
    page = _Page()
    page.feed(html)
    assert page.fetched == []
    assert "script" not in page.elements  # the case's text is escaped
    assert "&lt;script&gt;alert(1)&lt;/script&gt; is not closed" in html
    assert "Traceback" not in html
    assert "the marks contradict each other" in html
    assert "Not with the usual options: generations 4." in html
    assert "hand-0003 (by-hand)" in html
    assert html.count('class="answered"') == 12  # two methods, two views, one screw of case 0 and two of case 1
    assert not re.search(r"url\((?!#)", html)
    for title in ("Tip error", "Axis error", "Time against number of screws", "Calibration of the probabilities"):
        assert f"<b>{title}</b>" in html


def test_a_page_says_what_became_worse(tmp_path: Path) -> None:
    baseline = measures_file(
        [plain_record(k, (0.01, 0.01), set_name="hand") for k in range(50)], seed=3, started="then"
    )
    write_json(tmp_path / "baseline.json", baseline)
    records = [plain_record(k, (None, None), right=False) for k in range(3)]
    write_outputs(tmp_path / ".", records, {}, baseline=tmp_path / "baseline.json")
    html = (tmp_path / "report.html").read_text()
    assert "Worse than the baseline" in html
    assert "the share `right` fell from 100.0%" in html
    assert "Not drawn: the set &#39;hand&#39; is not known here" in html


def test_the_worst_come_first() -> None:
    fine, far = plain_record(0, (0.1,)), plain_record(1, (3.0,))
    unsure = plain_record(2, (None,), right=False, status="ambiguous")
    sure = plain_record(3, (None,), right=False)
    refused = plain_record(4, (), right=False, status="refused")
    assert [one.index for one in worst_records([fine, far, unsure, sure, refused])] == [3, 2, 1, 0]
    assert [one.index for one in worst_records([fine, far, unsure, sure], count=2)] == [3, 2]


def test_the_worst_are_drawn_where_they_differ(tmp_path: Path) -> None:
    [record] = records_in(tmp_path, {0: ANSWERS[0]})[:1]
    [worst] = draw_worst(tmp_path, {"ours": [record]}, SETS)["ours"]
    assert worst.problem is None
    assert worst.numbers.startswith("case by-hand; 2 of 2 pairs right; ")
    assert "1/b: tip 0.50 mm" in worst.numbers
    ap = worst.pictures[0]
    # The first bar alone is off. Its shank's middle is drawn at (-12, 15) mm, 5 px a mm, from (200, 200).
    assert ap.box.left < 200 - 60 < ap.box.right
    assert ap.box.top < 200 + 75 < ap.box.bottom
    assert ap.box.right < 200 + 60  # the other is not what the picture is about
    [answered], [true] = ap.answered, ap.true

    def left_edge(path: str) -> float:
        return min(float(pair.split(",")[0]) for pair in re.findall(r"-?[\d.]+,-?[\d.]+", path))

    assert left_edge(answered) - left_edge(true) == pytest.approx(0.5 * 5, abs=0.6)


def test_a_case_that_cannot_be_made_again_does_not_cost_the_page(tmp_path: Path) -> None:
    def broken(_seed: int, _index: int, _folder: Path) -> Path:
        raise ImageError("the disk is gone")

    def bug(_seed: int, _index: int, _folder: Path) -> Path:
        raise ZeroDivisionError("by zero")

    record = record_of()
    for made, words in ((broken, "the disk is gone."), (bug, "ZeroDivisionError: by zero")):
        sets = {"hand": BenchmarkSet("hand", 1, made, None, "", "")}
        [worst] = draw_worst(tmp_path, {"ours": [record]}, sets)["ours"]
        assert (worst.problem, worst.pictures) == (words, ())


def test_cases_of_one_id_keep_their_own_truth(tmp_path: Path) -> None:
    swapped = truth_of(labels=SWAPPED)
    records = [record_of(result_of(), index=0), record_of(result_of(), swapped, index=1)]
    for record in records:
        place = tmp_path / "results" / record.method / f"hand-{record.index:04d}"
        place.mkdir(parents=True)
        write_result(place, result_of().answer)
    assert {record.case for record in records} == {"by-hand"}
    _, table = paper_tables(tmp_path, records)
    cells = [(row[0], [cell for cell in row if cell in ("correct", "wrong")]) for row in table.cells()]
    assert cells == [
        ("by-hand (0)", ["correct"]),
        ("by-hand (0)", ["wrong"]),
        ("by-hand (1)", ["wrong"]),
        ("by-hand (1)", ["correct"]),
    ]


def test_columns_that_no_method_fills_are_left_out() -> None:
    def columns(record: CaseRecord) -> list[str]:
        table = accuracy_table(measures_file([record], seed=3, started="then"))
        assert all(len(row) == len(table.columns) for row in table.rows)
        return [column.key for column in table.columns][-3:]

    assert columns(record_of(result_of(sigma_mm=1.0))) == ["coverage", "calibration", "seconds"]
    assert columns(record_of()) == ["roll_deg_max", "calibration", "seconds"]
    assert columns(plain_record(0, (0.1,))) == ["roll_deg_p90", "roll_deg_max", "seconds"]


def test_one_case_alone_has_no_interval() -> None:
    assert figure(Estimate(value=1.5, low=1.5, high=1.5 + 1e-12)) == "1.5"
    assert figure(Estimate(value=1.5, low=1.25, high=1.75)) == "1.5 (1.25-1.75)"


def test_a_run_without_a_single_answer_has_a_page(tmp_path: Path) -> None:
    keys = {"set_name": "hand", "set_version": 1, "method": "ours", "seed": 3, "index": 0, "seconds": 0.1}
    write_outputs(tmp_path, [failed_case("x", "no", **keys)], SETS)  # type: ignore[arg-type]
    assert "No case was answered." in (tmp_path / "report.html").read_text()
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert "tip_mm" not in summary["sets"]["hand"]["methods"]["ours"]
