"""The k cheapest ways to give each row a column of its own, or none."""

import heapq
from dataclasses import dataclass, field

import numpy as np

from screwpose._types import FloatArray


@dataclass(frozen=True)
class Assignment:
    """`columns[i]` is row i's column, or None; `cost` is the sum, with the price of each row that has none."""

    columns: tuple[int | None, ...]
    cost: float

    @property
    def pairs(self) -> int:
        """How many rows have a column."""
        return sum(column is not None for column in self.columns)


@dataclass(order=True)
class _Node:
    cost: float
    order: int
    assigned: tuple[int, ...] = field(compare=False)
    costs: FloatArray = field(compare=False)


def cheapest_assignments(
    costs: FloatArray, unpaired_cost: float, count: int, within: float = np.inf
) -> list[Assignment]:
    """The `count` cheapest assignments, cheapest first.

    Parameters
    ----------
    costs : (rows, columns); infinity forbids a pair.
    unpaired_cost : the price of a row without a column. Columns left over cost nothing.
    within : those that cost so much more than the cheapest are left out.

    References
    ----------
    Murty (1968), "An algorithm for ranking all the assignments in order of increasing cost".
    """
    from scipy.optimize import linear_sum_assignment

    rows, columns = costs.shape
    if rows == 0:
        return [Assignment((), 0.0)]
    # Each row has a column of its own that means 'none', so that no two solutions mean the same.
    none = np.full((rows, rows), np.inf)
    np.fill_diagonal(none, unpaired_cost)

    def solve(allowed: FloatArray, order: int) -> _Node | None:
        try:
            row_index, column_index = linear_sum_assignment(allowed)
        except ValueError:  # SciPy's word for: no assignment is left
            return None
        return _Node(float(allowed[row_index, column_index].sum()), order, tuple(map(int, column_index)), allowed)

    first = solve(np.hstack([costs, none]), 0)
    heap = [first] if first is not None else []
    solved = 1
    found: list[Assignment] = []
    while heap and len(found) < count:
        node = heapq.heappop(heap)
        if found and node.cost > found[0].cost + within:
            break
        found.append(Assignment(tuple(c if c < columns else None for c in node.assigned), node.cost))
        # Murty's partition of the rest: the first i rows as here, row i otherwise.
        fixed = node.costs.copy()
        for row, column in enumerate(node.assigned):
            other = fixed.copy()
            other[row, column] = np.inf
            branch = solve(other, solved)
            solved += 1
            if branch is not None and branch.cost <= found[0].cost + within:
                heapq.heappush(heap, branch)
            keep = fixed[row, column]
            fixed[row, :] = np.inf
            fixed[:, column] = np.inf
            fixed[row, column] = keep
    return found
