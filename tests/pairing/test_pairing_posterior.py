"""The probabilities against numerical integration, against all assignments there are, and against the truth."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.integrate import quad

from screwpose.pairing import HypothesisTable, LandmarkNoise, combinations, fit_epipolar, ranked_pairings
from screwpose.pairing.posterior import PairingModel, log_scale_evidence, scale_mean
from screwpose.pairing.ranking import _Odds
from tests.pairing.scenes import SCREW, camera, case_of, screws

VIEWS = {"AP": camera(0.0), "LAT": camera(90.0)}
NOISE = LandmarkNoise(2.0, 1.0)
MODEL = PairingModel()


@pytest.mark.parametrize(("chi_square", "degrees"), [(3.0, 6), (60.0, 6), (0.5, 3), (20.0, 36), (400.0, 36), (0.0, 0)])
def test_the_noise_is_integrated_out(chi_square: float, degrees: int) -> None:
    sd = MODEL.scale_sd

    def weight(log_s: float) -> float:
        prior = np.exp(-0.5 * (log_s / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
        return float(prior * np.exp(-degrees * log_s - 0.5 * chi_square * np.exp(-2 * log_s)))

    want, _ = quad(weight, -4.0, 4.0, points=[0.0], epsabs=0.0, epsrel=1e-8, limit=400)
    np.testing.assert_allclose(log_scale_evidence(chi_square, degrees, sd), np.log(want), atol=0.02)


def test_many_screws_say_how_exact_their_marks_are() -> None:
    """With 1000 degrees of freedom s is the root of the chi-square over them, whatever was assumed."""
    np.testing.assert_allclose(scale_mean(0.49 * 1000, 1000, MODEL.scale_sd), 0.7, rtol=0.01)
    np.testing.assert_allclose(scale_mean(9.0 * 1000, 1000, MODEL.scale_sd), 3.0, rtol=0.02)
    np.testing.assert_allclose(scale_mean(0.0, 0, MODEL.scale_sd), 1.0, rtol=0.01)


@pytest.mark.parametrize("orders", [{}, {"LAT": [0, 2]}, {"AP": [0, 1], "LAT": [1, 2]}])
def test_the_probabilities_are_those_of_all_assignments(orders: dict[str, list[int]]) -> None:
    """Brute force: every way to give each mark of AP a mark of LAT or none."""
    rng = np.random.default_rng(3)
    ends = screws(rng, 3)
    ends[1] = ends[0] + [6.0, 0.5, 9.0]  # nearly in one epipolar plane: the pairing stays open
    case = case_of(ends, VIEWS, 2.0, rng, orders)
    ranking = ranked_pairings(case, NOISE)
    odds = _Odds(case, NOISE, HypothesisTable(case, NOISE), MODEL)
    ap, lat = (tuple(mark.label for mark in case.annotations[view]) for view in ("AP", "LAT"))
    ways = [
        tuple((("AP", a), ("LAT", b)) for a, b in zip(ap, choice, strict=True) if b is not None)
        for choice in product([None, *lat], repeat=len(ap))
        if len([b for b in choice if b]) == len({b for b in choice if b})
    ]
    weights = np.exp(odds.log_weights(ways))
    weights /= weights.sum()
    assert 0.02 < 1.0 - weights.max() < 0.98
    np.testing.assert_allclose(ranking.probabilities.sum(), 1.0)
    np.testing.assert_allclose(ranking.probabilities[0], weights.max(), atol=1e-4)
    for a in ap:
        for b in lat:
            pair = (("AP", a), ("LAT", b))
            want = sum(w for w, way in zip(weights, ways, strict=True) if pair in way)
            np.testing.assert_allclose(ranking.pair_probability(pair), want, atol=1e-4)
        alone = sum(w for w, way in zip(weights, ways, strict=True) if all(("AP", a) not in pair for pair in way))
        np.testing.assert_allclose(ranking.alone_probability("AP", a), alone, atol=1e-4)
        together = sum(ranking.pair_probability((("AP", a), ("LAT", b))) for b in lat)
        np.testing.assert_allclose(together + ranking.alone_probability("AP", a), 1.0, atol=1e-4)


def test_the_probability_is_how_often_it_is_right() -> None:
    """Over random pairs of screws in one level, marked with any noise from half to twice what is assumed."""
    rng = np.random.default_rng(4)
    said, right = [], []
    for _ in range(300):
        ends = screws(rng, 2)
        ends[1, :] += [0, ends[0, 0, 1] - ends[1, 0, 1] + rng.normal(), 0]
        case = case_of(ends, VIEWS, float(rng.uniform(1.0, 4.0)), rng)
        ranking = ranked_pairings(case, NOISE)
        said.append(ranking.probabilities[0])
        right.append(
            [h.by_view for h in ranking.combinations[0].hypotheses]
            == [{"AP": f"AP{i}", "LAT": f"LAT{i}"} for i in (0, 1)]
        )
    unsure = np.array(said) < 0.9
    assert unsure.sum() > 10
    assert abs(np.mean(said) - np.mean(right)) < 3 * np.sqrt(np.mean(np.array(said) * (1 - np.array(said))) / 300)
    assert abs(np.array(said)[unsure].mean() - np.array(right)[unsure].mean()) < 0.3


def test_a_screw_seen_once_is_left_alone_in_each_view() -> None:
    """AP shows screws 0 to 3, LAT 1 to 4: as many marks in both, and two of them have no partner."""
    alone = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        case = case_of(screws(rng, 5), VIEWS, 1.5, rng, {"AP": [0, 1, 2, 3], "LAT": [1, 2, 3, 4]})
        alone += combinations(case, NOISE, 1)[0].unpaired == {"AP": ("AP0",), "LAT": ("LAT4",)}
    assert alone >= 28


def test_a_mark_whose_screw_may_be_out_of_the_other_image_rather_stays_alone() -> None:
    """The same two marks: at the border of LAT's image a partner is likely to be missing, in its middle not."""
    rng = np.random.default_rng(6)
    ends = screws(rng, 2)
    case = case_of(ends, VIEWS, 1.5, rng)
    middle = _Odds(case, NOISE, HypothesisTable(case, NOISE), MODEL)
    cut = replace(case.views["LAT"].camera, image_size=(1024, 300))
    at_border = replace(case, views={**case.views, "LAT": replace(case.views["LAT"], camera=cut)})
    odds = _Odds(at_border, NOISE, HypothesisTable(at_border, NOISE), MODEL)
    pair = (("AP", "AP0"), ("LAT", "LAT0"))
    assert odds.of(pair)[0] < middle.of(pair)[0] - 1.0


def test_implants_in_one_place_count_against_a_combination() -> None:
    ends = screws(np.random.default_rng(7), 2)
    ends[1] = ends[0] + [1.0, 0, 0]
    case = case_of(ends, VIEWS)
    thick = replace(SCREW, mesh=replace(SCREW.mesh, vertices_mm=np.array([[3.0, 15, 0], [0, 15, 3.0], [-3.0, 15, 0]])))
    pairs = [(("AP", f"AP{i}"), ("LAT", f"LAT{i}")) for i in range(2)]

    def log_weight(implant: object) -> float:
        of = replace(case, implants={"screw": implant})
        return float(_Odds(of, NOISE, HypothesisTable(of, NOISE), MODEL).log_weights([pairs])[0])

    # 5 mm deep at a sigma of 1.5 mm: 3.33 sigmas.
    np.testing.assert_allclose(log_weight(SCREW) - log_weight(thick), 0.5 * (5.0 / 1.5) ** 2, rtol=0.02)


def test_more_views_are_ranked_too() -> None:
    rng = np.random.default_rng(8)
    views = {**VIEWS, "OBL": camera(45.0)}
    ranking = ranked_pairings(case_of(screws(rng, 3), views, 1.0, rng, {"OBL": [1, 2]}), NOISE)
    got = {h.labels for h in ranking.combinations[0].hypotheses}
    assert (("AP", "AP1"), ("LAT", "LAT1"), ("OBL", "OBL1")) in got
    assert (("AP", "AP0"), ("LAT", "LAT0")) in got
    assert ranking.probabilities[0] > 0.9


def test_without_the_length_the_model_is_not_asked() -> None:
    rng = np.random.default_rng(9)
    case = case_of(screws(rng, 2), VIEWS, 1.0, rng)
    ranking = ranked_pairings(case, NOISE, HypothesisTable(case, NOISE, fit_epipolar))
    chi_squares = np.array([one.chi_square for one in ranking.combinations])
    assert len(chi_squares) == 2
    ratio = max(1.0, chi_squares[0] / 4)
    np.testing.assert_allclose(
        ranking.probabilities[1] / ranking.probabilities[0], np.exp(-np.diff(chi_squares)[0] / 2 / ratio)
    )
