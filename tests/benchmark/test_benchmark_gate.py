"""The gate lets equal and better runs through, and says in words what is worse."""

from pathlib import Path

import pytest

from screwpose.benchmark.gate import baseline_of, check_against, read_baseline
from screwpose.benchmark.record import CaseRecord
from screwpose.benchmark.summary import measures_file
from screwpose.errors import CaseError
from screwpose.files.atomic import write_json
from tests.benchmark.worked import plain_record


def run(tip_mm: float = 0.2, wrong: int = 0, count: int = 20) -> list[CaseRecord]:
    """Cases of spread errors, the last `wrong` of them paired wrong."""
    good = [plain_record(k, (tip_mm * (0.5 + k / count), tip_mm)) for k in range(count - wrong)]
    return good + [plain_record(k, (None, None), right=False) for k in range(count - wrong, count)]


BASELINE = measures_file(run(), seed=3, started="then")


def test_the_same_and_a_better_run_pass() -> None:
    assert check_against(BASELINE, run()) == []
    assert check_against(BASELINE, run(0.1)) == []
    poor = [plain_record(k, (0.2,) if k < 10 else (None,), right=k < 10) for k in range(20)]
    fine = [plain_record(k, (0.2,)) for k in range(20)]
    assert check_against(measures_file(poor, seed=3, started="then"), fine) == []


def test_one_case_in_twenty_may_fall() -> None:
    # Wilson's lower bound of 20 of 20 is 83.9 %: 17 of 20 are within chance, 16 are not.
    assert check_against(BASELINE, run(wrong=3)) == []


def test_a_drop_of_pairing_fails_in_words() -> None:
    worse = check_against(BASELINE, run(wrong=4))
    assert worse[0] == (
        "hand, ours: the share `right` fell from 100.0% (95 % interval 83.9% to 100.0%) to 80.0% of 20."
    )
    assert any("`confident_wrong` rose from 0.0%" in text for text in worse)


def test_a_rise_of_a_median_fails_in_words() -> None:
    high = BASELINE.sets["hand"].methods["ours"].errors["tip_mm"].median.high
    assert check_against(BASELINE, run(0.2 * 1.01)) == [] or high < 0.202
    worse = check_against(BASELINE, run(0.4))
    assert any(text.startswith("hand, ours: the median of `tip_mm` rose from 0.2 (95 % interval ") for text in worse)
    assert any("to 0.4." in text for text in worse)


def test_what_is_not_there_fails() -> None:
    other = [one.model_copy(update={"method": "other"}) for one in run()]
    assert check_against(BASELINE, other) == ["hand, ours: the baseline has this method, the run does not."]
    elsewhere = [one.model_copy(update={"set": "else"}) for one in run()]
    assert check_against(BASELINE, elsewhere) == ["hand: the baseline has this set, the run does not."]
    newer = [one.model_copy(update={"set_version": "2"}) for one in run()]
    assert check_against(BASELINE, newer) == [
        "hand: the run is of version 2 of the set, the baseline of version 1: make a new baseline."
    ]
    lost = check_against(BASELINE, run(wrong=20))
    assert "hand, ours: `tip_mm` has no value any more: no screw is paired right." in lost


def test_a_baseline_is_a_measures_file(tmp_path: Path) -> None:
    path = write_json(tmp_path / "measures.json", BASELINE)
    assert read_baseline(path) == BASELINE
    path.write_text(path.read_text().replace('"machine"', '"machines"'))
    with pytest.raises(CaseError, match=r"measures\.json: machines: unknown key.*machine"):
        read_baseline(path)


def test_a_trimmed_baseline_judges_alike() -> None:
    small = baseline_of(BASELINE)
    assert len(small.model_dump_json()) < 0.5 * len(BASELINE.model_dump_json())
    for records in (run(), run(wrong=5), run(0.4), run(wrong=20)):
        assert check_against(small, records) == check_against(BASELINE, records)
