"""measures.json and summary.json of a run, from its records."""

import os
import platform
from collections.abc import Sequence

from screwpose import __version__
from screwpose.benchmark.measures_file import Distribution, MeasuresFile, MethodMeasures
from screwpose.benchmark.measures_run import calibration_of, calibration_of_told, group, measures_of_set
from screwpose.benchmark.record import CaseRecord
from screwpose.files.schema import (
    Coverage,
    MethodSummary,
    PairingRates,
    Quantiles,
    SetSummary,
    Software,
    StageQuantiles,
    SummaryFile,
)

_RATES = ("right", "confident", "confident_wrong", "ambiguous", "refused", "pairs_right")
# What every method is compared with, where it took part.
_BASE = "default"


def measures_file(records: Sequence[CaseRecord], *, seed: int, started: str) -> MeasuresFile:
    """All measures of a run.

    Parameters
    ----------
    started : when the run began, ISO 8601.
    """
    by_method: dict[str, list[CaseRecord]] = {}
    for record in records:
        by_method.setdefault(record.method, []).append(record)
    told = {method: (calibration_of(some), calibration_of_told(some)) for method, some in by_method.items()}
    return MeasuresFile(
        sets={name: measures_of_set(methods) for name, methods in group(records).items()},
        calibration={method: one for method, (one, _) in told.items() if one is not None},
        told={method: one for method, (_, one) in told.items() if one is not None},
        seed=seed,
        started=started,
        machine=f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, "
        f"Python {platform.python_version()}",
        software=Software(name="screwpose", version=__version__),
    )


def summarise(measures: MeasuresFile) -> SummaryFile:
    """summary.json: the figures alone."""
    sets = {
        name: SetSummary(methods={method: _method_summary(one) for method, one in some.methods.items()})
        for name, some in measures.sets.items()
    }
    found = {name: _ratios(some.methods) for name, some in measures.sets.items()}
    ratios = {name: pairs for name, pairs in found.items() if pairs}
    return SummaryFile(
        format="screwpose-summary/1",
        sets=sets,
        ratios=ratios or None,
        seed=measures.seed,
        started=measures.started,
        machine=measures.machine,
        software=measures.software,
    )


def _method_summary(one: MethodMeasures) -> MethodSummary:
    def block(distributions: dict[str, Distribution], key: str) -> Quantiles | None:
        found = distributions.get(key)
        return None if found is None else quantiles_of(found)

    def stage(name: str) -> StageQuantiles | None:
        dice, loss = block(one.stages, f"{name}_dice"), block(one.stages, f"{name}_loss")
        return None if dice is None and loss is None else StageQuantiles(dice=dice, loss=loss)

    coverage = {name: rate.value for name, rate in one.coverage.items() if name in Coverage.model_fields}
    return MethodSummary(
        cases=one.cases,
        screws=one.screws,
        pairing=PairingRates(**{name: one.rates[name].value for name in _RATES if name in one.rates}),
        tip_mm=block(one.errors, "tip_mm"),
        center_mm=block(one.errors, "center_mm"),
        head_mm=block(one.errors, "head_mm"),
        axis_deg=block(one.errors, "axis_deg"),
        roll_deg=block(one.errors, "roll_deg"),
        pre=stage("pre"),
        post=stage("post"),
        coverage=Coverage(**coverage) if coverage else None,
        calibration_error=None if one.calibration is None else one.calibration.error,
        seconds=None if one.seconds is None else quantiles_of(one.seconds),
    )


def quantiles_of(one: Distribution) -> Quantiles:
    """The five figures without their intervals."""
    return Quantiles(median=one.median.value, p90=one.p90.value, p95=one.p95.value, p99=one.p99.value, max=one.max)


def _ratios(methods: dict[str, MethodMeasures]) -> dict[str, dict[str, float]]:
    """Every method's figures over those of the base: the method `default`, else the last one."""
    base = _BASE if _BASE in methods else list(methods)[-1]
    below = _compared(methods[base])
    ratios = {}
    for name, one in methods.items():
        above = _compared(one)
        found = {key: above[key] / value for key, value in below.items() if key in above and value > 0.0}
        if name != base and found:
            ratios[f"{name}/{base}"] = found
    return ratios


def _compared(one: MethodMeasures) -> dict[str, float]:
    figures = {"pairing_right": one.rates["right"].value}
    for key in ("tip_mm", "axis_deg", "roll_deg"):
        if key in one.errors:
            figures |= {f"{key}_median": one.errors[key].median.value, f"{key}_p90": one.errors[key].p90.value}
    if one.seconds is not None:
        figures["seconds_median"] = one.seconds.median.value
    return figures
