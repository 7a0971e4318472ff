"""cases.csv and screws.csv: a row a case and method, a row a screw of the truth."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from screwpose.benchmark.measures_blocks import is_confident_wrong, is_success
from screwpose.benchmark.record import CaseRecord, PoseErrors, ScrewRecord

Cell: TypeAlias = str | int | float | bool | None
Row: TypeAlias = dict[str, Cell]


def case_row(record: CaseRecord) -> Row:
    """What is known of a case, flat."""
    errors = [screw.errors for screw in record.screws if screw.errors is not None]
    row: Row = {
        **_key(record),
        "set_version": record.set_version,
        "seed": record.seed,
        "status": record.status,
        "pairing_status": record.pairing_status,
        "probability": record.probability,
        "right": record.right,
        "harmless_swap": record.harmless_swap,
        "confident_wrong": is_confident_wrong(record),
        "success": is_success(record),
        "pairs_right": record.pairs_right,
        "pairs_answered": record.pairs_answered,
        "pairs_true": record.pairs_true,
        "combinations": record.combinations,
        "worst_tip_mm": max((one.tip_mm for one in errors), default=None),
        "worst_axis_deg": max((one.axis_deg for one in errors), default=None),
        "seconds": record.seconds,
        **{f"seconds_{step}": seconds for step, seconds in record.timing_s.items()},
    }
    if record.strata is not None:
        strata = record.strata.model_dump()
        row |= {f"overlap_{view}": share for view, share in strata.pop("overlap").items()}
        row |= {f"stratum_{key}": value for key, value in strata.items()}
    for stage in ("pre", "post"):
        block = getattr(record, stage)
        if block is not None:
            row |= {f"{stage}_{key}": value for key, value in block.model_dump().items()}
    return row | {"error": record.error, "reasons": " | ".join(record.reasons) or None}


def screw_row(record: CaseRecord, screw: ScrewRecord) -> Row:
    """One screw of the truth, flat; errors stand where its labels were answered right."""
    row: Row = {
        **_key(record),
        "screw": " ".join(f"{view}:{label}" for view, label in screw.labels.items()),
        "model": screw.model,
        "outcome": screw.outcome,
        "answered_model": screw.answered_model,
        "screw_status": screw.status,
        "case_right": record.right,
        "harmless_swap": record.harmless_swap,
        "symmetry_order": screw.symmetry_order,
        **_flat(screw.errors),
        **{f"start_{key}": value for key, value in _flat(screw.start).items() if not key.startswith("view_")},
    }
    for name, part in (screw.parts or {}).items():
        row |= {f"part_{name}_{key}": value for key, value in part.model_dump().items()}
    if screw.sigma is not None:
        row |= {f"sigma_{key}": value for key, value in screw.sigma.model_dump().items()}
    return row


def _key(record: CaseRecord) -> Row:
    return {"set": record.set, "method": record.method, "index": record.index, "case": record.case}


def _flat(errors: PoseErrors | None) -> Row:
    if errors is None:
        return {}
    row: Row = {}
    for key, value in errors.model_dump(exclude={"views"}).items():
        if key in ("shift_in_cad_mm", "turn_in_cad_deg"):
            kind, unit = ("shift", "mm") if key.startswith("shift") else ("turn", "deg")
            row |= {f"{kind}_{axis}_in_cad_{unit}": one for axis, one in zip("xyz", value or (), strict=False)}
        else:
            row[key] = value
    for view, seen in errors.views.items():
        row |= {f"view_{view}_{key}": value for key, value in seen.model_dump().items()}
    return row


def cases_csv(records: Iterable[CaseRecord]) -> str:
    """cases.csv."""
    return to_csv([case_row(record) for record in records])


def screws_csv(records: Iterable[CaseRecord]) -> str:
    """screws.csv."""
    return to_csv([screw_row(record, screw) for record in records for screw in record.screws])


def to_csv(rows: Sequence[Mapping[str, Cell]]) -> str:
    """Rows with whatever keys they have; an empty field where a row lacks one. No text can run as a formula."""
    buffer = io.StringIO()
    names = list(dict.fromkeys(key for row in rows for key in row))
    writer = csv.DictWriter(buffer, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: _field(value) for key, value in row.items()} for row in rows)
    return buffer.getvalue()


def _field(value: Cell) -> Cell:
    """Yes and no for people; a text that a spreadsheet would run is quoted: ids come from other people's files."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r") else value
