"""What the terminal says of a benchmark: which sets and methods there are, and what came of a run."""

from collections.abc import Sequence
from typing import Any

from screwpose.benchmark.methods import METHODS
from screwpose.benchmark.record import CaseRecord
from screwpose.benchmark.runner import BenchRun
from screwpose.benchmark.sets import SETS
from screwpose.benchmark.tasks import UNFORESEEN, case_name
from screwpose.cli.terminal import paragraph
from screwpose.files.result import read_summary
from screwpose.files.schema import MethodSummary, PairingRates

_MOST_NAMED = 5


def listing() -> dict[str, Any]:
    """The sets and methods as plain values, for machines."""
    return {
        "sets": {
            name: {"version": one.version, "size": one.size, "origin": one.origin, "description": one.description}
            for name, one in SETS.items()
        },
        "methods": {name: one.description for name, one in METHODS.items()},
    }


def told_listing() -> str:
    """The sets and methods, a paragraph each."""
    lines = ["Sets:"]
    for name, one in SETS.items():
        size = "any number of cases" if one.size is None else f"{one.size} cases"
        lines.append(paragraph(f"  {name} (version {one.version}, {size}): {one.description}", "    "))
    lines.append("Methods:")
    lines += [paragraph(f"  {name}: {one.description}", "    ") for name, one in METHODS.items()]
    return "\n".join(lines)


def told_run(run: BenchRun) -> str:
    """The first figures of a run, what failed, and where the rest is."""
    lines = [paragraph(note) for note in run.notes]
    for set_name, one_set in read_summary(run.path / "summary.json").sets.items():
        lines += [
            paragraph(f"{set_name}, {name}: {_told_figures(one)}", "    ") for name, one in one_set.methods.items()
        ]
    lines += _told_failed(run.failed)
    lines.append(f"Everything is in {run.path}: open {run.path / 'report.html'}")
    return "\n".join(lines)


def _told_figures(one: MethodSummary) -> str:
    rates = one.pairing or PairingRates()
    shares = {"right": rates.right, "sure and wrong": rates.confident_wrong, "refused": rates.refused}
    told = [f"{one.cases} cases", *(f"{what} {share:.1%}" for what, share in shares.items() if share is not None)]
    for name, block, unit in (("tip", one.tip_mm, "mm"), ("axis", one.axis_deg, "deg"), ("time", one.seconds, "s")):
        if block is not None:
            told.append(f"{name} {block.median:.2f} {unit} (p90 {block.p90:.2f}, worst {block.max:.2f})")
    return "; ".join(told)


def _told_failed(failed: Sequence[CaseRecord]) -> list[str]:
    if not failed:
        return []
    lines = [f"{len(failed)} could not be computed, and count as refused:"]
    for one in failed[:_MOST_NAMED]:
        reason = (one.error or "").removeprefix(UNFORESEEN).partition("\n")[0]
        name = case_name(one.set, one.index)
        shown = name if one.case == name else f"{name} ({one.case})"
        lines.append(paragraph(f"  {shown}, {one.method}: {reason}", "    "))
    if len(failed) > _MOST_NAMED:
        lines.append(f"  and {len(failed) - _MOST_NAMED} more: the column `error` of cases.csv has all of them")
    return lines


def told_unforeseen(run: BenchRun) -> str:
    """How many cases failed by a bug."""
    return paragraph(
        f"screwpose: {len(run.unforeseen)} of {len(run.records)} failed by an error that is not foreseen, a bug: the "
        f"records in {run.path / 'records'} have the tracebacks. Take such a record away and go on with --resume to "
        "try it again."
    )


def told_worse(run: BenchRun) -> str:
    """What is worse than the baseline."""
    return "\n".join(paragraph(f"Worse than the baseline: {one}") for one in run.worse)


def summary(run: BenchRun) -> dict[str, Any]:
    """summary.json, for machines."""
    return read_summary(run.path / "summary.json").model_dump(mode="json", exclude_none=True)
