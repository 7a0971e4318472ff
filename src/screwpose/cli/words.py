"""What the terminal says: findings, results, models, in plain words."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from screwpose.cli.terminal import paragraph, plain
from screwpose.files.findings import Finding
from screwpose.files.schema import ResultFile
from screwpose.implants.health import MeshReport
from screwpose.implants.landmarks import LandmarkProposal
from screwpose.report.comparison import Comparison
from screwpose.report.tables import chosen_combination, pairs_text
from screwpose.report.words import expected_error_text

_MEANING = {
    "confident": "the landmarks leave no other pairing",
    "ambiguous": "an answer that may be wrong: read the warnings",
    "refused": "no answer: read the warnings",
}
DISCLAIMER = "Research software, not a medical device."
_LONGEST_LABEL = 40


def told_result(out: Path, answer: ResultFile) -> str:
    """The answer in a few lines, and where to look."""
    lines = [paragraph(f"{answer.case}: {answer.status} ({_MEANING[answer.status]})")]
    if answer.pairing.pairs:
        sure = "" if answer.pairing.probability is None else f", probability {answer.pairing.probability:.4f}"
        lines.append(paragraph(f"Pairing: {_names(answer.pairing.pairs)} ({answer.pairing.status}{sure})"))
    for screw in answer.screws:
        tip, axis = _triple(screw.tip, ".2f"), _triple(screw.axis, ".4f")
        lines.append(paragraph(f"  {_names([screw.labels])}: {_short(screw.model)}, {screw.status}", "    "))
        lines.append(f"    tip [{tip}] mm, axis [{axis}]")
        expected = expected_error_text(screw.sigma)
        if expected is not None:
            lines.append(paragraph(f"    expected errors: {expected.replace('°', ' deg')}", "    "))
    lines += _told_combinations(answer)
    lines += [paragraph(f"Warning: {warning}") for warning in answer.warnings]
    lines += [f"{answer.timing_s['total']:.1f} s. Open {out / 'report.html'}", DISCLAIMER]
    return "\n".join(lines)


def _told_combinations(answer: ResultFile) -> list[str]:
    """Of each combination the Dice, the mean loss and the losses by view, before -> after."""
    chosen = chosen_combination(answer)
    lines = []
    for one in answer.combinations:
        stages = [one.pre] if one.post is None else [one.pre, one.post]
        values = {"Dice": [stage.dice for stage in stages], "loss": [stage.loss for stage in stages]}
        values |= {f"loss {view}": [stage.views[view].loss for stage in stages] for view in one.pre.views}
        told = ", ".join(f"{name} {' -> '.join(f'{v:.3f}' for v in numbers)}" for name, numbers in values.items())
        lines.append(paragraph(f"  {'chosen' if one is chosen else 'other'}: {_names(one.pairs)}", "    "))
        lines.append(paragraph(f"    {told}", "    "))
    return ["Combinations, before -> after registration:", *lines] if lines else []


def told_demo(out: Path, answer: ResultFile, comparison: Comparison | None) -> str:
    """As `told_result`, with the errors against the truth."""
    lines = [told_result(out, answer), ""]
    if comparison is not None:
        lines.append(f"Against the truth ({comparison.origin}):")
        for screw in comparison.screws:
            name = _names([screw.labels])
            if not screw.pairing_right:
                lines.append(f"  {name}: paired wrong")
            else:
                lines.append(
                    f"  {name}: paired right, tip {screw.tip_mm:.2f} mm, axis {screw.axis_deg:.2f} deg, "
                    f"roll {screw.roll_deg:.1f} deg off"
                )
    lines.append(f"The case is in {out / 'case'}: solve it again with screwpose solve {out / 'case'} -o OUT")
    return "\n".join(lines)


def told_findings(case: Path, findings: Sequence[Finding]) -> str:
    """Each finding in a paragraph, errors first, and how many there are."""
    ordered = sorted(findings, key=lambda finding: finding.level != "error")
    errors = sum(finding.level == "error" for finding in findings)
    verdict = f"{case}: {_count(errors, 'error')}, {_count(len(findings) - errors, 'warning')}"
    if not findings:
        verdict = f"{case}: nothing wrong was found"
    return "\n".join([*(paragraph(f"{finding.level}: {finding}") for finding in ordered), plain(verdict)])


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _names(pairs: Sequence[Mapping[str, str]]) -> str:
    """A combination in words, each label and view cut to a readable length."""
    short = [{_short(view): _short(label) for view, label in labels.items()} for labels in pairs]
    return plain(pairs_text(short))


def _short(name: str) -> str:
    return plain(name if len(name) <= _LONGEST_LABEL else f"{name[: _LONGEST_LABEL - 3]}...")


def model_facts(report: MeshReport, proposal: LandmarkProposal) -> dict[str, Any]:
    """A mesh report and its proposed landmarks as plain values, for machines."""
    facts = {key: value for key, value in asdict(proposal).items() if value is not None}
    plain = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in facts.items()}
    plain["alternatives"] = [[end.tolist() for end in pair] for pair in proposal.alternatives]
    return {"mesh": asdict(report), "landmarks": plain}


def told_model(file: Path, unit: str, report: MeshReport, proposal: LandmarkProposal, picture: Path) -> str:
    """A mesh report and its proposed landmarks, ready to be copied into a case."""
    size = " x ".join(f"{side:.1f}" for side in report.extent_mm)
    closed = "closed" if report.watertight else f"not closed ({report.open_edges} open edges)"
    lines = [
        f"{file} (read as {unit}): {report.faces} triangles, {report.bodies} bodies, {closed}, {size} mm",
        *(paragraph(f"Problem: {problem}") for problem in report.problems),
        f"Landmarks: {proposal.confidence}",
    ]
    if proposal.tip_mm is not None and proposal.center_mm is not None:
        tip, center = ([round(float(x), 3) for x in point] for point in (proposal.tip_mm, proposal.center_mm))
        lines.append(f'  "tip": {tip}, "center": {center}   (mm, CAD frame)')
    lines += [paragraph(f"  {note}", "    ") for note in proposal.notes]
    for tip_mm, center_mm in proposal.alternatives:
        lines.append(f"  or: tip [{_triple(tip_mm, '.2f')}], center [{_triple(center_mm, '.2f')}]")
    lines.append(f"Picture: {picture}")
    return "\n".join(lines)


def _triple(values: Sequence[float] | Any, form: str) -> str:
    return ", ".join(format(float(value), form) for value in values)
