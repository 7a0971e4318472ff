"""A reader never meets half a file or half a folder, whatever happens while it is written."""

import json
import os

import numpy as np
import pytest

from screwpose.errors import OutputError
from screwpose.files import atomic_folder, ensure_can_write_folder, json_text, write_bytes, write_json, write_text
from screwpose.files.schema import SigmaFile


def _all(folder):
    """Everything below a folder, hidden things too."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def _fail(*_args, **_options):
    raise OSError(28, "No space left on device")


def test_a_file_is_written_and_replaced(tmp_path):
    path = tmp_path / "a.txt"
    assert write_text(path, "äöü\n") == path
    assert path.read_bytes() == "äöü\n".encode()
    write_bytes(path, b"new")
    assert path.read_bytes() == b"new"
    assert _all(tmp_path) == ["a.txt"]


def test_a_file_has_the_rights_of_any_other(tmp_path):
    ordinary = tmp_path / "ordinary"
    ordinary.write_text("")
    assert write_text(tmp_path / "ours", "").stat().st_mode == ordinary.stat().st_mode


def test_a_link_is_written_through(tmp_path):
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "real.txt").read_text() == "new"
    assert (tmp_path / "link.txt").is_symlink()


@pytest.mark.parametrize("step", ["fsync", "rename"])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, step):
    path = tmp_path / "a.txt"
    path.write_text("old")
    if step == "fsync":
        monkeypatch.setattr(os, "fsync", _fail)
    else:
        monkeypatch.setattr(type(path), "replace", _fail)
    with pytest.raises(OutputError, match=r"a\.txt: cannot be written: No space left on device\. Free some space, or"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert _all(tmp_path) == ["a.txt"]


def test_a_file_in_a_missing_folder_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r"none/a\.txt: cannot be written: No such file or directory\. Create"):
        write_text(tmp_path / "none" / "a.txt", "")
    with pytest.raises(OutputError, match=r"cannot be written: Is a directory\. Choose another place\."):
        write_text(tmp_path, "")


def test_json_is_readable_by_people_and_machines():
    pose = np.eye(4).tolist()
    data = {"a": pose, "b": [], "c": {"d": "ü" * 200, "e": None}, "f": [{"g": 1}, {"g": 2}]}
    text = json_text(data)
    assert json.loads(text) == data
    assert f'  "a": {json.dumps(pose)},' in text.splitlines()
    assert '  "f": [{"g": 1}, {"g": 2}]' in text.splitlines()


def test_what_was_not_estimated_is_absent(tmp_path):
    write_json(tmp_path / "s.json", SigmaFile(tip_mm=0.5))
    assert json.loads((tmp_path / "s.json").read_text()) == {"tip_mm": 0.5}


def test_numbers_that_are_not_finite_are_not_written(tmp_path):
    with pytest.raises(OutputError, match=r"a\.json: .*JSON has no such number"):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert _all(tmp_path) == []


def test_a_folder_takes_its_place_when_it_is_complete(tmp_path):
    out = tmp_path / "deep" / "out"
    ensure_can_write_folder(out)
    assert _all(tmp_path) == []
    with atomic_folder(out) as folder:
        (folder / "result.json").write_text("1")
        assert not out.exists()
    assert _all(tmp_path) == ["deep", "deep/out", "deep/out/result.json"]


def _earlier(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "result.json").write_text("old")
    (out / "overlay.png").write_text("old")
    return out


def test_an_earlier_output_is_replaced_in_full(tmp_path):
    out = _earlier(tmp_path)
    with atomic_folder(out) as folder:
        (folder / "result.json").write_text("new")
        assert (out / "result.json").read_text() == "old"
    assert (out / "result.json").read_text() == "new"
    assert _all(tmp_path) == ["out", "out/result.json"]


@pytest.mark.parametrize("interruption", [ValueError, KeyboardInterrupt])
def test_an_interruption_leaves_the_earlier_output(tmp_path, interruption):
    out = _earlier(tmp_path)

    def work():
        with atomic_folder(out) as folder:
            (folder / "result.json").write_text("new")
            raise interruption

    with pytest.raises(interruption):
        work()
    assert _all(tmp_path) == ["out", "out/overlay.png", "out/result.json"]
    assert (out / "result.json").read_text() == "old"


def test_a_failing_rename_brings_the_earlier_output_back(tmp_path, monkeypatch):
    out = _earlier(tmp_path)
    rename = type(out).rename

    def fail_for_the_new(path, target):
        if path.name.endswith(".partial"):
            _fail()
        return rename(path, target)

    monkeypatch.setattr(type(out), "rename", fail_for_the_new)
    with (
        pytest.raises(OutputError, match=r"out: cannot be written: No space left"),
        atomic_folder(out) as folder,
    ):
        (folder / "result.json").write_text("new")
    assert _all(tmp_path) == ["out", "out/overlay.png", "out/result.json"]
    assert (out / "result.json").read_text() == "old"


def test_a_full_disk_during_the_work_is_an_output_error(tmp_path):
    with (
        pytest.raises(OutputError, match=r"out: cannot be written: No space left on device"),
        atomic_folder(tmp_path / "out"),
    ):
        _fail()
    assert _all(tmp_path) == []


def test_an_unrelated_system_error_is_left_as_it_is(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_folder(tmp_path / "out"):
        (tmp_path / "missing-input").read_text()
    assert _all(tmp_path) == []


def test_an_output_without_its_marker_is_not_kept(tmp_path):
    with (
        pytest.raises(OutputError, match=r"out: the output is not complete, result\.json was not written"),
        atomic_folder(tmp_path / "out") as folder,
    ):
        (folder / "other.txt").write_text("")
    assert _all(tmp_path) == []


def _enter(path):
    with atomic_folder(path) as folder:
        (folder / "result.json").write_text("new")


@pytest.mark.parametrize("call", [ensure_can_write_folder, _enter])
def test_what_is_not_ours_is_left_alone(tmp_path, monkeypatch, call):
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "chapter.tex").write_text("mine")
    with pytest.raises(
        OutputError, match=r"thesis: the folder is not empty and holds no result\.json, .* left alone\."
    ):
        call(thesis)
    with pytest.raises(OutputError, match=r"chapter\.tex: a file stands where the output folder is to be\."):
        call(thesis / "chapter.tex")
    with pytest.raises(OutputError, match=r"tex/out: .*chapter\.tex is a file, not a folder\. Choose another folder\."):
        call(thesis / "chapter.tex" / "out")
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    with pytest.raises(OutputError, match=r"the output would replace the folder you are in\. Choose a folder"):
        call(".")
    assert _all(tmp_path) == ["here", "thesis", "thesis/chapter.tex"]


def test_an_empty_folder_is_taken(tmp_path):
    (tmp_path / "out").mkdir()
    _enter(tmp_path / "out")
    assert _all(tmp_path) == ["out", "out/result.json"]


def test_a_folder_that_cannot_be_written_is_found_before_the_work(tmp_path, monkeypatch):
    def refuse(*_args, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(tmp_path), "mkdir", refuse)
    with pytest.raises(OutputError, match=r"out: cannot be written: Permission denied\. Choose a folder that"):
        ensure_can_write_folder(tmp_path / "out")
