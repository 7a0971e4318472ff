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


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (3, 3), (2, 4), (4, 2), (3, 1), (4, 4), (5, 3)])
@pytest.mark.parametrize("least", [0.0, -10.0])
def test_they_are_the_cheapest_of_all(shape: tuple[int, int], least: float) -> None:
    rng = np.random.default_rng(5)
    costs = rng.uniform(least, 10, shape)
    costs[rng.random(shape) < 0.2] = np.inf
    want = all_assignments(costs, 6.0)
    got = cheapest_assignments(costs, 6.0, 12)
    np.testing.assert_allclose([a.cost for a in got], want[:12])
    for one in got:  # the cost is that of the columns, not only a cost
        terms = [6.0 if column is None else costs[row, column] for row, column in enumerate(one.columns)]
        np.testing.assert_allclose(sum(terms), one.cost)
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


def test_what_costs_too_much_more_is_left_out() -> None:
    costs = np.random.default_rng(6).uniform(0, 10, (4, 4))
    want = all_assignments(costs, 6.0)
    near = [cost for cost in want if cost <= want[0] + 4.0]
    got = cheapest_assignments(costs, 6.0, 10_000, within=4.0)
    assert 3 < len(near) < len(want)
    np.testing.assert_allclose([one.cost for one in got], near)


def test_sixteen_screws_are_quick() -> None:
    """Exact costs of the best are SciPy's; the k best are found without trying them all (16! of them)."""
    from scipy.optimize import linear_sum_assignment

    costs = np.random.default_rng(7).uniform(0, 100, (16, 16))
    got = cheapest_assignments(costs, 1e4, 40)
    rows, columns = linear_sum_assignment(costs)
    np.testing.assert_allclose(got[0].cost, costs[rows, columns].sum())
    assert [one.cost for one in got] == sorted(one.cost for one in got)
    assert len({one.columns for one in got}) == 40
