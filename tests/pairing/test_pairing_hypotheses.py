"""Pairings of landmarks whose truth is known: right, complete, and honest about what is missing."""

import re
from dataclasses import replace

import numpy as np
import pytest

from screwpose.pairing import (
    Combination,
    Hypothesis,
    LandmarkNoise,
    SegmentFit,
    combinations,
    judge,
    p_value,
    probabilities,
)
from tests.pairing.scenes import SCREW, camera, case_of, screws

VIEWS = {"AP": camera(0.0), "LAT": camera(90.0)}
NOISE = LandmarkNoise(2.0, 1.0)


def pairs(combination: object) -> list[dict[str, str]]:
    return [hypothesis.by_view for hypothesis in combination.hypotheses]  # type: ignore[attr-defined]


def truth(numbers: list[int]) -> list[dict[str, str]]:
    return [{"AP": f"AP{i}", "LAT": f"LAT{i}"} for i in numbers]


def test_two_screws_have_two_combinations_and_three_have_six() -> None:
    rng = np.random.default_rng(1)
    for count, want in ((1, 1), (2, 2), (3, 6)):
        orders = {"LAT": list(range(count))[::-1]}
        found = combinations(case_of(screws(rng, count), VIEWS, 1.0, rng, orders), NOISE, 10)
        assert len(found) == want
        assert pairs(found[0]) == truth(list(range(count)))
        assert found[0].degrees_of_freedom == 3 * count
        assert [one.chi_square for one in found] == sorted(one.chi_square for one in found)


def test_right_in_nearly_all_of_many_random_pairs() -> None:
    rng = np.random.default_rng(2)
    cases = [case_of(screws(rng, 2), VIEWS, 1.5, rng, {"LAT": [1, 0]}) for _ in range(150)]
    found = [combinations(case, NOISE, 2) for case in cases]
    right = np.array([pairs(ranked[0]) == truth([0, 1]) for ranked in found])
    sure = np.array([judge(ranked, 0).status == "confident" for ranked in found])
    assert right.mean() > 0.97
    assert not (sure & ~right).any()
    assert sure.mean() > 0.9


def test_relabelling_the_screws_relabels_the_pairing() -> None:
    rng = np.random.default_rng(3)
    ends = screws(rng, 4)
    one = combinations(case_of(ends, VIEWS, 1.0, np.random.default_rng(9)), NOISE, 1)[0]
    reordered = case_of(ends, VIEWS, 1.0, np.random.default_rng(9))
    reordered.annotations["LAT"] = reordered.annotations["LAT"][::-1]  # type: ignore[index]  # a dict, in this test
    other = combinations(reordered, NOISE, 1)[0]
    assert sorted(map(str, pairs(one))) == sorted(map(str, pairs(other))) == sorted(map(str, truth([0, 1, 2, 3])))


def test_a_screw_missing_in_one_view_stays_alone() -> None:
    rng = np.random.default_rng(4)
    best = combinations(case_of(screws(rng, 3), VIEWS, 1.0, rng, {"LAT": [2, 0]}), NOISE, 5)[0]
    assert pairs(best) == truth([0, 2])
    assert best.unpaired == {"AP": ("AP1",), "LAT": ()}


def test_marks_of_different_screws_are_not_forced_together() -> None:
    ends = np.array([[[0, 0, 0], [0, 0, 22.5]], [[10, 40, 0], [10, 40, 22.5]], [[-20, -60, 5], [-20, -60, 27.5]]])
    case = case_of(ends, VIEWS, 1.0, np.random.default_rng(5), {"AP": [0, 1], "LAT": [0, 2]})
    found = combinations(case, NOISE, 5)
    assert pairs(found[0]) == truth([0])
    assert found[0].unpaired == {"AP": ("AP1",), "LAT": ("LAT2",)}


def test_three_views() -> None:
    rng = np.random.default_rng(6)
    views = {**VIEWS, "OBL": camera(45.0)}
    orders = {"LAT": [2, 0, 1], "OBL": [1, 2]}
    best = combinations(case_of(screws(rng, 3), views, 1.0, rng, orders), NOISE, 5)[0]
    by_ap = {one["AP"]: one for one in pairs(best)}
    assert by_ap["AP1"] == {"AP": "AP1", "LAT": "LAT1", "OBL": "OBL1"}
    assert by_ap["AP0"] == {"AP": "AP0", "LAT": "LAT0"}
    assert best.hypotheses[1].fit.degrees_of_freedom == 7


def test_the_model_is_chosen_by_its_length_unless_it_is_named() -> None:
    rng = np.random.default_rng(7)
    long = replace(SCREW, name="long", center_mm=np.array([0, 30.0, 0]))
    case = case_of(screws(rng, 2), VIEWS, 0.5, rng)
    case = replace(case, implants={"long": long, "screw": SCREW})
    assert [one.model for one in combinations(case, NOISE, 1)[0].hypotheses] == ["screw", "screw"]
    named = {
        "AP": tuple(replace(mark, model="long") for mark in case.annotations["AP"]),
        "LAT": case.annotations["LAT"],
    }
    assert {h.model for h in combinations(replace(case, annotations=named), NOISE, 1)[0].hypotheses} == {"long"}
    contradicting = {**named, "LAT": tuple(replace(mark, model="screw") for mark in case.annotations["LAT"])}
    assert combinations(replace(case, annotations=contradicting), NOISE, 1) == []


def combination(chi_square: float, degrees_of_freedom: int = 3) -> Combination:
    fit = SegmentFit(np.zeros(3), np.ones(3), 1.0, 22.5, chi_square, degrees_of_freedom)
    return Combination((Hypothesis((("AP", "1"), ("LAT", "a")), "screw", fit),), {})


def test_probabilities_by_hand() -> None:
    odds = np.exp(-(5.0 - 1.0) / 2)
    np.testing.assert_allclose(probabilities([combination(1.0), combination(5.0)]), np.array([1, odds]) / (1 + odds))
    # The best is four times worse than its degrees of freedom: differences count a quarter.
    odds = np.exp(-(30.0 - 12.0) / 2 / 4)
    np.testing.assert_allclose(probabilities([combination(30.0), combination(12.0)])[::-1] * (1 + odds), [1, odds])


@pytest.mark.parametrize(
    ("chi_squares", "chosen", "status", "reason"),
    [
        ([2.0, 40.0], 0, "confident", None),
        ([2.0], 0, "confident", None),
        ([2.0, 7.0], 0, "ambiguous", "the pairing is open.*probability of 0.924, 0.99 is needed"),
        ([2.0, 40.0], 1, "ambiguous", "probability of 0.000"),
        ([2.0, 9000.0], 1, "ambiguous", "probability of 0.000.*further off .*chi-square 9000.0"),
        ([20.0, 400.0], 0, "ambiguous", "further off than their assumed noise allows .chi-square 20.0 for 3 degrees"),
        ([70.0, 4000.0], 0, "refused", "no pairing explains the landmarks .*chi-square 70.0 for 3 degrees"),
    ],
)
def test_the_verdict(chi_squares: list[float], chosen: int, status: str, reason: str | None) -> None:
    verdict = judge([combination(chi_square) for chi_square in chi_squares], chosen)
    assert verdict.status == status
    if reason is None:
        assert verdict.reasons == ()
    else:
        assert re.search(reason, " ".join(verdict.reasons))


def test_one_bad_pair_does_not_hide_among_good_ones() -> None:
    good = [combination(1.0).hypotheses[0] for _ in range(7)]
    bad = Hypothesis((("AP", "8"), ("LAT", "h")), "screw", SegmentFit(np.zeros(3), np.ones(3), 9.0, 22.5, 30.0, 3))
    whole = Combination((*good, bad), {})
    assert p_value(whole) > 0.01  # the sum sees nothing
    verdict = judge([whole], 0)
    assert verdict.status == "ambiguous"
    assert "screw AP 8 = LAT h: its landmarks fit each other badly" in verdict.reasons[0]


def test_two_models_of_nearly_one_length_are_not_told_apart_in_silence() -> None:
    rng = np.random.default_rng(13)
    near = replace(SCREW, name="near", center_mm=np.array([0, 23.0, 0]))
    case = replace(case_of(screws(rng, 2), VIEWS, 1.5, rng), implants={"screw": SCREW, "near": near})
    verdict = judge(combinations(case, NOISE, 2), 0)
    assert verdict.status == "ambiguous"
    assert "name the model in its annotation" in " ".join(verdict.reasons)


@pytest.mark.parametrize(("views", "count"), [(2, 12), (3, 5)])
def test_many_screws_are_paired(views: int, count: int) -> None:
    rng = np.random.default_rng(14)
    cameras = dict(list({**VIEWS, "OBL": camera(45.0)}.items())[:views])
    best = combinations(case_of(screws(rng, count), cameras, 0.3, rng), LandmarkNoise(0.5, 0.3), 3)[0]
    assert len(best.hypotheses) == count
    assert all(len({label[-1] for label in one.by_view.values()}) == 1 for one in best.hypotheses)
