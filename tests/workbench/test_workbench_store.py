"""Drafts, the case folder, names, and what `screwpose open` is given."""

import json

import numpy as np
import pytest

from screwpose.errors import CaseError, OutputError, ScrewposeError
from screwpose.files.case import read_case
from screwpose.workbench import draft as drafts
from screwpose.workbench.sessions import Sessions
from screwpose.workbench.side_file import Begun, BegunMark, Choice
from screwpose.workbench.store import CaseStore, safe_file_name
from screwpose.workbench.workspace import Workspace, workspace_of
from tests.workbench.driving import awaited, side_of


def test_a_case_made_step_by_step_is_what_solving_reads(simulated, tmp_path):
    given = json.loads((simulated / "case.json").read_text())
    store = CaseStore.created(tmp_path, "my case")
    for name in ("ap.png", "lat.png"):
        (store.folder / name).write_bytes((simulated / name).read_bytes())
    mesh = next((simulated / "models").glob("*.stl"))
    (store.folder / mesh.name).write_bytes(mesh.read_bytes())
    now = drafts.with_image(store.draft, "LAT", "lat.png")
    now = drafts.with_image(now, "AP", "ap.png")
    assert list(now["views"]) == ["AP", "LAT"]
    for view in ("AP", "LAT"):
        now = drafts.with_projection(now, view, np.array(given["views"][view]["projection"]))
    (model,) = given["models"].values()
    now = drafts.with_model(now, mesh.stem, {**model, "mesh": mesh.name})
    for view in ("AP", "LAT"):
        for one in given["annotations"][view]:
            now = drafts.with_mark(now, view, drafts.next_label(now, view), one["tip"], one["center"])
    store.change(now)
    case, want = read_case(store.folder), read_case(simulated)
    for view in ("AP", "LAT"):
        np.testing.assert_array_equal(case.views[view].camera.projection, want.views[view].camera.projection)
        for mark, own in zip(case.annotations[view], want.annotations[view], strict=True):
            np.testing.assert_allclose(mark.tip_px, own.tip_px, atol=0.005)
            assert mark.model == mesh.stem
    assert [one.label for one in case.annotations["LAT"]] == ["a", "b"]


def test_changing_never_touches_the_draft_before():
    before = drafts.with_mark(drafts.with_image(drafts.empty_draft("x"), "AP", "a.png"), "AP", "1", (1, 2), (3, 4))
    text = json.dumps(before)
    after = drafts.with_landmark(before, "AP", "1", "tip", (9.876, 5.0))
    assert after["annotations"]["AP"][0]["tip"] == [9.88, 5.0]
    for other in (
        drafts.with_label(before, "AP", "1", "x"), drafts.with_mark_model(before, "AP", "1", "m"),
        drafts.without_mark(before, "AP", "1"), drafts.without_view(before, "AP"),
        drafts.with_view_key(before, "AP", "mask", "m.png"),
    ):  # fmt: skip
        assert other != before
    assert json.dumps(before) == text


def test_a_new_image_takes_the_old_ones_mask_with_it():
    masked = drafts.with_view_key(drafts.with_image(drafts.empty_draft("x"), "AP", "a.png"), "AP", "mask", "m.png")
    assert drafts.with_image(masked, "AP", "b.png")["views"]["AP"] == {"image": "b.png"}


@pytest.mark.parametrize(
    ("name", "view"), [("patient_LAT_2.dcm", "LAT"), ("AP.png", "AP"), ("img0001", "AP"), ("lateral.tif", "LAT")]
)
def test_an_images_name_says_which_view_it_is(name, view):
    assert drafts.free_view(drafts.empty_draft("x"), name) == view


def test_undo_and_redo_write_what_they_show(workspace):
    store = CaseStore(workspace / "demo")
    first = store.draft
    assert not store.undo()
    store.change(drafts.without_mark(first, "AP", "1"))
    second = store.draft
    store.change(drafts.without_mark(second, "AP", "2"))
    assert store.undo()
    assert store.undo()
    assert json.loads(store.file.read_text()) == first == store.draft
    assert store.redo()
    assert json.loads(store.file.read_text()) == second
    store.change(drafts.without_mark(second, "LAT", "a"))
    assert not store.can_redo


def reopened(store):
    """The case as the next run of the workbench opens it."""
    store.claim.release()
    return CaseStore(store.folder)


def test_undo_and_redo_outlast_the_workbench(workspace):
    store = CaseStore(workspace / "demo")
    first = store.draft
    second = drafts.without_mark(first, "AP", "1")
    third = drafts.without_mark(second, "AP", "2")
    store.change(second)
    store.change(third)
    store.undo()
    again = reopened(store)
    assert again.redo()
    assert json.loads(again.file.read_text()) == third
    assert not again.can_redo
    again = reopened(again)
    assert again.undo()
    assert again.undo()
    assert json.loads(again.file.read_text()) == first
    assert not again.can_undo


@pytest.mark.parametrize("is_written", [False, True])
def test_an_end_between_the_two_files_leaves_a_history_that_fits(workspace, monkeypatch, is_written):
    store = CaseStore(workspace / "demo")
    first, second = store.draft, drafts.without_mark(store.draft, "AP", "1")
    store.change(second)

    def cut(file, text):
        if is_written:
            file.write_text(text)
        raise KeyboardInterrupt

    monkeypatch.setattr("screwpose.workbench.store.write_text", cut)
    with pytest.raises(KeyboardInterrupt):
        store.undo()
    again = CaseStore(workspace / "demo")
    assert (again.can_undo, again.can_redo) == (not is_written, is_written)
    assert again.draft == (first if is_written else second)


def test_a_history_has_an_end_and_is_not_of_another_programs_case(workspace):
    store = CaseStore(workspace / "demo")
    for number in range(80):
        store.change(drafts.with_landmark(store.draft, "AP", "1", "tip", (number, 1.0)))
    assert len(side_of(store.folder)["history"]) == 60
    again = reopened(store)
    assert sum(again.undo() for _ in range(80)) == 59
    assert again.draft["annotations"]["AP"][0]["tip"] == [20.0, 1.0]
    store.file.write_text(json.dumps({**again.draft, "id": "other"}))
    assert not CaseStore(workspace / "demo").can_undo
    assert not CaseStore(workspace / "demo").can_redo


def test_a_failed_write_changes_nothing(workspace, monkeypatch):
    store = CaseStore(workspace / "demo")
    first = store.draft

    def full(_file, _text):
        raise OutputError("no space")

    with monkeypatch.context() as patch:
        patch.setattr("screwpose.workbench.store.write_text", full)
        with pytest.raises(OutputError, match="no space"):
            store.change(drafts.without_mark(first, "AP", "1"))
    assert (store.draft, store.can_undo) == (first, False)
    store.change(drafts.without_mark(first, "AP", "2"))
    assert store.undo()
    assert CaseStore(workspace / "demo").draft == first


def test_what_another_program_wrote_is_left_alone(workspace):
    store = CaseStore(workspace / "demo")
    store.file.write_text(store.file.read_text().replace('"id"', '"id" '))
    theirs = store.file.read_bytes()
    with pytest.raises(OutputError, match="another program changed the case"):
        store.change(drafts.without_mark(store.draft, "AP", "1"))
    assert store.file.read_bytes() == theirs
    assert not store.can_undo


def test_the_side_file_comes_back_as_it_was(workspace):
    store = CaseStore(workspace / "demo")
    pairs = ({"AP": "1", "LAT": "b"},)
    choice = Choice(pairs=pairs, solver_pairs=({"AP": "1", "LAT": "a"},), reason="the needle", when="2026-11-28")
    begun = {"AP": BegunMark(label="3", tip=(1.5, 2.25))}
    store.change_side(begun=begun, choice=choice, stage="mark", job=Begun(pairs=pairs))
    again = CaseStore(workspace / "demo")
    assert again.side == store.side
    assert again.side.choice == choice
    assert again.digest == store.digest


@pytest.mark.parametrize(
    ("given", "safe"),
    [
        ("ap.png", "ap.png"),
        ("../../etc/passwd", "passwd"),
        ("..\\..\\boot.ini", "boot.ini"),
        ("/abs/olute.stl", "olute.stl"),
        (".hidden", "hidden"),
        ("a b<c>.png", "a-b-c-.png"),
        ("....", "file"),
        ("", "file"),
        ("CON.png", "file-CON.png"),
        ("x" * 300 + ".png", "x" * 56 + ".png"),
        ("\x00\n.png", "png"),
    ],
)
def test_names_are_made_safe(given, safe):
    assert safe_file_name(given) == safe


def test_new_cases_get_names_of_their_own(tmp_path):
    folders = [CaseStore.created(tmp_path / "new", "../case").folder.name for _ in range(3)]
    assert folders == ["case", "case-2", "case-3"]


def test_what_open_is_given(workspace, tmp_path):
    assert workspace_of(workspace / "demo").first == "demo"
    assert workspace_of(workspace / "demo" / "case.json").folder == workspace
    listed = workspace_of(workspace)
    assert (listed.first, [one.key for one in listed.cases()]) == (None, ["demo"])
    assert workspace_of(tmp_path / "not there yet").cases() == []
    with pytest.raises(CaseError, match="opens a folder"):
        workspace_of(workspace / "demo" / "truth.json")
    for key in ("..", "../cases", "nothing", "", "demo/../demo"):
        with pytest.raises(CaseError, match="no case of the name"):
            listed.folder_of(key)


@pytest.mark.parametrize("text", ["[]", "{", "", '{"views": 3, "annotations": {"AP": [{"label": 1}, 7]}}'])
def test_a_broken_case_file_opens_empty_or_says_why(tmp_path, text):
    (tmp_path / "case.json").write_text(text)
    if "views" in text:
        draft = CaseStore(tmp_path).draft
        assert (draft["views"], draft["annotations"]) == ({}, {"AP": []})
    else:
        with pytest.raises(CaseError):
            CaseStore(tmp_path)


def test_a_case_that_is_broken_for_a_moment_keeps_its_session(workspace):
    file = workspace / "demo" / "case.json"
    whole = file.read_text()

    async def ask():
        sessions = Sessions(Workspace(workspace))
        before = sessions.get("demo")
        before.look_soon = lambda: None
        file.write_text(whole[:40])
        with pytest.raises(CaseError):
            sessions.get("demo")
        (workspace / "demo" / "workbench.json").write_text("{")
        file.write_text(whole.replace('"id"', '"id" '))
        with pytest.raises(ScrewposeError):
            sessions.get("demo")
        assert before.store.is_changed_elsewhere
        (workspace / "demo" / "workbench.json").unlink()
        again = sessions.get("demo")
        await sessions.close()
        return before, again

    before, again = awaited(ask())
    assert again is before
    assert not again.store.is_changed_elsewhere
