"""The blocks that measures are made of: rates, distributions and means, each with its interval."""

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from screwpose.benchmark import bootstrap
from screwpose.benchmark.measures_file import Distribution, Estimate, Rate
from screwpose.benchmark.record import CaseRecord, PoseErrors, ScrewRecord

# What a surgeon would still call the right place: a screw that is off by more is counted as a failed registration.
SUCCESS_TIP_MM = 1.0
SUCCESS_AXIS_DEG = 1.0
_QUANTILES = {"median": 0.5, "p90": 0.9, "p95": 0.95, "p99": 0.99}

Value = tuple[int, float]
"""The number of a value's case, and the value."""


def is_success(record: CaseRecord) -> bool:
    """Paired right, and every screw of a pair within `SUCCESS_TIP_MM` and `SUCCESS_AXIS_DEG`."""
    return record.right and all(screw_succeeded(one) for one in record.screws if len(one.labels) > 1)


def screw_succeeded(screw: ScrewRecord) -> bool:
    """Whether a screw's pose is where one would still call it right."""
    errors = screw.errors
    return errors is not None and errors.tip_mm <= SUCCESS_TIP_MM and errors.axis_deg <= SUCCESS_AXIS_DEG


def is_confident_wrong(record: CaseRecord) -> bool:
    """Sure and wrong, and not merely by labels that no one could tell apart."""
    return record.pairing_status == "confident" and not record.right and not record.harmless_swap


def rate(hits: Iterable[bool]) -> Rate:
    """A share of cases."""
    listed = list(hits)
    return share(sum(listed), len(listed))


def share(hits: int, of: int, trials: int | None = None) -> Rate:
    """A share whose interval counts so many `trials`: cases, where the screws of one share their luck."""
    value = hits / of if of else 0.0
    count = of if trials is None else trials
    low, high = bootstrap.wilson_interval(value * count, count)
    return Rate(hits=hits, of=of, value=value, low=min(low, value), high=max(high, value))


def distribution(values: Sequence[Value]) -> Distribution | None:
    """Quantiles with their intervals; None without values."""
    if not values:
        return None
    numbers = np.array([value for _, value in values], dtype=np.float64)
    cases = np.array([case for case, _ in values], dtype=np.int64)
    points = np.quantile(numbers, list(_QUANTILES.values()))
    intervals = bootstrap.quantile_intervals(numbers, cases, list(_QUANTILES.values()))
    blocks = {
        name: Estimate(value=float(point), low=min(low, float(point)), high=max(high, float(point)))
        for name, point, (low, high) in zip(_QUANTILES, points, intervals, strict=True)
    }
    return Distribution(count=len(values), max=float(numbers.max()), **blocks)


def distributions(values: dict[str, list[Value]]) -> dict[str, Distribution]:
    """Those that have any value."""
    found = {name: distribution(some) for name, some in values.items()}
    return {name: one for name, one in found.items() if one is not None}


def error_values(records: Sequence[CaseRecord], key: str, of: str = "errors") -> list[Value]:
    """One error, without its sign, of every screw that is paired right.

    Parameters
    ----------
    of : "errors" of the answer, or of the "start" that its registration began with.
    """
    blocks: list[tuple[int, PoseErrors | None]] = [
        (index, getattr(screw, of)) for index, record in enumerate(records) for screw in record.screws
    ]
    found = [(index, getattr(block, key)) for index, block in blocks if block is not None]
    return [(index, abs(value)) for index, value in found if value is not None]


def mean(values: Sequence[Value]) -> Estimate:
    """The signed mean of at least one value, with its bootstrap interval over cases."""
    sums: dict[int, list[float]] = defaultdict(list)
    for case, value in values:
        sums[case].append(value)
    # Sorted, so that the order of the cases changes neither the draws nor the rounding.
    table = np.array(sorted((math.fsum(some), len(some)) for some in sums.values()))
    rng = np.random.default_rng(0)
    draws = rng.multinomial(len(table), np.full(len(table), 1.0 / len(table)), size=bootstrap.RESAMPLES)
    means = (draws @ table[:, 0]) / (draws @ table[:, 1])
    low, high = np.quantile(means, [0.5 * (1 - bootstrap.LEVEL), 0.5 * (1 + bootstrap.LEVEL)])
    value = float(table[:, 0].sum() / table[:, 1].sum())
    return Estimate(value=value, low=min(float(low), value), high=max(float(high), value))
