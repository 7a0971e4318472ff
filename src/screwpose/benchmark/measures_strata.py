"""Where does it break? The cases of a run in bins of what makes them hard."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from screwpose.benchmark.measures_blocks import (
    Value,
    distribution,
    error_values,
    is_confident_wrong,
    is_success,
    rate,
    screw_succeeded,
    share,
)
from screwpose.benchmark.measures_file import Offset, Stratum
from screwpose.benchmark.record import CaseRecord

_INFINITY = math.inf


def _overlap(record: CaseRecord) -> float | None:
    return None if record.strata is None else max(record.strata.overlap.values(), default=0.0)


def _of_strata(key: str) -> Callable[[CaseRecord], float | None]:
    return lambda record: None if record.strata is None else getattr(record.strata, key)


STRATA: dict[str, tuple[Callable[[CaseRecord], float | None], tuple[float, ...]]] = {
    "overlap": (_overlap, (0.0, 0.05, 0.25, 0.5, 0.75, _INFINITY)),
    "epipolar_ambiguity_px": (_of_strata("epipolar_ambiguity_px"), (0.0, 2.0, 5.0, 10.0, 20.0, 50.0, _INFINITY)),
    "screws": (_of_strata("screws"), (1.0, 2.0, 3.0, 5.0, 7.0, 9.0, 13.0, _INFINITY)),
    "landmark_noise_px": (_of_strata("landmark_noise_px"), (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 5.0, _INFINITY)),
    "view_angle_deg": (_of_strata("view_angle_deg"), (0.0, 60.0, 75.0, 90.0, 105.0, 120.0, _INFINITY)),
    "marks_missing": (_of_strata("marks_missing"), (0.0, 1.0, 2.0, 4.0, _INFINITY)),
}
OFFSET_EDGES_MM = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, _INFINITY)


def strata_bins(
    records: Sequence[CaseRecord], value_of: Callable[[CaseRecord], float | None], edges: Sequence[float]
) -> tuple[Stratum, ...]:
    """The bins that hold any case; cases without the value stand in one of their own, so that none is left out."""
    values = [value_of(record) for record in records]
    bins: list[tuple[float | None, float | None, list[CaseRecord]]] = [
        (
            low,
            high,
            [one for one, value in zip(records, values, strict=True) if value is not None and low <= value < high],
        )
        for low, high in pairwise(edges)
    ]
    bins.append((None, None, [one for one, value in zip(records, values, strict=True) if value is None]))
    return tuple(_stratum(low, high, inside) for low, high, inside in bins if inside)


def _stratum(low: float | None, high: float | None, records: Sequence[CaseRecord]) -> Stratum:
    return Stratum(
        name=_bin_name(low, high),
        low=low,
        high=None if high == _INFINITY else high,
        cases=len(records),
        right=rate(one.right for one in records),
        confident_wrong=rate(map(is_confident_wrong, records)),
        refused=rate(one.pairing_status == "refused" for one in records),
        success=rate(map(is_success, records)),
        tip_mm=distribution(error_values(records, "tip_mm")),
    )


def _bin_name(low: float | None, high: float | None) -> str:
    if low is None or high is None:
        return "not known"
    return f"{low:g} and more" if high == _INFINITY else f"{low:g} to {high:g}"


def offset_bins(records: Sequence[CaseRecord]) -> tuple[Offset, ...]:
    """Screws that are paired right, by the distance of their start's tip from the truth."""
    found = []
    started = [
        (index, screw, screw.start.tip_mm)
        for index, record in enumerate(records)
        for screw in record.screws
        if screw.start is not None
    ]
    for low, high in pairwise(OFFSET_EDGES_MM):
        inside = [(index, screw) for index, screw, tip_mm in started if low <= tip_mm < high]
        if not inside:
            continue
        tips: list[Value] = [(index, screw.errors.tip_mm) for index, screw in inside if screw.errors is not None]
        found.append(
            Offset(
                name=_bin_name(low, high),
                low=low,
                high=None if high == _INFINITY else high,
                screws=len(inside),
                success=share(
                    sum(screw_succeeded(screw) for _, screw in inside),
                    len(inside),
                    trials=len({index for index, _ in inside}),
                ),
                tip_mm=distribution(tips),
            )
        )
    return tuple(found)
