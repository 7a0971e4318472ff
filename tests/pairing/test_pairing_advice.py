"""Why a pairing is open, and what would settle it: scenes in which one thing would."""

import re
from dataclasses import replace

import numpy as np
import pytest

from screwpose.pairing import LandmarkNoise, ranked_pairings
from screwpose.pairing.advice import between, remedies, why_open
from screwpose.pairing.ranking import Ranking
from tests.pairing.scenes import SCREW, camera, case_of, screws

VIEWS = {"AP": camera(0.0), "LAT": camera(90.0)}
NOISE = LandmarkNoise(2.0, 1.0)


def of_one_level(second_off: list[list[float]]) -> np.ndarray:
    """Two screws side by side at one height (y is along the spine), the second moved at its tip and centre."""
    first = np.array([[-15.0, 0, -10], [-12.0, 0, 12.3]])
    return np.array([first, first * [-1, 1, 1] + second_off])


def test_two_screws_at_one_height_may_be_the_other_way_round() -> None:
    case = case_of(of_one_level([[0, 0, 9.0], [0, 0, 9.0]]), VIEWS, 0.3, np.random.default_rng(1))
    ranking = ranked_pairings(case, NOISE)
    assert ranking.probabilities[0] < 0.98
    words = why_open(case, NOISE, ranking)
    assert words is not None
    assert "AP AP0 = LAT LAT" in words
    assert "may be the other way round in LAT" in words
    # Seen from between, the wrong ones would lie centimetres beside the right ones.
    assert words.endswith("a third view from between would settle it")


def test_what_changes_nothing_is_said_to() -> None:
    first = np.array([[-3.0, 0, -10], [-2.0, 0, 12.3]])  # near to each other: what is nearer to a source looks larger
    case = case_of(np.array([first, first * [-1, 1, 1]]), VIEWS)
    words = why_open(case, NOISE, ranked_pairings(case, NOISE))
    assert words is not None
    assert re.search(r"no screw would lie more than 0\.[0-2] mm elsewhere", words)


def test_a_pairing_whose_screws_are_of_other_models_moves_them() -> None:
    """The other way round each screw would have to be of the other length: no two of them are the same screw."""
    case = case_of(of_one_level([[0, 0, 0], [0, 0, 0]]), VIEWS)
    best, other = ranked_pairings(case, NOISE).combinations[:2]
    renamed = replace(other, hypotheses=tuple(replace(one, model="another") for one in other.hypotheses))
    with_another = replace(case, implants={**case.implants, "another": SCREW})
    words = why_open(with_another, NOISE, Ranking((best, renamed), np.array([0.6, 0.4]), 1.0))
    assert words is not None
    assert "may be the other way round" in words
    assert "elsewhere" not in words


def test_a_mark_that_may_be_another_s_is_named() -> None:
    """LAT shows one of two screws at one height: which one, the marks do not say."""
    case = case_of(of_one_level([[0, 0, 9.0], [0, 0, 9.0]]), VIEWS, 0.3, np.random.default_rng(1), {"LAT": [0]})
    words = why_open(case, NOISE, ranked_pairings(case, NOISE))
    assert words is not None
    assert words.startswith("AP AP")
    assert "= LAT LAT0 may be AP AP" in words


def test_one_combination_alone_is_not_open() -> None:
    ends = np.array([[[0, 0, 0], [0, 0, 22.5]], [[10, 40, 0], [10, 40, 22.5]]])
    case = case_of(ends[:1], VIEWS, 0.5)
    ranking = ranked_pairings(case, NOISE)
    assert len(ranking.combinations) >= 1
    assert why_open(case, NOISE, type(ranking)(ranking.combinations[:1], np.ones(1), 1.0)) is None


def test_the_remedies_by_hand() -> None:
    """Second screw shorter in depth by tilting: the far end, far away, lies at another height than the first's."""
    ends = of_one_level([[0, 0, 0], [0, 0, 0]])
    ends[1, 1] += [0, 0.8, 0]  # leans by 2 degrees along the spine: 0.8 mm at the centre, 1.6 mm at twice the distance
    case = case_of(ends, VIEWS)
    ranking = ranked_pairings(case, NOISE)
    best, other = ranking.combinations[:2]
    told = {one.what: one.probability for one in remedies(case, NOISE, best, other, 0.0, 1.0)}
    assert all(0.5 <= probability <= 1.0 for probability in told.values())
    # Marking once more brings as much as the marks now say: half the chi-square of the other way round, of exact marks.
    again = told["marking these screws once more"]
    np.testing.assert_allclose(np.log(again / (1 - again)), 0.5 * (other.chi_square - best.chi_square), rtol=0.05)


@pytest.mark.parametrize("angle_deg", [90.0, 60.0, 120.0])
def test_a_view_from_between(angle_deg: float) -> None:
    one, other = camera(0.0), camera(angle_deg)
    view = between(one, other, np.zeros(3))
    np.testing.assert_allclose(view.project(np.zeros(3)), one.project(np.zeros(3)), atol=1e-6)
    cosines = [abs(float(view.viewing_axis_in_world @ c.viewing_axis_in_world)) for c in (one, other)]
    np.testing.assert_allclose(cosines[0], cosines[1], atol=1e-9)
    half = 0.5 * min(angle_deg, 180.0 - angle_deg)
    np.testing.assert_allclose(np.degrees(np.arccos(cosines[0])), half, atol=1e-6)


def test_three_screws_are_told_by_those_that_differ() -> None:
    rng = np.random.default_rng(4)
    pair = of_one_level([[0, 0, 9.0], [0, 0, 9.0]])
    far = screws(rng, 1) + [0, 60.0, 0]
    case = case_of(np.vstack([pair, far]), VIEWS, 0.3, rng)
    words = why_open(case, NOISE, ranked_pairings(case, NOISE))
    assert words is not None
    assert "AP2" not in words
