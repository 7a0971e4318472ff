"""Files that a person gives, and the place that each finds in the case; without a browser."""

import asyncio
import json

import numpy as np
import pytest

from screwpose.implants import read_mesh
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
        session.look_soon = lambda: None  # nobody looks at the case
        told = await take_in(InProcess(), session, [Uploaded(one, one.name) for one in files])
        session.store.claim.release()
        assert not session.problem
        return session, told

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


def rod(length, scale=1.0):
    """A binary STL of a box, 4 x 4 x `length` mm, in a unit of 1 / `scale` mm."""
    corners = np.array([[x, y, z] for x in (0, 4) for y in (0, 4) for z in (0, length)], dtype=np.float64) * scale
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    records = b"".join(bytes(12) + corners[list(face)].astype("<f4").tobytes() + bytes(2) for face in faces)
    return bytes(80) + len(faces).to_bytes(4, "little") + records


@pytest.fixture
def proposing(monkeypatch):
    """Landmarks that say how long the mesh is, and in which unit it was read."""

    def identify(_tell, path, name, unit):
        long_mm = float(np.ptp(read_mesh(path, unit).vertices_mm[:, 2]))
        return {"kind": "mesh", "tip": [0.0, 0.0, 0.0], "center": [0.0, 0.0, long_mm], "confidence": unit, "notes": []}

    monkeypatch.setitem(TASKS, "identify", identify)


def center_of(session, name):
    return session.store.draft["models"][name]["center"]


@pytest.mark.usefixtures("proposing")
def test_a_new_mesh_has_landmarks_of_its_own_and_the_same_one_keeps_what_a_hand_gave(tmp_path):
    folder = CaseStore.created(tmp_path, "case").folder
    file = tmp_path / "screw.stl"
    file.write_bytes(rod(30.0))
    session, _ = given(folder, file)
    assert center_of(session, "screw") == [0.0, 0.0, 30.0]
    assert session.notes_of_models == {"screw": ["Landmarks proposed: mm."]}
    by_hand = {**session.store.draft["models"]["screw"], "center": [1.0, 2.0, 3.0]}
    session.store.change(drafts.with_model(session.store.draft, "screw", by_hand))
    session.store.claim.release()
    session, _ = given(folder, file)
    assert center_of(session, "screw") == [1.0, 2.0, 3.0]
    assert session.notes_of_models == {}
    file.write_bytes(rod(45.0))
    session, _ = given(folder, file)
    assert center_of(session, "screw") == [0.0, 0.0, 45.0]
    assert session.notes_of_models == {"screw": ["Landmarks proposed: mm."]}
    assert list(session.store.draft["models"]) == ["screw"]


@pytest.mark.usefixtures("proposing")
def test_a_mesh_is_read_in_the_unit_that_is_known_of_its_model(tmp_path):
    store = CaseStore.created(tmp_path, "case")
    store.change(drafts.with_model(store.draft, "screw", {"unit": "cm"}))
    store.claim.release()
    (tmp_path / "screw.stl").write_bytes(rod(30.0, scale=0.1))
    session, _ = given(store.folder, tmp_path / "screw.stl")
    np.testing.assert_allclose(center_of(session, "screw"), [0.0, 0.0, 30.0], rtol=1e-6)
    assert session.store.draft["models"]["screw"]["unit"] == "cm"


@pytest.mark.usefixtures("proposing")
def test_two_meshes_of_one_name_in_a_drop_are_two_models(tmp_path):
    folder = CaseStore.created(tmp_path, "case").folder
    files = []
    for place, long in (("a", 30.0), ("b", 45.0)):
        (tmp_path / place).mkdir()
        files.append(tmp_path / place / "screw.stl")
        files[-1].write_bytes(rod(long))
    for dropped in (files, [*files, files[0]]):  # once more they are the same two
        session, told = given(folder, *dropped)
        assert told == []
        assert {name: one["center"][2] for name, one in session.store.draft["models"].items()} == {
            "screw": 30.0,
            "screw-2": 45.0,
        }
