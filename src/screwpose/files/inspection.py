"""Gathering everything that is wrong in a case, instead of stopping at the first."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from screwpose.errors import CaseError, InputError
from screwpose.files.findings import Finding
from screwpose.files.paths import path_inside
from screwpose.files.schema_case import AnnotationFile

MarkedScrews = dict[str, list[tuple[int, AnnotationFile]]]
"""For each view the annotations that can be read, with their places in its list."""
Value = TypeVar("Value")


@dataclass(eq=False)
class Inspection:
    """The findings of one case file, as they come in."""

    case_file: Path
    findings: list[Finding] = field(default_factory=list)

    def error(
        self,
        where: str,
        problem: str,
        *,
        expected: str | None = None,
        remedy: str | None = None,
        kind: type[InputError] = CaseError,
    ) -> None:
        """Note something that prevents solving; `where` is its field in the case file."""
        self.findings.append(Finding("error", problem, self.case_file, where, expected, remedy, kind))

    def warn(
        self,
        where: str,
        problem: str,
        *,
        expected: str | None = None,
        remedy: str | None = None,
        kind: type[InputError] = CaseError,
    ) -> None:
        """Note something doubtful that does not prevent solving."""
        self.findings.append(Finding("warning", problem, self.case_file, where, expected, remedy, kind))

    def attempt(self, call: Callable[[], Value], where: str, parent: str | None = None) -> Value | None:
        """What `call` returns; None, with its `InputError` noted, where it cannot.

        Parameters
        ----------
        where : the field to name where the error names none.
        parent : the field below which the error's own field lies.
        """
        try:
            return call()
        except InputError as error:
            own = error.field
            if own is None or error.file == self.case_file:
                finding = Finding.of_error(error, self.case_file, where)
            else:
                finding = replace(Finding.of_error(error, self.case_file), field=f"{parent or where}.{own}")
            self.findings.append(finding)
            return None

    def file(self, name: str | None, where: str, kind: type[InputError]) -> Path | None:
        """The path of a file that the case names; None, with an error noted, where it cannot be used."""
        if name is None:
            return None
        return self.attempt(
            lambda: path_inside(self.case_file.parent, name, case=self.case_file, field=where, kind=kind), where
        )


def valid_keys(data: Any, model: type[BaseModel]) -> dict[str, Any]:
    """Of an object in a file, the keys that hold by themselves, checked; so that one wrong key hides no other fault.

    Keys that may be left out are there with their defaults. What is wrong is not reported here.
    """
    if not isinstance(data, Mapping):
        return {}
    found: dict[str, Any] = {}
    for key, adapter in _adapters(model).items():
        if key in data:
            with contextlib.suppress(ValidationError):
                found[key] = adapter.validate_python(data[key])
        elif not model.model_fields[key].is_required():
            found[key] = model.model_fields[key].default
    return found


def objects_in(data: Any, model: type[BaseModel]) -> dict[str, dict[str, Any]]:
    """The valid keys of each of the named objects in a part of a file."""
    if not isinstance(data, Mapping):
        return {}
    return {name: valid_keys(entry, model) for name, entry in data.items()}


def screws_in(data: Any) -> MarkedScrews:
    """The annotations of a case that hold by themselves."""
    found: MarkedScrews = {}
    for view, entries in data.items() if isinstance(data, Mapping) else ():
        found[view] = []
        for index, entry in enumerate(entries if isinstance(entries, list) else ()):
            with contextlib.suppress(ValidationError):
                found[view].append((index, AnnotationFile.model_validate(entry)))
    return found


@cache
def _adapters(model: type[BaseModel]) -> dict[str, TypeAdapter[Any]]:
    adapters = {}
    for key, entry in model.model_fields.items():
        kind: Any = Annotated[entry.annotation, entry]  # the entry carries the checks that stood beside the type
        adapters[key] = TypeAdapter(kind)
    return adapters
