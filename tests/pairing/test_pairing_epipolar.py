"""The epipolar baseline: right where planes differ, blind where they do not, its chi-square as it should be."""

from dataclasses import replace

import numpy as np
from scipy.stats import kstest

from screwpose.pairing import HypothesisTable, LandmarkNoise, combinations, fit_epipolar, fit_segment
from tests.pairing.scenes import camera, case_of, screws

VIEWS = {"AP": camera(0.0), "LAT": camera(90.0)}
NOISE = LandmarkNoise(sigma_px=1.5)


def by_epipolar_distance(case, count=2):
    return combinations(case, NOISE, count, HypothesisTable(case, NOISE, fit_epipolar))


def is_true(combination):
    return all(len({label[-1] for _, label in one.labels}) == 1 for one in combination.hypotheses)


def test_screws_at_different_heights_are_told_apart():
    # Two screws 30 px and more apart along v, which is across the epipolar lines of these views.
    ends = np.array([[[0.0, 0, 0], [0, 0, 22.5]], [[5.0, 8, 0], [5, 8, 22.5]]])
    case = case_of(ends, VIEWS, 1.0, np.random.default_rng(1), {"LAT": [1, 0]})
    best, other = by_epipolar_distance(case)
    assert is_true(best)
    assert not is_true(other)
    assert other.chi_square - best.chi_square > 100


def test_screws_in_one_epipolar_plane_cannot_be_told_apart_by_it_but_by_their_length():
    # Both in the plane y = 0 that holds both sources; swapped, the two segments come out too long or too short.
    ends = np.array([[[-15.0, 0, -5], [-6, 0, 15.6]], [[15.0, 0, 0], [-3, 0, 13.5]]])
    rng = np.random.default_rng(2)
    right = {"epipolar": 0, "length": 0}
    for _ in range(40):
        case = case_of(ends, VIEWS, 1.5, rng)
        right["epipolar"] += is_true(by_epipolar_distance(case)[0])
        right["length"] += is_true(combinations(case, NOISE, 2)[0])
    assert 8 < right["epipolar"] < 32  # a coin
    assert right["length"] == 40


def test_its_chi_square_is_one():
    # Marks with the assumed noise: 2 free distances in two views, 6 in three.
    rng = np.random.default_rng(3)
    for views in (VIEWS, {**VIEWS, "OBL": camera(40.0, 20.0)}):
        values, free = [], 0
        for _ in range(300):
            case = case_of(screws(rng, 1), views, 1.5, rng)
            one = by_epipolar_distance(case, 1)[0]
            values.append(one.chi_square)
            free = one.degrees_of_freedom
        assert free == 2 * (2 * len(views) - 3)
        assert abs(np.mean(values) / free - 1.0) < 0.15
        if len(views) == 2:
            assert kstest(values, "chi2", args=(free,)).pvalue > 0.01


def test_it_does_not_look_at_the_length():
    case = case_of(screws(np.random.default_rng(4), 1), VIEWS, 1.0, np.random.default_rng(5))
    (one,) = case.implants.values()
    longer = replace(case, implants={one.name: replace(one, center_mm=3.0 * one.center_mm)})
    assert by_epipolar_distance(case)[0].chi_square == by_epipolar_distance(longer)[0].chi_square
    table, longer_table = HypothesisTable(case, NOISE, fit_segment), HypothesisTable(longer, NOISE, fit_segment)
    labels = (("AP", "AP0"), ("LAT", "LAT0"))
    assert longer_table.chi_square(labels) > table.chi_square(labels) + 100
