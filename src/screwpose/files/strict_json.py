"""Reading JSON that must be exactly what its format says, and saying in plain words where it is not.

Python's own reader takes NaN, Infinity and a key that is given twice without a word; here each is an error.
"""

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from screwpose.errors import CaseError
from screwpose.files.findings import Finding, raise_first


class _Object(dict[str, Any]):
    """A JSON object that remembers which of its keys stood there more than once."""

    repeated: tuple[str, ...] = ()


class Parsed(NamedTuple):
    """What a file holds, and what is wrong with it as JSON."""

    data: Any
    findings: tuple[Finding, ...]


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    Raises
    ------
    CaseError
        The file is missing, a folder, unreadable, not UTF-8, not JSON (with line and column), or holds NaN, Infinity or
        a key twice (with the place in the file).
    """
    parsed = parse_json(path)
    raise_first(parsed.findings)
    return parsed.data


def parse_json(path: str | Path) -> Parsed:
    """Read a JSON file as far as it can be read, and list what is wrong inside it; raises as `read_json` where nothing
    can be read at all.
    """
    path = Path(path)
    text = _read_text(path)
    try:
        data = json.loads(text, object_pairs_hook=_object)
        return Parsed(data, tuple(_flaws(data, path, ())))
    except json.JSONDecodeError as error:
        line = text.splitlines()[error.lineno - 1].strip() if text.strip() else ""
        raise CaseError(
            f"not JSON: line {error.lineno}, column {error.colno}: {error.msg[0].lower()}{error.msg[1:]}"
            + (f", in `{line[:80]}`" if line else ""),
            file=path,
            expected="a JSON file" if text.strip() else "a JSON file, but this one is empty",
            remedy=_json_remedy(error, text),
        ) from error
    except RecursionError as error:
        raise CaseError("not a usable JSON file: it is nested too deeply", file=path) from error
    except ValueError as error:  # an integer of more than 4300 digits
        raise CaseError(f"not a usable JSON file: {error}", file=path) from error


def _read_text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise CaseError("there is no such file", file=path, remedy="Check the path.") from error
    except IsADirectoryError as error:
        raise CaseError("this is a folder", file=path, expected="a JSON file") from error
    except OSError as error:
        raise CaseError(f"the file cannot be read ({error.strerror})", file=path) from error
    try:
        if data.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise CaseError("the file is UTF-16", file=path, expected="UTF-8", remedy="Save the file as UTF-8.")
        # Some editors put a byte order mark in front; it says nothing that UTF-8 needs.
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CaseError(
            f"not UTF-8: byte {error.start} is 0x{data[error.start]:02x}", file=path, remedy="Save the file as UTF-8."
        ) from error


def _object(pairs: list[tuple[str, Any]]) -> _Object:
    found = _Object(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        found.repeated = tuple(dict.fromkeys(key for key in keys if keys.count(key) > 1))
    return found


def _json_remedy(error: json.JSONDecodeError, text: str) -> str | None:
    before = text[: error.pos].rstrip()
    after = text[error.pos : error.pos + 1]
    if after == "'":
        return "JSON text stands in double quotes."
    if (after in ("}", "]") and before.endswith(",")) or error.msg.startswith("Illegal trailing comma"):
        return "Take out the comma before the closing bracket."
    if after in ("/", "#"):
        return "JSON has no comments: take it out."
    if error.msg.startswith("Expecting ',' delimiter"):
        return "A comma is missing before this place."
    return None


def _flaws(data: Any, path: Path, location: tuple[str | int, ...]) -> Iterator[Finding]:
    """Repeated keys and numbers that are not finite, wherever they stand."""
    if isinstance(data, float) and not math.isfinite(data):
        yield Finding(
            "error",
            f"{_number_text(data)} is not a finite number",
            path,
            field_path(location),
            "a finite number",
            "Mark the point again, or take the screw out of this view."
            if location[:1] == ("annotations",)
            else "Leave the key out where nothing is known.",
        )
    elif isinstance(data, list):
        for index, item in enumerate(data):
            yield from _flaws(item, path, (*location, index))
    elif isinstance(data, dict):
        for key in getattr(data, "repeated", ()):
            yield Finding(
                "error",
                f"the key `{key}` stands here more than once",
                path,
                field_path((*location, key)),
                "each key once",
                "Take out or rename all but one.",
            )
        for key, item in data.items():
            yield from _flaws(item, path, (*location, key))


def _number_text(number: float) -> str:
    return "NaN" if math.isnan(number) else "Infinity" if number > 0 else "-Infinity"


def field_path(location: Sequence[str | int]) -> str | None:
    """Where in a file: ``views.AP.projection``, ``annotations.AP[0].tip``; None for the whole file."""
    text = ""
    for key in location:
        if isinstance(key, int):
            text += f"[{key}]"
        else:
            text += f".{key}" if text else key
    return text or None
