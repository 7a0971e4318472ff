"""The tables and files of a benchmark run."""

import csv
import io
from pathlib import Path

from screwpose.benchmark.study import Study, case_rows, spread, summarise
from screwpose.files.atomic import write_json, write_text
from screwpose.report.tables import Column, Table, combination_table, pairing_table

_ERRORS = {
    "tip_mm": "tip, mm",
    "center_mm": "centre, mm",
    "axis_deg": "axis, deg",
    "roll_deg": "roll, deg",
    "shift_x_mm": "centre along CAD x, mm",
    "shift_y_mm": "centre along CAD y, mm",
    "shift_z_mm": "centre along CAD z, mm",
    "turn_x_deg": "turn about CAD x, deg",
    "turn_y_deg": "turn about CAD y, deg",
    "turn_z_deg": "turn about CAD z, deg",
}


def error_table(study: Study) -> Table:
    """Median, p90 and worst of each error over the screws that were paired right; the signed mean shows a bias."""
    rows = [row for row in case_rows(study) if "tip_mm" in row]
    columns = (
        Column("error", "Difference from the truth", is_number=False),
        Column("median", "median"),
        Column("p90", "p90"),
        Column("worst", "worst"),
        Column("mean", "signed mean"),
    )
    lines = []
    for key, title in _ERRORS.items():
        values = [float(row[key]) for row in rows]
        if values:
            is_signed = key not in ("tip_mm", "center_mm", "axis_deg")
            lines.append((title, *spread(values), sum(values) / len(values) if is_signed else None))
    return Table(f"Errors of {len(rows)} screws", columns, tuple(lines))


def outcome_table(study: Study) -> Table:
    """One line a case: what was answered, how sure, how far off, how long."""
    columns = (
        Column("case", "Case", is_number=False),
        Column("status", "Status", is_number=False),
        Column("right", "Pairing", is_number=False),
        Column("probability", "p"),
        Column("tip", "worst tip, mm", digits=2),
        Column("axis", "worst axis, deg", digits=2),
        Column("seconds", "s", digits=1),
    )
    lines = []
    for one in study.outcomes:
        errors = [error for error in one.errors if error is not None]
        lines.append(
            (
                one.answer.case,
                one.answer.status,
                "right" if one.right else "none" if one.answer.pairing.status == "refused" else "wrong",
                one.answer.pairing.probability,
                max((error.tip_mm for error in errors), default=None),
                max((error.axis_deg for error in errors), default=None),
                one.seconds,
            )
        )
    return Table("Cases", columns, tuple(lines))


def write_study(study: Study, folder: Path) -> list[Path]:
    """Write summary.json, screws.csv, and the tables as CSV and Markdown, beside the cases and results of the run."""
    answers = [one.answer for one in study.outcomes]
    tables = {
        "outcomes": outcome_table(study),
        "errors": error_table(study),
        "table1": pairing_table(answers, study.true_pairs),
        "table2": combination_table(answers, study.true_pairs),
    }
    paths = [write_json(folder / "summary.json", summarise(study))]
    rows = case_rows(study)
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    paths.append(write_text(folder / "screws.csv", buffer.getvalue()))
    for name, table in tables.items():
        paths.append(write_text(folder / f"{name}.csv", table.to_csv()))
    text = "\n".join(f"## {table.title}\n\n{table.to_markdown()}" for table in tables.values())
    paths.append(write_text(folder / "tables.md", f"# {study.set_name}, method {study.method}\n\n{text}"))
    return paths
