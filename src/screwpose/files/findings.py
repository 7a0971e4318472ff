"""What is wrong, or doubtful, in what was given: findings that can be gathered, listed and raised."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from screwpose.errors import CaseError, InputError

_NUMBERS = re.compile(r"(.*\b(?:projection|tip|center|pivot|world_from_cad))(?:\[\d+\])+")


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong (`error`: it cannot be solved) or doubtful (`warning`: it can).

    Parameters
    ----------
    level : how bad it is.
    problem, file, field, expected, remedy : as in `InputError`.
    kind : the error that it would be raised as.
    """

    level: Literal["error", "warning"]
    problem: str
    file: Path | None = None
    field: str | None = None
    expected: str | None = None
    remedy: str | None = None
    kind: type[InputError] = CaseError

    @classmethod
    def of_error(cls, error: InputError, file: Path | None = None, field: str | None = None) -> "Finding":
        """The finding that an error stands for; `file` and `field` are used where the error names none."""
        return cls(
            "error",
            error.problem,
            error.file or file,
            error.field if error.field is not None else field,
            error.expected,
            error.remedy,
            type(error),
        )

    def as_error(self) -> InputError:
        """The error to raise for it."""
        return self.kind(self.problem, file=self.file, field=self.field, expected=self.expected, remedy=self.remedy)

    def as_dict(self) -> dict[str, Any]:
        """The parts, for machines (``--json``); absent ones are left out."""
        return {"level": self.level, **self.as_error().as_dict()}

    def within_file(self) -> str:
        """The sentence without the file, for where that is plain, as among the warnings of a result."""
        error = self.as_error()
        error.file = None
        return str(error)

    def __str__(self) -> str:
        return str(self.as_error())


def merged(findings: Iterable[Finding]) -> list[Finding]:
    """Several numbers of one matrix or point that are wrong in one way are one mistake: the first stands for all."""
    groups: dict[tuple[str | None, ...], list[Finding]] = {}
    for finding in findings:
        of_numbers = _NUMBERS.fullmatch(finding.field or "")
        alone = None if of_numbers else str(id(finding))
        key = (finding.level, of_numbers[1] if of_numbers else finding.field, finding.expected, finding.remedy, alone)
        groups.setdefault(key, []).append(finding)
    return [
        first
        if not others
        else replace(first, problem=f"{first.problem}, and so for {len(others)} more of its numbers")
        for first, *others in groups.values()
    ]


def errors_in(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings that prevent solving."""
    return tuple(finding for finding in findings if finding.level == "error")


def warnings_in(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings that do not prevent solving."""
    return tuple(finding for finding in findings if finding.level == "warning")


def raise_first(findings: Sequence[Finding], command: str | None = None) -> None:
    """Raise the first error among the findings, saying how many more there are.

    Parameters
    ----------
    command : the command that lists them all, for the message.
    """
    errors = errors_in(findings)
    if not errors:
        return
    error = errors[0].as_error()
    more = len(errors) - 1
    if more:
        text = f"There {'is 1 more error' if more == 1 else f'are {more} more errors'}"
        error.remedy = " ".join(
            part for part in (error.remedy, f"{text}{f': {command} lists them' if command else ''}.") if part
        )
        error.args = (str(error),)
    raise error
