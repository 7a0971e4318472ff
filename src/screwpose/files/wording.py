"""What pydantic found, said in our words: the field, the value, what was expected, and what to do."""

import difflib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from screwpose.files.findings import Finding, raise_first
from screwpose.files.schema_case import REMEDIES, CameraSigmaFile
from screwpose.files.strict_json import field_path, parse_json

Model = TypeVar("Model", bound=BaseModel)
Location = tuple[str | int, ...]

_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text in quotes",
    "model_type": "an object, { }",
    "dict_type": "an object, { }",
    "tuple_type": "a list, [ ]",
    "string_too_short": "text that is not empty",
}
# Models that stand beside a word: pydantic puts their names into the location of an error.
_BRANCHES = {CameraSigmaFile.__name__}


def read_model(path: str | Path, model: type[Model], file_format: str) -> Model:
    """Read and check a file of one of our formats.

    Raises
    ------
    CaseError
        The first thing that is wrong; the message ends with how many more there are.
    """
    path = Path(path)
    parsed = parse_json(path)
    wrong_format = format_finding(parsed.data, file_format, path)
    if wrong_format:
        raise wrong_format.as_error()
    findings = list(parsed.findings)
    checked = validated(parsed.data, model, path, findings)
    raise_first(findings)
    assert checked is not None  # what is not valid has left a finding
    return checked


def validated(data: Any, model: type[Model], path: Path, findings: list[Finding], at: Location = ()) -> Model | None:
    """Check data against a model; None where it does not hold, with what is wrong added to `findings`."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        findings += findings_of(error, model, path, at)
        return None


def format_finding(data: Any, file_format: str, path: Path) -> Finding | None:
    """Whether a file is of the format that is to be read; else nothing more is worth saying about it."""
    expected = f'"format": "{file_format}"'
    if not isinstance(data, dict):
        return Finding("error", f"the file holds {shown(data)}", path, None, f"an object, {{ }}, with {expected}")
    if "format" not in data:
        return Finding(
            "error", "the key is missing", path, "format", f'"{file_format}"', f"Add {expected} if the file is one."
        )
    found = data["format"]
    if found == file_format:
        return None
    remedy = None
    if isinstance(found, str) and found.split("/")[0] == file_format.split("/")[0]:
        remedy = "This version of the format is not known here: the file may need a newer screwpose."
    elif isinstance(found, str) and found.startswith("screwpose-"):
        remedy = f"This is a {found.split('/')[0].removeprefix('screwpose-')} file: give the other one."
    return Finding("error", shown(found), path, "format", f'"{file_format}"', remedy)


def findings_of(error: ValidationError, model: type[BaseModel], path: Path, at: Location = ()) -> list[Finding]:
    """Every problem that pydantic found, one finding each.

    Numbers that are not finite are left out (`parse_json` has them), and so is a missing key where an unknown key
    beside it is plainly that key misspelt: one mistake, one message.
    """
    details = _of_the_branch_meant(error.errors(include_url=False))
    misspelt = {
        (*detail["loc"][:-1], near)
        for detail in details
        if detail["type"] == "extra_forbidden"
        and (near := nearest(str(detail["loc"][-1]), _keys(model, detail["loc"])))
    }
    found = []
    for detail in details:
        if detail["type"] == "finite_number" or (detail["type"] == "missing" and detail["loc"] in misspelt):
            continue
        problem, expected, remedy = _words(detail, model)
        location = tuple(key for key in detail["loc"] if key != "[key]")
        found.append(Finding("error", problem, path, field_path((*at, *location)), expected, remedy))
    return found


def _of_the_branch_meant(details: list[ErrorDetails]) -> list[ErrorDetails]:
    """Where a key may be an object or a word, what is wrong with the one that was written; pydantic tells of both, and
    names each in the location."""
    meant: list[ErrorDetails] = []
    for detail in details:
        is_word = [isinstance(key, str) and key.startswith("literal[") for key in detail["loc"]]
        if any(is_word) and isinstance(detail["input"], dict):
            continue
        location = tuple(
            key for key, word in zip(detail["loc"], is_word, strict=True) if not word and key not in _BRANCHES
        )
        if detail["type"] == "model_type" and detail["loc"][-1] in _BRANCHES:
            continue
        meant.append({**detail, "loc": location})
    return meant


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most like the given one, if any is."""
    by_lower = {key.lower(): key for key in known}
    close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.55)
    return by_lower[close[0]] if close else None


def shown(value: Any) -> str:
    """A value as it stands in the file, cut to a readable length."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else text[:57] + "..."


def quoted(names: Iterable[str]) -> str:
    """Names for a message: `a`, `b`."""
    return ", ".join(f"`{name}`" for name in names)


def _words(detail: ErrorDetails, model: type[BaseModel]) -> tuple[str, str | None, str | None]:
    """Problem, expectation and remedy of one of pydantic's errors."""
    kind, value, context = detail["type"], detail["input"], detail.get("ctx", {})
    holder, entry = _look_up(model, detail["loc"])
    key = str(detail["loc"][-1]) if detail["loc"] else ""
    remedy = REMEDIES.get((holder.__name__, key)) if holder else None
    if kind == "screwpose":
        return context["problem"], context["expected"], context["remedy"] or None
    if kind == "missing":
        return "the key is missing", entry.description if entry else None, remedy
    if kind == "extra_forbidden":
        return _unknown_key(key, _keys(model, detail["loc"]))
    if kind == "literal_error":
        return shown(value), str(context["expected"]), None
    if kind == "too_short":
        return f"has {context['actual_length']}", f"{context['min_length']} or more", remedy
    if kind == "greater_than_equal":
        return shown(value), f"{context['ge']:g} or more", None
    if kind in _KINDS:
        if kind == "float_type" and isinstance(value, str):
            return f"{shown(value)} is text", "a number", "Take the quotes away."
        return shown(value), _KINDS[kind], "Put it in quotes." if _wants_quotes(kind, value) else None
    return f"{shown(value)}: {detail['msg']}", None, None


def _wants_quotes(kind: str, value: Any) -> bool:
    return kind == "string_type" and isinstance(value, int | float) and not isinstance(value, bool)


def _unknown_key(key: str, known: tuple[str, ...]) -> tuple[str, str, str]:
    near = nearest(key, known)
    expected = f"one of {quoted(known)}"
    if near:
        return f"unknown key `{key}`; the nearest known one is `{near}`", expected, f"Rename it to `{near}`."
    return f"unknown key `{key}`", expected, "Take it out."


def _keys(model: type[BaseModel], location: Location) -> tuple[str, ...]:
    """The keys that the format knows in the object which holds the last key of `location`."""
    holder, _ = _look_up(model, location)
    return tuple(holder.model_fields) if holder else ()


def _look_up(model: type[BaseModel], location: Location) -> tuple[type[BaseModel] | None, FieldInfo | None]:
    """The model that holds the last key of `location`, if one does, and the key's entry in it."""
    kind: Any = model
    holder: type[BaseModel] | None = None
    entry: FieldInfo | None = None
    for key in location:
        kind = _bare(kind)
        holder, entry = None, None
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            holder, entry = kind, kind.model_fields.get(str(key))
            kind = entry.annotation if entry else None
        elif issubclass(get_origin(kind) or object, Mapping):
            kind = get_args(kind)[1]
        else:
            kind = next(iter(get_args(kind)), None)
    return holder, entry


def _bare(kind: Any) -> Any:
    """A type without Annotated and without None."""
    while True:
        if get_origin(kind) is Annotated:
            kind = get_args(kind)[0]
        elif get_origin(kind) in (Union, UnionType):
            kind = next(argument for argument in get_args(kind) if argument is not NoneType)
        else:
            return kind
