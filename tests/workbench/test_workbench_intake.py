"""Files that a person gives, and the place that each finds in the case; without a browser."""

import asyncio
import json

import numpy as np
import pytest

from screwpose.workbench import draft as drafts
from screwpose.workbench.intake import take_in
from screwpose.workbench.session import Session
from screwpose.workbench.store import CaseStore
from screwpose.workbench.tasks import TASKS
from screwpose.workbench.uploading import Uploaded
from tests.workbench.driving import awaited


class InProcess:
    """As `Sessions`: what a helper does, done here."""

    async def helped(self, task, arguments):
        return TASKS[task](lambda _fraction, _what: None, **arguments)


def given(folder, *files):
    """The session of a case after files were dropped at once, and what was told."""

    async def drop():
        session = Session("demo", CaseStore(folder), folder, asyncio.Semaphore(1))

        async def nothing(_task, **_arguments):
            return None

        session.ask = nothing  # nobody looks at the case
        return session, await take_in(InProcess(), session, [Uploaded(one, one.name) for one in files])

    return awaited(drop())


@pytest.fixture
def calibration(tmp_path):
    """A file of any name with a calibration that is none of the demo's."""

    def named(name):
        matrix = [[1000.0, 0.0, 160.0, 0.0], [0.0, 1000.0, 160.0, 0.0], [0.0, 0.0, 1.0, 900.0]]
        (tmp_path / name).write_text(json.dumps({"projection": matrix}))
        return tmp_path / name, matrix

    return named


@pytest.mark.parametrize(
    ("name", "view"),
    [
        ("capture_lat.json", "LAT"), ("snap_lat", "LAT"), ("AP-2.dcm", "AP"), ("pa.png", "AP"), ("lateral7.tif", "LAT"),
        ("patient_1.png", None), ("plate.json", None), ("flat_field.txt", None), ("ap_lat.json", None), ("", None),
    ],
)  # fmt: skip
def test_a_name_says_its_view_in_a_word_of_its_own(name, view):
    assert drafts.named_view(name) == view


def test_a_calibration_goes_where_its_name_says_and_what_it_replaces_is_told(workspace, calibration):
    file, matrix = calibration("capture_lat.json")
    before = CaseStore(workspace / "demo").draft["views"]
    session, told = given(workspace / "demo", file)
    after = session.store.draft["views"]
    np.testing.assert_array_equal(after["LAT"]["projection"], matrix)
    assert after["AP"] == before["AP"]
    assert [one["level"] for one in told] == ["warning"]
    assert "capture_lat.json: the calibration of LAT was replaced" in told[0]["text"]
    assert given(workspace / "demo", file)[1] == []  # the same once more replaces nothing


def test_a_calibration_whose_name_says_nothing_goes_where_none_is(workspace, calibration):
    file, matrix = calibration("patient_capture.json")
    folder = workspace / "demo"
    case = json.loads((folder / "case.json").read_text())
    del case["views"]["LAT"]["projection"]
    (folder / "case.json").write_text(json.dumps(case))
    session, told = given(folder, file)
    np.testing.assert_array_equal(session.store.draft["views"]["LAT"]["projection"], matrix)
    assert told == []
