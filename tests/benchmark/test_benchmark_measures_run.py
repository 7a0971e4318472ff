"""A run's figures: what is counted, over what, in which bins; and that no order matters."""

import csv
import io
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import chi2

from screwpose.benchmark import measures_run
from screwpose.benchmark.measures_blocks import distribution, is_confident_wrong, is_success, mean
from screwpose.benchmark.measures_run import measures_of
from screwpose.benchmark.record import CaseRecord, ScrewRecord, SigmaCheck, StageRecord, Told, failed_case
from screwpose.benchmark.rows import cases_csv, screws_csv, to_csv
from screwpose.benchmark.strata import Strata
from screwpose.benchmark.summary import measures_file, summarise
from screwpose.files.schema import SummaryFile
from tests.benchmark.worked import SWAPPED, TRUE_POSES, plain_record, record_of, result_of, shifted, truth_of


def failed(index: int) -> CaseRecord:
    return failed_case(
        "x", "no", set_name="hand", set_version=1, method="ours", seed=3, index=index, seconds=0.1, truth=truth_of()
    )


RECORDS = [
    plain_record(0, (0.1, 0.2), probability=0.95),
    plain_record(1, (0.3, 0.4), probability=0.85, status="ambiguous"),
    plain_record(2, (None, None), right=False, probability=0.95),
    plain_record(3, (0.5, 1.5), probability=0.95),
    failed(4),
]


def test_everything_is_counted() -> None:
    found = measures_of(RECORDS)
    assert (found.cases, found.screws, found.failed) == (5, 10, 1)
    rates = {name: (one.hits, one.of) for name, one in found.rates.items()}
    assert rates == {
        "right": (3, 5),
        "harmless_swap": (0, 5),
        "confident": (3, 5),
        "confident_wrong": (1, 5),
        "ambiguous": (1, 5),
        "refused": (1, 5),
        "success": (2, 5),  # one screw of case 3 is 1.5 mm off
        "pairs_right": (6, 10),
        "answered_pairs_right": (6, 8),
        "right_but_harmless": (3, 5),
        "right_of_confident": (2, 3),
    }
    tips = found.errors["tip_mm"]
    assert (tips.count, tips.max) == (6, 1.5)
    assert tips.median.value == pytest.approx(0.35)
    assert tips.p90.value == pytest.approx(np.quantile([0.1, 0.2, 0.3, 0.4, 0.5, 1.5], 0.9))
    assert tips.median.low <= 0.35 <= tips.median.high
    assert found.errors["roll_deg"].median.value == pytest.approx(0.35)  # without its sign
    assert found.bias["roll_deg"].value == pytest.approx(-0.5)  # with it
    assert found.seconds is not None
    assert found.seconds.count == 4  # the failed case took no time to solve


def test_a_harmless_swap_is_not_sure_and_wrong() -> None:
    swap = record_of(result_of(labels=SWAPPED, poses=TRUE_POSES))
    wrong = record_of(result_of(labels=SWAPPED, poses=(shifted(40), shifted(60))), index=1)
    assert (is_confident_wrong(swap), is_confident_wrong(wrong)) == (False, True)
    found = measures_of([swap, wrong]).rates
    assert (found["harmless_swap"].hits, found["confident_wrong"].hits, found["right"].hits) == (1, 1, 0)


def test_success_by_hand() -> None:
    assert is_success(plain_record(0, (1.0, 0.2)))
    assert not is_success(plain_record(0, (1.01, 0.2)))
    assert not is_success(plain_record(0, (0.1,), axis_deg=1.01))
    assert not is_success(plain_record(0, (0.1, None), right=False))


def test_the_figures_do_not_depend_on_any_order() -> None:
    rng = np.random.default_rng(8)
    records = [plain_record(k, tuple(rng.gamma(2.0, 0.2, size=1 + k % 3)), probability=0.9) for k in range(40)]
    mixed = [records[k] for k in rng.permutation(40)]
    turned = [one.model_copy(update={"screws": one.screws[::-1]}) for one in mixed]
    first = measures_file(records, seed=1, started="now").model_dump_json()
    assert measures_file(mixed, seed=1, started="now").model_dump_json() == first
    # The screws of a case in another order: sums may round otherwise, nothing else.
    second = measures_of(sorted(turned, key=lambda one: one.index)).model_dump()
    _assert_close(second, measures_of(records).model_dump())


def _assert_close(found: object, wanted: object) -> None:
    if isinstance(wanted, dict):
        assert isinstance(found, dict)
        assert list(found) == list(wanted)
        for key, value in wanted.items():
            _assert_close(found[key], value)
    elif isinstance(wanted, list | tuple):
        assert isinstance(found, Sequence)
        assert len(found) == len(wanted)
        for one, other in zip(found, wanted, strict=True):
            _assert_close(one, other)
    else:
        assert found == (pytest.approx(wanted) if isinstance(wanted, float) else wanted)


def test_coverage_is_by_chi_square() -> None:
    for name, degrees in (("tip", 3), ("axis", 2), ("roll", 1)):
        np.testing.assert_allclose(measures_run.CHI2[name], chi2.ppf(chi2.cdf([1.0, 4.0], 1), degrees))
    base = plain_record(0, (0.1, 0.2, 0.3, 0.4))
    screws = [
        screw.model_copy(update={"sigma": SigmaCheck(mahalanobis2=value)})
        for screw, value in zip(base.screws, (1.0, 3.0, 7.0, 12.0), strict=True)
    ]
    found = measures_of([base.model_copy(update={"screws": tuple(screws)})]).coverage
    assert (found["tip_1sigma"].value, found["tip_2sigma"].value) == (0.5, 0.75)
    assert measures_of([base]).coverage == {}


def test_coverage_of_axis_and_roll_by_hand() -> None:
    screw = plain_record(0, (0.1,)).screws[0]
    assert screw.errors is not None
    screws = [
        screw.model_copy(
            update={
                "errors": screw.errors.model_copy(update={"axis_deg": axis, "roll_deg": roll}),
                "sigma": SigmaCheck(axis_deg=1.0, roll_deg=0.5),
            }
        )
        # Of two directions with a variance of 1/2 each: 68.27 % are within the root of 2.296 / 2, 95.45 % of 6.18 / 2.
        for axis, roll in ((1.06, -0.49), (1.08, 0.51), (1.75, 0.99), (1.77, -1.01))
    ]
    screws.append(screw.model_copy(update={"sigma": SigmaCheck(axis_deg=1.0)}))  # its roll is not told
    record = plain_record(0).model_copy(update={"screws": tuple(screws)})
    found = measures_of([record]).coverage
    summary = summarise(measures_file([record], seed=3, started="2026-01-01T00:00:00+00:00"))
    assert summary.sets["hand"].methods["ours"].coverage is None  # its format knows the tip's alone
    assert {name: (one.hits, one.of) for name, one in found.items()} == {
        "axis_1sigma": (2, 5),
        "axis_2sigma": (4, 5),
        "roll_1sigma": (1, 4),
        "roll_2sigma": (3, 4),
    }


def test_strata_hold_every_case_once() -> None:
    def with_overlap(index: int, share: float, ambiguity: float | None, right: bool) -> CaseRecord:
        strata = Strata(
            screws=2,
            overlap={"AP": 0.0, "LAT": share},
            epipolar_ambiguity_px=ambiguity,
            landmark_noise_px=1.2,
            view_angle_deg=90.0,
            marks_missing=0,
        )
        return plain_record(index, (0.1,), right=right).model_copy(update={"strata": strata})

    records = [
        with_overlap(0, 0.0, 1.0, True),
        with_overlap(1, 0.3, 2.0, False),  # on the edge: it belongs to the bin above
        with_overlap(2, 1.0, None, True),
        failed(3),
    ]
    strata = measures_of(records).strata
    assert [(one.name, one.cases) for one in strata["overlap"]] == [
        ("0 to 0.05", 1),
        ("0.25 to 0.5", 1),
        ("0.75 and more", 1),
        ("not known", 1),
    ]
    ambiguity = {one.name: (one.cases, one.right.hits) for one in strata["epipolar_ambiguity_px"]}
    assert ambiguity == {"0 to 2": (1, 1), "2 to 5": (1, 0), "not known": (2, 1)}
    for bins in strata.values():
        assert sum(one.cases for one in bins) == 4


def test_success_against_the_start_counts_screws() -> None:
    # The start is ten times as far off as the answer: 1 and 2 mm for case 0, 5 and 15 mm for case 3.
    offsets = {one.name: (one.screws, one.success.hits) for one in measures_of(RECORDS).offsets}
    assert offsets == {"1 to 2": (1, 1), "2 to 4": (2, 2), "4 to 8": (2, 2), "8 and more": (1, 0)}


def test_dice_names_the_truth_where_there_was_a_choice() -> None:
    stage = StageRecord(dice=0.9, other_dice=0.5, chosen_right=True)
    some = plain_record(0).model_copy(update={"post": stage})
    none = plain_record(1).model_copy(update={"post": StageRecord(dice=0.8)})
    found = measures_of([some, none])
    assert (found.rates["dice_post_right"].hits, found.rates["dice_post_right"].of) == (1, 1)
    assert found.stages["post_dice"].count == 2


def test_calibration_of_a_run_by_hand() -> None:
    # Told 0.95 three times, two right; told 0.85 once, right; the failed case told nothing.
    found = measures_of(RECORDS).calibration
    assert found is not None
    assert found.cases == 4
    assert found.error == pytest.approx((3 * abs(0.95 - 2 / 3) + 0.15) / 4)
    assert found.brier == pytest.approx((2 * 0.05**2 + 0.95**2 + 0.15**2) / 4)


def test_what_is_told_of_pairs_and_of_marks_alone_by_hand() -> None:
    told = [Told(what="pair", probability=0.9, right=True), Told(what="alone", probability=0.95, right=False)]
    record = plain_record(0).model_copy(update={"told": tuple(told)})
    found = measures_of([record, plain_record(1)]).told
    assert found is not None
    assert found.cases == 2
    assert found.error == pytest.approx(abs(0.925 - 0.5))
    assert found.brier == pytest.approx((0.1**2 + 0.95**2) / 2)
    assert measures_of([plain_record(1)]).told is None


def test_screws_of_one_view_and_answered_pairs_by_hand() -> None:
    pair = plain_record(0, (0.1,)).screws[0]
    alone = [
        ScrewRecord(labels={"AP": "9"}, model="bar", outcome=outcome) for outcome in ("missing", "missing", "wrong")
    ]
    record = plain_record(0, (0.1,)).model_copy(
        update={"screws": (pair, *alone), "pairs_true": 1, "pairs_right": 1, "pairs_answered": 2, "right": False}
    )
    refused = record.model_copy(update={"index": 1, "pairing_status": "refused", "status": "refused"})
    rates = measures_of([record, refused]).rates
    assert (rates["alone_left"].hits, rates["alone_left"].of) == (2, 3)
    one = measures_of([record]).rates
    assert (one["answered_pairs_right"].hits, one["answered_pairs_right"].of) == (1, 2)


def test_right_of_the_confident_leaves_harmless_swaps_out() -> None:
    sure = plain_record(0).model_copy(update={"pairing_status": "confident", "right": True})
    wrong = sure.model_copy(update={"index": 1, "right": False})
    swap = wrong.model_copy(update={"index": 2, "harmless_swap": True})
    open_ = wrong.model_copy(update={"index": 3, "pairing_status": "ambiguous"})
    rates = measures_of([sure, wrong, swap, open_]).rates
    assert (rates["right_of_confident"].hits, rates["right_of_confident"].of) == (1, 2)
    assert (rates["right_but_harmless"].hits, rates["right_but_harmless"].of) == (1, 3)


def test_the_mean_of_screws_is_not_the_mean_of_cases() -> None:
    found = mean([(0, 1.0), (0, 1.0), (0, 1.0), (1, 5.0)])
    assert found.value == 2.0
    assert found.low == 1.0
    assert found.high == 5.0
    assert distribution([]) is None


def test_the_summary_holds_its_schema_and_the_measures_figures() -> None:
    slow = [plain_record(k, (0.2 * (k + 1),), method="default", seconds=2.0) for k in range(3)]
    fast = [plain_record(k, (0.1 * (k + 1),), method="paper", seconds=0.5) for k in range(3)]
    measures = measures_file([*slow, *fast], seed=3, started="2026-01-01T00:00:00+00:00")
    summary = summarise(measures)
    assert SummaryFile.model_validate_json(summary.model_dump_json(exclude_none=True)) == summary
    one = summary.sets["hand"].methods["default"]
    assert one.tip_mm is not None
    assert (one.cases, one.screws, one.tip_mm.median, one.tip_mm.max) == (3, 3, pytest.approx(0.4), pytest.approx(0.6))
    assert one.head_mm is None
    assert summary.ratios is not None
    ratios = summary.ratios["hand"]["paper/default"]
    assert (ratios["seconds_median"], ratios["tip_mm_median"]) == (pytest.approx(0.25), pytest.approx(0.5))
    assert summarise(measures_file(slow, seed=3, started="now")).ratios is None


def test_rows_are_one_a_case_and_one_a_true_screw() -> None:
    records = [record_of(result_of(sigma_mm=0.3)), failed(1), record_of(result_of(status="refused"), index=2)]
    cases = list(csv.DictReader(io.StringIO(cases_csv(records))))
    assert [(row["case"], row["right"], row["error"]) for row in cases] == [
        ("by-hand", "yes", ""),
        ("x", "no", "no"),
        ("by-hand", "no", ""),
    ]
    assert cases[2]["reasons"] == "the marks contradict each other"
    screws = list(csv.DictReader(io.StringIO(screws_csv(records))))
    assert len(screws) == 6
    assert [row["outcome"] for row in screws] == ["right"] * 2 + ["missing"] * 4
    assert float(screws[0]["tip_mm"]) == 0.0
    assert (screws[0]["screw"], screws[3]["tip_mm"]) == ("AP:1 LAT:b", "")
    assert {"view_AP_depth_mm", "start_tip_mm", "sigma_mahalanobis2", "shift_x_in_cad_mm"} <= set(screws[0])


def test_no_id_runs_as_a_formula() -> None:
    assert to_csv([{"case": "=1+1", "tip": -0.5}]) == "case,tip\n'=1+1,-0.5\n"
