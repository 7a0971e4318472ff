"""What pages fetch: the case folder as a whole, while it is being written; in process."""

import os
import tempfile
import zipfile

import pytest

from screwpose.workbench import endpoints


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Where archives are made."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    return tmp_path / "temporary"


def names_in(archive):
    with zipfile.ZipFile(archive) as packed:
        assert packed.testzip() is None
        return set(packed.namelist())


@pytest.mark.usefixtures("places")
def test_a_packed_case_has_what_is_done_and_nothing_else(workspace):
    folder = workspace / "demo"
    (folder / ".result.12ab.partial").mkdir()
    (folder / ".result.12ab.partial" / "result.json").write_text("{")
    (folder / ".workbench-owner").write_text("{}")
    (folder / "result").mkdir()
    (folder / "result" / "result.json").write_text("{}")
    os.utime(folder / "ap.png", (0, 0))  # 1970
    names = names_in(endpoints._zipped(folder).path)
    assert {"demo/case.json", "demo/ap.png", "demo/result/result.json"} <= names
    assert not {name for name in names if "/." in name}


@pytest.mark.usefixtures("places")
def test_a_file_that_goes_while_it_is_packed_is_left_out(workspace, monkeypatch):
    folder = workspace / "demo"
    listed = [*endpoints._shown_files(folder), folder / "result" / "gone.json"]
    monkeypatch.setattr(endpoints, "_shown_files", lambda _folder: iter(listed))
    assert len(names_in(endpoints._zipped(folder).path)) == len(listed) - 1


def test_nothing_is_left_of_an_archive_that_could_not_be_made(workspace, places, monkeypatch):
    def full(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zipfile.ZipFile, "write", full)
    with pytest.raises(OSError, match="No space"):
        endpoints._zipped(workspace / "demo")
    assert list(places.iterdir()) == []
