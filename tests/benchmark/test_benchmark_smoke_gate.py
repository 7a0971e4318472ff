"""Every change is held against the stored figures of a few small cases: pairing must not drop, medians not rise."""

import pytest

from screwpose.benchmark.gate import check_against, read_baseline
from screwpose.benchmark.record import CaseRecord
from tests.benchmark.smoke import BASELINE, CASES, METHODS, smoke_records


@pytest.fixture(scope="module")
def records() -> list[CaseRecord]:
    return smoke_records()


def test_nothing_is_worse_than_the_baseline(records: list[CaseRecord]) -> None:
    assert len(records) == CASES * len(METHODS)
    assert [one.error for one in records if one.error is not None] == []
    assert check_against(read_baseline(BASELINE), records) == []


def test_the_gate_would_see_a_run_gone_wrong(records: list[CaseRecord]) -> None:
    baseline = read_baseline(BASELINE)
    wrong = [one.model_copy(update={"right": False}) for one in records]
    assert {text.split(": ")[0] for text in check_against(baseline, wrong) if "`right` fell" in text} == {
        f"smoke, {method}" for method in METHODS
    }
    far = [_times_ten(one) for one in records]
    assert sum("the median of `tip_mm` rose" in text for text in check_against(baseline, far)) == len(METHODS)


def _times_ten(record: CaseRecord) -> CaseRecord:
    screws = tuple(
        screw
        if screw.errors is None
        else screw.model_copy(update={"errors": screw.errors.model_copy(update={"tip_mm": 10 * screw.errors.tip_mm})})
        for screw in record.screws
    )
    return record.model_copy(update={"screws": screws})
