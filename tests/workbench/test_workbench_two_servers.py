"""Two servers on one case folder: the second is told, can take over, and nothing is overwritten."""

import json
import os
import stat
import subprocess
import sys

import pytest

from screwpose.errors import OutputError
from screwpose.workbench import draft as drafts
from screwpose.workbench.claim import OWNER_NAME, Claim
from screwpose.workbench.sessions import Sessions
from screwpose.workbench.store import CaseStore
from screwpose.workbench.workspace import Workspace
from tests.workbench.driving import awaited, case_in, side_of


def test_a_folder_is_one_servers_until_it_is_taken_or_left(tmp_path):
    first, second = Claim(tmp_path), Claim(tmp_path)
    first.renew()
    second.renew()
    assert first.other is None
    assert second.other.pid == os.getpid()
    with pytest.raises(OutputError, match="open in another workbench"), second.held():
        pass
    second.renew(takes=True)
    with pytest.raises(OutputError, match="open in another workbench"), first.held():
        pass
    with second.held():
        pass
    first.release()  # not its own any more
    first.renew()
    assert first.other is not None
    second.release()
    first.renew()
    assert first.other is None


def gone_process():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.mark.parametrize("case", ["ended", "silent", "cut off"])
def test_a_server_that_is_no_more_holds_nothing(tmp_path, case):
    other, own = Claim(tmp_path), Claim(tmp_path)
    other.renew()
    file = tmp_path / OWNER_NAME
    owner = json.loads(file.read_text())
    own.renew()
    assert own.other is not None
    if case == "ended":
        file.write_text(json.dumps({**owner, "pid": gone_process()}))
    elif case == "silent":
        file.write_text(json.dumps({**owner, "host": "elsewhere"}))
        own.renew()
        assert own.other is not None  # of another computer nothing is known but when it spoke last
        then = file.stat().st_mtime - 60.0
        os.utime(file, (then, then))
    else:
        file.write_text(json.dumps(owner)[:20])
    own.renew()
    assert own.other is None


def test_nobody_else_comes_between_asking_and_writing(tmp_path):
    mine = Claim(tmp_path)
    script = (
        "import sys; from pathlib import Path; from screwpose.workbench.claim import Claim; "
        "print('begun', flush=True); Claim(Path(sys.argv[1])).renew(takes=True); print('taken', flush=True)"
    )
    with mine.held():
        other = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, text=True)
        assert other.stdout.readline() == "begun\n"
        with pytest.raises(subprocess.TimeoutExpired):
            other.wait(1.0)
    assert other.communicate(timeout=60)[0] == "taken\n"
    mine.renew()
    assert mine.other is None  # that one ended, so it is free again


def test_a_store_whose_folder_was_taken_writes_nothing(workspace):
    store, other = CaseStore(workspace / "demo"), CaseStore(workspace / "demo")
    store.change_side(stage="mark")
    other.claim.renew(takes=True)
    files = [store.file.read_bytes(), (store.folder / "workbench.json").read_bytes()]
    for act in (lambda: store.change(drafts.empty_draft("x")), lambda: store.change_side(stage="space")):
        with pytest.raises(OutputError, match="another workbench"):
            act()
    assert [store.file.read_bytes(), (store.folder / "workbench.json").read_bytes()] == files
    assert store.side.stage == "mark"


def test_a_second_server_is_told_follows_and_can_take_over(workspace, serve, open_tab):
    folder = workspace / "demo"
    ours = "window.screwposeViewers?.AP?.state.editable === {}"
    first = open_tab(serve(folder).address)
    first.go("Mark")
    first.see_xrays()
    first.page.wait_for_function(ours.format("true"))
    server = serve(workspace)
    second = open_tab(f"{server.base}/case/demo")
    second.text("open in another workbench").wait_for()
    second.see_xrays()  # at the same stage
    assert second.page.evaluate(ours.format("false"))
    point = [case_in(folder)["annotations"]["AP"][0]["tip"][0], 20.0]
    second.click_point("AP", point)
    first.click_point("AP", point)
    first.text("now click the centre").wait_for()
    second.text("now click the centre").wait_for()  # who only looks follows
    assert side_of(folder)["begun"]["AP"]["tip"][1] < 30.0
    second.button("Take over").click()
    second.page.wait_for_function(ours.format("true"))
    first.text("open in another workbench").wait_for()
    first.page.wait_for_function(ours.format("false"))
    second.click_point("AP", [point[0], 60.0])
    second.text("AP: 3 screws").wait_for()
    first.text("AP: 3 screws").wait_for()
    assert len(case_in(folder)["annotations"]["AP"]) == 3
    # It ends as Ctrl-C ends it: the other one may go on, with what was done there.
    server.stop()
    first.page.wait_for_function(ours.format("true"))
    first.page.keyboard.press("Control+z")
    first.text("AP: 2 screws").wait_for()
    assert len(case_in(folder)["annotations"]["AP"]) == 2


@pytest.mark.skipif(sys.platform == "win32", reason="rights of another kind")
@pytest.mark.parametrize("rights", [0o700, 0o2775, 0o777])
def test_whoever_may_write_a_shared_folder_may_claim_it(tmp_path, rights):
    own = Claim(tmp_path)
    own.renew()
    tmp_path.chmod(rights)
    own.renew()  # as one of an earlier version left it
    assert stat.S_IMODE((tmp_path / OWNER_NAME).stat().st_mode) == rights & 0o666
    assert (tmp_path / OWNER_NAME).stat().st_gid == tmp_path.stat().st_gid


def test_a_claim_that_cannot_be_left_keeps_no_server_from_ending(workspace, monkeypatch):
    def refused(*_arguments):
        raise PermissionError(13, "Permission denied")

    async def end():
        sessions = Sessions(Workspace(workspace))
        session = sessions.get("demo")
        session.store.claim.renew()
        (sessions.cache / "pixels.u16").write_bytes(b"a patient's")
        monkeypatch.setattr("screwpose.workbench.claim._locked", refused)
        await sessions.close()
        return sessions, session

    sessions, session = awaited(end())
    assert not sessions.cache.exists()
    assert session.reader.is_ended


def test_nothing_keeps_the_cache_when_a_server_ends(workspace, monkeypatch):
    async def end():
        sessions = Sessions(Workspace(workspace))
        session = sessions.get("demo")
        monkeypatch.setattr(session.store.claim, "release", lambda: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            await sessions.close()
        return sessions, session

    sessions, session = awaited(end())
    assert not sessions.cache.exists()
    assert session.reader.is_ended
