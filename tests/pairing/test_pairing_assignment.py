"""The k cheapest assignments against all of them."""

from itertools import product

import numpy as np
import pytest

from screwpose.pairing import cheapest_assignments


def all_assignments(costs: np.ndarray, unpaired: float) -> list[float]:
    rows, columns = costs.shape
    totals = []
    for choice in product([None, *range(columns)], repeat=rows):
        taken = [c for c in choice if c is not None]
        if len(set(taken)) == len(taken):
            totals.append(sum(unpaired if c is None else costs[r, c] for r, c in enumerate(choice)))
    return sorted(total for total in totals if np.isfinite(total))


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (3, 3), (2, 4), (4, 2), (3, 1)])
def test_they_are_the_cheapest_of_all(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(5)
    costs = rng.uniform(0, 10, shape)
    costs[rng.random(shape) < 0.2] = np.inf
    want = all_assignments(costs, 6.0)
    got = cheapest_assignments(costs, 6.0, 12)
    np.testing.assert_allclose([a.cost for a in got], want[:12])
    assert len({a.columns for a in got}) == len(got)
    np.testing.assert_allclose(len(cheapest_assignments(costs, 6.0, 10_000)), len(want))


def test_two_by_two_by_hand() -> None:
    first, second, *rest = cheapest_assignments(np.array([[1.0, 9.0], [8.0, 3.0]]), 100.0, 10)
    assert (first.columns, first.cost, first.pairs) == ((0, 1), 4.0, 2)
    assert (second.columns, second.cost) == ((1, 0), 17.0)
    assert rest[0].columns == (0, None)
    assert rest[-1].columns == (None, None)
    assert len(rest) == 5


def test_no_rows_and_no_columns() -> None:
    assert cheapest_assignments(np.zeros((0, 3)), 1.0, 5)[0].columns == ()
    assert cheapest_assignments(np.zeros((2, 0)), 1.0, 5)[0].columns == (None, None)
