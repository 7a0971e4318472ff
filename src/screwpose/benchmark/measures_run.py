"""From the records of a run to its measures. Whatever order the records and their screws are in, the figures agree."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence

from screwpose.benchmark import bootstrap
from screwpose.benchmark.measures_blocks import (
    Value,
    distribution,
    distributions,
    error_values,
    is_confident_wrong,
    is_success,
    mean,
    rate,
    share,
)
from screwpose.benchmark.measures_file import Bin, Calibration, Estimate, MethodMeasures, Rate, SetMeasures
from screwpose.benchmark.measures_strata import STRATA, offset_bins, strata_bins
from screwpose.benchmark.record import CaseRecord

ERRORS = (
    "tip_mm",
    "center_mm",
    "head_mm",
    "axis_deg",
    "roll_deg",
    "mtre_mm",
    "in_plane_mm",
    "depth_mm",
    "projection_px",
)
# The 68.27 % and 95.45 % quantiles of chi-square with 3, 2 and 1 degrees of freedom: scipy.stats.chi2.ppf(share, n).
CHI2 = {
    "tip": (3.5267403802617303, 8.024881760266252),
    "axis": (2.295748928898636, 6.180074306244173),
    "roll": (1.0, 4.0),
}


def group(records: Iterable[CaseRecord]) -> dict[str, dict[str, list[CaseRecord]]]:
    """Records by set and method, in the order in which these first appear, each list by index."""
    grouped: dict[str, dict[str, list[CaseRecord]]] = {}
    for record in records:
        grouped.setdefault(record.set, {}).setdefault(record.method, []).append(record)
    return {
        name: {method: sorted(some, key=lambda one: one.index) for method, some in methods.items()}
        for name, methods in grouped.items()
    }


def measures_of_set(methods: dict[str, list[CaseRecord]]) -> SetMeasures:
    """The measures of all methods on one set."""
    versions = sorted({record.set_version for records in methods.values() for record in records})
    return SetMeasures(
        version=", ".join(versions), methods={name: measures_of(records) for name, records in methods.items()}
    )


def measures_of(records: Sequence[CaseRecord]) -> MethodMeasures:
    """The measures of one method on one set."""
    return MethodMeasures(
        cases=len(records),
        screws=sum(len(record.screws) for record in records),
        failed=sum(record.error is not None for record in records),
        rates=_rates(records),
        errors=distributions({key: error_values(records, key) for key in ERRORS}),
        start=distributions({key: error_values(records, key, "start") for key in ERRORS}),
        relations=distributions(_relations(records)),
        parts=distributions(_parts(records)),
        bias=_bias(records),
        stages=distributions(_stages(records)),
        coverage=_coverage(records),
        calibration=calibration_of(records),
        told=calibration_of_told(records),
        # A case that could not be computed took no time to solve.
        seconds=distribution([(index, one.seconds) for index, one in enumerate(records) if one.error is None]),
        steps=distributions(_steps(records)),
        strata={name: strata_bins(records, value, edges) for name, (value, edges) in STRATA.items()},
        offsets=offset_bins(records),
    )


def _rates(records: Sequence[CaseRecord]) -> dict[str, Rate]:
    flags: dict[str, Callable[[CaseRecord], bool]] = {
        "right": lambda one: one.right,
        "harmless_swap": lambda one: one.harmless_swap,
        "confident": lambda one: one.pairing_status == "confident",
        "confident_wrong": is_confident_wrong,
        "ambiguous": lambda one: one.pairing_status == "ambiguous",
        "refused": lambda one: one.pairing_status == "refused",
        "success": is_success,
    }
    rates = {name: rate(map(flag, records)) for name, flag in flags.items()}
    true, right = sum(one.pairs_true for one in records), sum(one.pairs_right for one in records)
    if true:
        # The pairs of a case are right or wrong together: the interval counts cases, not pairs.
        cases = sum(one.pairs_true > 0 for one in records)
        rates["pairs_right"] = share(right, true, trials=cases)
    answered = sum(one.pairs_answered for one in records if one.pairing_status != "refused")
    if answered:
        rates["answered_pairs_right"] = share(right, answered, trials=sum(one.pairs_answered > 0 for one in records))
    rates |= _rates_of_alone(records)
    sure = [one for one in records if one.pairing_status == "confident" and not one.harmless_swap]
    if sure:
        rates["right_of_confident"] = rate(one.right for one in sure)
    rates["right_but_harmless"] = rate(one.right for one in records if not one.harmless_swap)
    for stage in ("pre", "post"):
        stages = [getattr(one, stage) for one in records]
        named = [one.chosen_right for one in stages if one is not None and one.chosen_right is not None]
        if named:
            rates[f"dice_{stage}_right"] = rate(named)
    return rates


def _relations(records: Sequence[CaseRecord]) -> dict[str, list[Value]]:
    values: dict[str, list[Value]] = defaultdict(list)
    for index, record in enumerate(records):
        for one in record.relations:
            values[f"{one.between}_mm"].append((index, abs(one.distance_mm)))
            values["angle_deg"].append((index, abs(one.angle_deg)))
    return values


def _parts(records: Sequence[CaseRecord]) -> dict[str, list[Value]]:
    values: dict[str, list[Value]] = defaultdict(list)
    for index, record in enumerate(records):
        for screw in record.screws:
            for name, part in (screw.parts or {}).items():
                values[f"{name}_axis_deg"].append((index, part.axis_deg))
                values[f"{name}_turn_deg"].append((index, part.turn_deg))
    return values


def _bias(records: Sequence[CaseRecord]) -> dict[str, Estimate]:
    values: dict[str, list[Value]] = defaultdict(list)
    for index, record in enumerate(records):
        for screw in record.screws:
            if screw.errors is None:
                continue
            if screw.errors.roll_deg is not None:
                values["roll_deg"].append((index, screw.errors.roll_deg))
            for axis, shift in zip("xyz", screw.errors.shift_in_cad_mm or (), strict=False):
                values[f"shift_{axis}_in_cad_mm"].append((index, shift))
            for view, seen in screw.errors.views.items():
                values[f"depth_mm_{view}"].append((index, seen.depth_mm))
    return {name: mean(some) for name, some in values.items()}


def _stages(records: Sequence[CaseRecord]) -> dict[str, list[Value]]:
    values: dict[str, list[Value]] = defaultdict(list)
    for index, record in enumerate(records):
        for stage in ("pre", "post"):
            block = getattr(record, stage)
            for key in ("dice", "loss", "other_dice", "other_loss"):
                value = None if block is None else getattr(block, key)
                if value is not None:
                    values[f"{stage}_{key}"].append((index, value))
    return values


def _steps(records: Sequence[CaseRecord]) -> dict[str, list[Value]]:
    values: dict[str, list[Value]] = defaultdict(list)
    for index, record in enumerate(records):
        for step, seconds in record.timing_s.items():
            values[step].append((index, seconds))
    return values


def _rates_of_alone(records: Sequence[CaseRecord]) -> dict[str, Rate]:
    """Screws that one view alone shows: how many of them were left without a partner."""
    alone = [
        [screw.outcome != "wrong" for screw in record.screws if len(screw.labels) == 1]
        for record in records
        if record.error is None and record.pairing_status != "refused"
    ]
    count = sum(map(len, alone))
    return {"alone_left": share(sum(map(sum, alone)), count, trials=sum(map(bool, alone)))} if count else {}


def _coverage(records: Sequence[CaseRecord]) -> dict[str, Rate]:
    """The share of screws whose error is within what was said of it: of the tip by its covariance, of the axis, which
    may lean two ways, by the same share of its own distribution, of the roll by one and two sigma."""
    checked: dict[str, list[tuple[int, float, float]]] = {"tip": [], "axis": [], "roll": []}
    for index, record in enumerate(records):
        for screw in record.screws:
            sigma, errors = screw.sigma, screw.errors
            if sigma is None or errors is None:
                continue
            if sigma.mahalanobis2 is not None:
                checked["tip"].append((index, sigma.mahalanobis2, 1.0))
            if sigma.axis_deg:  # root of the sum of the variances of both ways
                checked["axis"].append((index, 2.0 * errors.axis_deg**2, sigma.axis_deg**2))
            if sigma.roll_deg and errors.roll_deg is not None:
                checked["roll"].append((index, errors.roll_deg**2, sigma.roll_deg**2))
    return {
        f"{name}_{count}sigma": share(
            sum(squared <= bound * variance for _, squared, variance in found),
            len(found),
            trials=len({index for index, _, _ in found}),
        )
        for name, found in checked.items()
        if found
        for count, bound in zip((1, 2), CHI2[name], strict=True)
    }


def calibration_of(records: Sequence[CaseRecord]) -> Calibration | None:
    """Over the cases that have a probability and were not refused; None without any."""
    answered = [one for one in records if one.pairing_status != "refused"]
    return _calibration([(one.probability, one.right) for one in answered if one.probability is not None])


def calibration_of_told(records: Sequence[CaseRecord]) -> Calibration | None:
    """Over all pairs and marks alone that have one; None without any."""
    return _calibration([(one.probability, one.right) for record in records for one in record.told])


def _calibration(told: Sequence[tuple[float, bool]]) -> Calibration | None:
    bins = bootstrap.calibration_bins([p for p, _ in told], [right for _, right in told])
    error = bootstrap.calibration_error(bins)
    if error is None:
        return None
    listed = tuple(
        Bin(
            low=one.low,
            high=one.high,
            cases=one.cases,
            mean_probability=one.mean_probability,
            right=share(one.right, one.cases),
        )
        for one in bins
    )
    brier = math.fsum((p - right) ** 2 for p, right in told) / len(told)
    return Calibration(cases=len(told), error=error, brier=brier, bins=listed)
