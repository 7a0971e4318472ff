"""What the X-rays say of a registered pair, worked out by hand."""

import numpy as np
import pytest

from screwpose.pairing import LandmarkNoise, ranked_pairings
from screwpose.pairing.hypotheses import Hypothesis
from screwpose.pairing.image_evidence import least_energies, log_odds_of_energy, log_odds_of_pairs
from screwpose.pairing.ranking import Ranking
from tests.pairing.scenes import camera, case_of, screws


@pytest.fixture(scope="module")
def ranking() -> Ranking:
    ends_mm = screws(np.random.default_rng(3), 2)
    case = case_of(ends_mm, {"AP": camera(0.0), "LAT": camera(90.0)}, 1.0, np.random.default_rng(4))
    return ranked_pairings(case, LandmarkNoise())


def test_what_explains_little_is_hardly_a_pair_and_no_energy_is_proof() -> None:
    odds = [log_odds_of_energy(energy) for energy in (-0.1, 0.3, 0.5, 0.55, 0.6, 0.7, 0.95)]
    assert odds == sorted(odds)
    assert odds[3] == 0.0
    assert odds[0] == odds[1] == -odds[-1]
    assert 30.0 < np.exp(odds[-1]) < 76.0  # of 76 wrong pairs none explained so much


def test_the_view_that_shows_least_counts_in_the_best_company(ranking: Ranking) -> None:
    first, second = ranking.combinations[0].hypotheses
    found = log_odds_of_pairs(
        [
            ((first, second), ({"AP": 0.9, "LAT": 0.5}, {"AP": 0.56, "LAT": 0.9})),
            ((first,), ({"AP": 0.53, "LAT": 0.8},)),
        ]
    )
    assert found == {first: pytest.approx(20.0 * (0.53 - 0.55)), second: pytest.approx(20.0 * (0.56 - 0.55))}


def test_a_view_in_which_no_pair_explains_much_is_held_against_none() -> None:
    """As in X-rays of another simulator, of which right models explain a quarter in LAT."""
    both = [{"AP": 0.9, "LAT": 0.27}, {"AP": 0.8, "LAT": 0.25}]
    np.testing.assert_allclose(least_energies(both), [0.55, 0.53])
    # One that explains enough says that the others could.
    third = [*both, {"AP": 0.9, "LAT": 0.6}]
    np.testing.assert_allclose(least_energies(third), [0.27, 0.25, 0.6])
    np.testing.assert_allclose(least_energies(both[:1]), [0.27])


def test_every_pairing_that_has_the_pair_shares_its_odds(ranking: Ranking) -> None:
    pair: Hypothesis = ranking.combinations[0].hypotheses[0]
    has = np.array([pair in one.hypotheses for one in ranking.combinations])
    assert has.any()
    assert not has.all()
    before = ranking.probabilities
    after = ranking.weighed({pair: np.log(1.0 / 9.0)}).probabilities
    by_hand = np.where(has, before / 9.0, before)
    np.testing.assert_allclose(after, by_hand / by_hand.sum(), rtol=1e-12)
    np.testing.assert_allclose(ranking.weighed({}).probabilities, before, rtol=1e-12)
    # What holds of a pair holds of the sum over its pairings.
    odds = before[has].sum() / before[~has].sum()
    assert ranking.weighed({pair: 2.0}).pair_probability(pair.labels) == pytest.approx(
        odds * np.exp(2.0) / (1.0 + odds * np.exp(2.0))
    )
