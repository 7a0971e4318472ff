"""Has it become worse? A run against a stored baseline, beyond what chance explains."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from screwpose.benchmark.measures_file import MEASURES_FORMAT, Distribution, MeasuresFile, MethodMeasures
from screwpose.benchmark.record import CaseRecord
from screwpose.benchmark.summary import measures_file
from screwpose.files.wording import read_model

# A higher rate of these is better, of the others worse.
_GOOD_RATES = ("right", "pairs_right", "success")
_BAD_RATES = ("confident_wrong", "refused")
_MEDIANS = ("tip_mm", "center_mm", "head_mm", "axis_deg", "roll_deg", "mtre_mm")
# Figures of the same cases and seeds differ by rounding on another processor; that is no worsening.
_ROUNDING = 1e-6


def read_baseline(path: str | Path) -> MeasuresFile:
    """Read and check the measures.json of the run to compare with.

    Raises
    ------
    CaseError
        It is missing or breaks the format; the message names the field.
    """
    return read_model(path, MeasuresFile, MEASURES_FORMAT)


def baseline_of(measures: MeasuresFile) -> MeasuresFile:
    """What the gate looks at, without the rest: small enough to be kept beside the code."""
    return measures.model_copy(
        update={
            "sets": {
                name: some.model_copy(update={"methods": {key: _kept(one) for key, one in some.methods.items()}})
                for name, some in measures.sets.items()
            }
        }
    )


def _kept(one: MethodMeasures) -> MethodMeasures:
    return MethodMeasures(
        cases=one.cases,
        screws=one.screws,
        failed=one.failed,
        rates={key: one.rates[key] for key in (*_GOOD_RATES, *_BAD_RATES) if key in one.rates},
        errors={key: one.errors[key] for key in _MEDIANS if key in one.errors},
        start={},
        relations={},
        parts={},
        bias={},
        stages={},
        coverage={},
        steps={},
        strata={},
        offsets=(),
    )


def check_against(baseline: MeasuresFile, records: Sequence[CaseRecord]) -> list[str]:
    """What is worse than the baseline, one sentence each; empty where nothing is.

    A rate is worse where it is past the baseline's 95 % interval, a median error where it is above its interval. Every
    set and method of the baseline must be there, with the same version of the set. Methods that the baseline does not
    have are not looked at.
    """
    now = measures_file(records, seed=baseline.seed, started=baseline.started)
    worse = []
    for name, stored in baseline.sets.items():
        if name not in now.sets:
            worse.append(f"{name}: the baseline has this set, the run does not.")
            continue
        if now.sets[name].version != stored.version:
            worse.append(
                f"{name}: the run is of version {now.sets[name].version} of the set, the baseline of version "
                f"{stored.version}: make a new baseline."
            )
            continue
        for method, before in stored.methods.items():
            if method not in now.sets[name].methods:
                worse.append(f"{name}, {method}: the baseline has this method, the run does not.")
            else:
                worse += [f"{name}, {method}: {text}" for text in _worse(before, now.sets[name].methods[method])]
    return worse


def _worse(before: MethodMeasures, now: MethodMeasures) -> Iterator[str]:
    for key in (*_GOOD_RATES, *_BAD_RATES):
        if key not in before.rates or key not in now.rates:
            continue
        old, new = before.rates[key], now.rates[key]
        is_worse = new.value < old.low - _ROUNDING if key in _GOOD_RATES else new.value > old.high + _ROUNDING
        if is_worse:
            verb = "fell" if key in _GOOD_RATES else "rose"
            yield (
                f"the share `{key}` {verb} from {old.value:.1%} (95 % interval {old.low:.1%} to {old.high:.1%}) to "
                f"{new.value:.1%} of {new.of}."
            )
    for key in _MEDIANS:
        yield from _worse_median(key, before.errors.get(key), now.errors.get(key))


def _worse_median(key: str, old: Distribution | None, new: Distribution | None) -> Iterator[str]:
    if old is None:
        return
    if new is None:
        yield f"`{key}` has no value any more: no screw is paired right."
    elif new.median.value > old.median.high * (1 + _ROUNDING) + _ROUNDING:
        yield (
            f"the median of `{key}` rose from {old.median.value:.4g} (95 % interval {old.median.low:.4g} to "
            f"{old.median.high:.4g}) to {new.median.value:.4g}."
        )
