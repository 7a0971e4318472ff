"""The tables of a run, for people: Markdown, CSV and the page are made of them."""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from screwpose.benchmark.measures_file import (
    Calibration,
    Distribution,
    Estimate,
    MeasuresFile,
    MethodMeasures,
    Rate,
    SetMeasures,
)
from screwpose.benchmark.measures_run import ERRORS
from screwpose.benchmark.record import CaseRecord
from screwpose.errors import CaseError
from screwpose.files.result import read_result
from screwpose.files.schema import SummaryFile
from screwpose.report.tables import Column, Table, Value, combination_table, pairing_table

ERROR_TITLES = {
    "tip_mm": "tip, mm",
    "center_mm": "centre, mm",
    "head_mm": "head, mm",
    "axis_deg": "axis, deg",
    "roll_deg": "roll, deg",
    "mtre_mm": "mTRE, mm",
    "in_plane_mm": "tip in plane, mm",
    "depth_mm": "tip in depth, mm",
    "projection_px": "projection, px",
}
RELATION_TITLES = {
    "heads_mm": "distance of heads, mm",
    "centers_mm": "distance of centres, mm",
    "angle_deg": "angle of axes, deg",
}
STRATUM_TITLES = {
    "overlap": "Overlap of silhouettes",
    "epipolar_ambiguity_px": "Epipolar ambiguity, px",
    "screws": "Number of screws",
    "landmark_noise_px": "Landmark noise, px",
    "view_angle_deg": "Angle between the views, deg",
    "marks_missing": "Marks that are missing",
}
RATE_TITLES = {
    "right": "right",
    "confident": "confident",
    "confident_wrong": "confident and wrong",
    "harmless_swap": "harmless swap",
    "ambiguous": "ambiguous",
    "refused": "refused",
    "pairs_right": "pairs right",
    "success": "success",
}
CONFIDENCE_TITLES = {
    "right_but_harmless": "right, harmless swaps apart",
    "right_of_confident": "right of the confident",
    "answered_pairs_right": "answered pairs right",
    "alone_left": "screws of one view left alone",
}
_COVERAGES = {f"{name}_{count}sigma": (name, f"{count} sigma") for name in ("tip", "axis", "roll") for count in (1, 2)}
_CALIBRATION_TITLES = {"count": "number", "error": "calibration error", "brier": "Brier"}


def percent(rate: Rate | None) -> str | None:
    """A rate with its interval, as in ``98.0 % (94.1-99.4)``."""
    if rate is None or not rate.of:
        return None
    return f"{100 * rate.value:.1f} % ({100 * rate.low:.1f}-{100 * rate.high:.1f})"


def figure(estimate: Estimate | None) -> str | None:
    """A figure with its interval, as in ``0.41 (0.38-0.45)``; alone where resampling cannot move it, as of one case."""
    if estimate is None:
        return None
    if f"{estimate.low:.3g}" == f"{estimate.high:.3g}":
        return f"{estimate.value:.3g}"
    if min(estimate.low, estimate.value) < 0:
        return f"{estimate.value:.3g} ({estimate.low:.3g} to {estimate.high:.3g})"
    return f"{estimate.value:.3g} ({estimate.low:.3g}-{estimate.high:.3g})"


def headline_table(measures: MeasuresFile) -> Table:
    """Methods by sets: what came of the pairings."""
    columns = (
        Column("set", "Set", is_number=False),
        Column("method", "Method", is_number=False),
        Column("cases", "cases"),
        *(Column(key, title) for key, title in RATE_TITLES.items()),
    )
    rows: list[tuple[Value, ...]] = []
    for name, method, one in _each(measures):
        rows.append((name, method, one.cases, *(percent(one.rates.get(key)) for key in RATE_TITLES)))
    return Table("Pairing: shares of all cases, with 95 % intervals", columns, tuple(rows))


def accuracy_table(measures: MeasuresFile) -> Table:
    """Methods by sets: how far off the screws are that are paired right."""
    columns = [
        Column("set", "Set", is_number=False),
        Column("method", "Method", is_number=False),
        Column("screws", "screws"),
    ]
    for key, title in (("tip_mm", "Tip, mm"), ("axis_deg", "Axis, deg"), ("roll_deg", "Roll, deg")):
        columns += [Column(f"{key}_{part}", part, title) for part in ("median", "p90", "max")]
    columns += [
        Column("coverage", "1 sigma covers"),
        Column("calibration", "calibration error"),
        Column("seconds", "s a case"),
    ]
    rows: list[tuple[Value, ...]] = []
    for name, method, one in _each(measures):
        row: list[Value] = [name, method, one.errors["tip_mm"].count if "tip_mm" in one.errors else 0]
        for key in ("tip_mm", "axis_deg", "roll_deg"):
            found = one.errors.get(key)
            row += [None] * 3 if found is None else [figure(found.median), figure(found.p90), f"{found.max:.3g}"]
        row += [
            percent(one.coverage.get("tip_1sigma")),
            None if one.calibration is None else f"{one.calibration.error:.3f}",
            None if one.seconds is None else figure(one.seconds.median),
        ]
        rows.append(tuple(row))
    title = "Accuracy of the screws that are paired right"
    table = Table(title, tuple(columns), tuple(rows))
    empty = [
        column.key
        for place, column in enumerate(columns)
        if column.key in ("coverage", "calibration") and all(row[place] is None for row in rows)
    ]
    return table.without(*empty)


def confidence_table(measures: MeasuresFile) -> Table:
    """Methods by sets: whether what is sure is right, probabilities mean what they say, and errors are as expected."""
    columns = (
        Column("set", "Set", is_number=False),
        Column("method", "Method", is_number=False),
        *(Column(key, title) for key, title in CONFIDENCE_TITLES.items()),
        *(Column(f"{of}_{key}", title, of) for of in ("cases", "pairs") for key, title in _CALIBRATION_TITLES.items()),
        *(Column(key, title, f"{name} within") for key, (name, title) in _COVERAGES.items()),
    )
    rows: list[tuple[Value, ...]] = [
        (
            name,
            method,
            *(percent(one.rates.get(key)) for key in CONFIDENCE_TITLES),
            *_calibration_cells(one.calibration),
            *_calibration_cells(one.told),
            *(
                percent(one.coverage.get(f"{part}_{count}sigma"))
                for part in ("tip", "axis", "roll")
                for count in (1, 2)
            ),
        )
        for name, method, one in _each(measures)
    ]
    if len(measures.sets) > 1:
        rows += [
            (
                "all",
                method,
                *[None] * len(CONFIDENCE_TITLES),
                *_calibration_cells(one),
                *_calibration_cells(measures.told.get(method)),
                *[None] * len(_COVERAGES),
            )
            for method, one in measures.calibration.items()
        ]
    table = Table("Confidence: of what was answered", columns, tuple(rows))
    empty = [column.key for place, column in enumerate(columns) if all(row[place] is None for row in rows)]
    return table.without(*empty)


def _calibration_cells(one: Calibration | None) -> tuple[Value, ...]:
    if one is None:
        return (None,) * len(_CALIBRATION_TITLES)
    return one.cases, f"{100 * one.error:.2f} %", None if one.brier is None else f"{one.brier:.4f}"


def distribution_table(title: str, found: dict[str, Distribution], titles: dict[str, str]) -> Table:
    """One line a measure: its quantiles with their intervals, and the largest."""
    columns = (
        Column("measure", "Measure", is_number=False),
        Column("count", "number"),
        *(Column(part, part) for part in ("median", "p90", "p95", "p99", "max")),
    )
    rows = tuple(
        (titles.get(key, key), one.count, *map(figure, (one.median, one.p90, one.p95, one.p99)), f"{one.max:.3g}")
        for key, one in found.items()
    )
    return Table(title, columns, rows)


def error_table(one: MethodMeasures) -> Table:
    """All errors of the screws that are paired right."""
    found = {key: one.errors[key] for key in ERRORS if key in one.errors}
    return distribution_table("Errors of the screws that are paired right", found, ERROR_TITLES)


def more_table(one: MethodMeasures) -> Table:
    """What a rod sees, parts that move, and the poses that the registration began with."""
    found = {f"between screws: {RELATION_TITLES.get(key, key)}": value for key, value in one.relations.items()}
    found |= {f"part: {key.replace('_', ' ')}": value for key, value in one.parts.items()}
    found |= {f"start: {ERROR_TITLES.get(key, key)}": value for key, value in one.start.items()}
    return distribution_table("Between screws, of their parts, and at the start", found, {})


def stratum_table(name: str, some: SetMeasures) -> Table:
    """One stratum, all methods side by side: pairing and success in each bin."""
    parts: tuple[tuple[str, str, Callable[[MethodMeasures, str], Value]], ...] = (
        ("right", "right", lambda one, key: _in_bin(one, name, key, "right")),
        ("confident_wrong", "confident and wrong", lambda one, key: _in_bin(one, name, key, "confident_wrong")),
        ("success", "success", lambda one, key: _in_bin(one, name, key, "success")),
        ("tip", "tip median, mm", lambda one, key: _tip_in_bin(one, name, key)),
    )
    bins = list(dict.fromkeys(one.name for method in some.methods.values() for one in method.strata[name]))
    first = next(iter(some.methods.values()))
    counts = {one.name: one.cases for one in first.strata[name]}
    columns = [Column("bin", STRATUM_TITLES.get(name, name), is_number=False), Column("cases", "cases")]
    for method in some.methods:
        columns += [Column(f"{method}_{key}", title, method) for key, title, _ in parts]
    rows: list[tuple[Value, ...]] = []
    for key in bins:
        cells = [value(method, key) for method in some.methods.values() for _, _, value in parts]
        rows.append((key, counts.get(key), *cells))
    return Table(STRATUM_TITLES.get(name, name), tuple(columns), tuple(rows))


def _in_bin(one: MethodMeasures, stratum: str, key: str, rate: str) -> Value:
    return next((percent(getattr(found, rate)) for found in one.strata[stratum] if found.name == key), None)


def _tip_in_bin(one: MethodMeasures, stratum: str, key: str) -> Value:
    tips = next((found.tip_mm for found in one.strata[stratum] if found.name == key), None)
    return None if tips is None else figure(tips.median)


def ratio_table(summary: SummaryFile) -> Table:
    """Methods side by side: every figure over that of the method that all are compared with."""
    ratios = summary.ratios or {}
    keys = list(dict.fromkeys(key for pairs in ratios.values() for found in pairs.values() for key in found))
    columns = (
        Column("set", "Set", is_number=False),
        Column("methods", "Methods", is_number=False),
        *(Column(key, key.replace("_", " "), digits=2) for key in keys),
    )
    rows = tuple(
        (name, methods, *(found.get(key) for key in keys))
        for name, pairs in ratios.items()
        for methods, found in pairs.items()
    )
    return Table("Methods side by side, as ratios", columns, rows)


def paper_tables(folder: Path, records: Sequence[CaseRecord]) -> tuple[Table, Table]:
    """Tables 1 and 2 of the paper for one set and method, from the results that stand in the run's folder."""
    # People copy case files with their id: two cases of one name are two cases.
    known = Counter(record.case for record in records)
    names = [one.case if known[one.case] == 1 else f"{one.case} ({one.index})" for one in records]
    answers = []
    for name, record in zip(names, records, strict=True):
        try:
            answers.append(read_result(result_file(folder, record)).model_copy(update={"case": name}))
        except CaseError:  # a case that could not be computed has left none; it is listed among the failed
            continue
    true_pairs = {name: record.true_pairs for name, record in zip(names, records, strict=True)}
    return pairing_table(answers, true_pairs), combination_table(answers, true_pairs)


def result_file(folder: Path, record: CaseRecord) -> Path:
    """Where the run keeps the answer of a case and method."""
    return folder / "results" / record.method / f"{record.set}-{record.index:04d}" / "result.json"


def _each(measures: MeasuresFile) -> list[tuple[str, str, MethodMeasures]]:
    return [(name, method, one) for name, some in measures.sets.items() for method, one in some.methods.items()]
