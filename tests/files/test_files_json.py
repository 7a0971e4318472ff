"""JSON is read strictly: what Python's own reader lets pass is an error here, with its place."""

import pytest

from screwpose.errors import CaseError
from screwpose.files import read_json


def _file(tmp_path, content: bytes):
    path = tmp_path / "a.json"
    path.write_bytes(content)
    return path


BAD = {
    "empty": (
        b"",
        r"a\.json: not JSON: line 1, column 1: expecting value; expected a JSON file, but this one is empty",
    ),
    "comma before the bracket": (
        b'{\n  "a": 1,\n}',
        r"not JSON: line 3, column 1: .*, in `}`; expected a JSON file\. Take out the comma before the closing",
    ),
    "comma missing": (b'{"a": 1 "b": 2}', r"line 1, column 9: expecting ',' delimiter, .* A comma is missing before"),
    "single quotes": (b"{'a': 1}", r"line 1, column 2: .* JSON text stands in double quotes\."),
    "comment": (b'{\n// note\n"a": 1}', r"line 2, column 1: .* JSON has no comments: take it out\."),
    "two values": (b"{}{}", r"line 1, column 3: extra data"),
    "latin-1": (b'{"a": "\xe9"}', r"not UTF-8: byte 7 is 0xe9\. Save the file as UTF-8\."),
    "utf-16": ('{"a": 1}'.encode("utf-16"), r"the file is UTF-16; expected UTF-8\. Save the file as UTF-8\."),
    "deep": (b"[" * 100_000, r"not a usable JSON file: it is nested too deeply"),
    "deep but complete": (b"[" * 960 + b"]" * 960, r"not a usable JSON file: it is nested too deeply"),
    "long integer": (b"1" * 5000, r"not a usable JSON file: "),
    "NaN": (b'{"a": [1, {"b": NaN}]}', r"a\.json: a\[1\]\.b: NaN is not a finite number; expected a finite number"),
    "Infinity": (b"[-Infinity]", r"a\.json: \[0\]: -Infinity is not a finite number"),
    "overflow": (b'{"a": 1e999}', r"a\.json: a: Infinity is not a finite number"),
    "repeated key": (
        b'{"a": {"b": 1, "c": 2, "b": 1}}',
        r"a\.json: a\.b: the key `b` stands here more than once; expected each key once\. Take out or rename",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_json_is_refused(tmp_path, name):
    content, pattern = BAD[name]
    with pytest.raises(CaseError, match=pattern):
        read_json(_file(tmp_path, content))


def test_places_that_are_no_files_are_refused(tmp_path):
    with pytest.raises(CaseError, match=r"none\.json: there is no such file\. Check the path\."):
        read_json(tmp_path / "none.json")
    with pytest.raises(CaseError, match=r": this is a folder; expected a JSON file\."):
        read_json(tmp_path)


def test_good_json_is_read(tmp_path):
    content = '\ufeff{"name": "Wirbelsäule", "n": [1, -2.5e-3, null, true]}'.encode()
    assert read_json(_file(tmp_path, content)) == {"name": "Wirbelsäule", "n": [1, -0.0025, None, True]}


def test_more_than_one_fault_is_counted(tmp_path):
    with pytest.raises(CaseError, match=r"There are 2 more errors\.$"):
        read_json(_file(tmp_path, b"[NaN, NaN, NaN]"))
