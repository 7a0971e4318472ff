"""What a panel does with what a hand did; without a browser, the page is a stand-in."""

import asyncio
from types import SimpleNamespace

from screwpose.files.case import read_case
from screwpose.images import read_mask
from screwpose.workbench import panel_images
from screwpose.workbench.panel_export import ExportPanel
from screwpose.workbench.panel_images import ImagesPanel
from screwpose.workbench.panel_mark import MarkPanel
from screwpose.workbench.session import Session
from screwpose.workbench.store import CaseStore
from screwpose.workbench.tasks import TASKS
from tests.workbench.driving import awaited


def session_on(folder):
    """A session whose process is this one."""
    session = Session("demo", CaseStore(folder), folder, asyncio.Semaphore(1))

    async def ask(task, **arguments):
        await asyncio.sleep(0.01)
        return TASKS[task](lambda _fraction, _what: None, folder=str(folder), **arguments)

    session.ask = ask
    session.look_soon = lambda: None
    return session


def test_two_strokes_at_once_are_two_masks_and_two_steps_back(workspace):
    folder = workspace / "demo"
    size = read_case(folder).views["AP"].radiograph.size

    async def paint():
        session = session_on(folder)
        panel = MarkPanel(SimpleNamespace(session=session, may_edit=True))
        panel._brush, panel._erase = SimpleNamespace(value=5.0), SimpleNamespace(value=False)
        strokes = [{"points": [[100.0, v], [160.0, v]]} for v in (100.0, 200.0)]
        await asyncio.gather(*(panel._painted("AP", SimpleNamespace(args=one)) for one in strokes))
        return session

    session = awaited(paint())

    def counting():
        mask = read_mask(folder / session.store.draft["views"]["AP"]["mask"], size)
        return [bool(mask[v, 130]) for v in (100, 200)]

    assert counting() == [False, False]
    assert session.store.undo()
    assert counting() == [False, True]
    assert session.store.undo()
    assert "mask" not in session.store.draft["views"]["AP"]


def test_a_tab_that_only_looks_writes_no_report_and_says_that_it_takes_no_files(workspace, monkeypatch):
    said, asked = [], []
    session = session_on(workspace / "demo")

    async def ask(task, **_arguments):
        asked.append(task)

    session.ask = ask
    monkeypatch.setattr(panel_images.ui, "notify", lambda words, **_options: said.append(words))
    page = SimpleNamespace(session=session, may_edit=False)
    button = SimpleNamespace(props=lambda *_arguments, **_options: None)
    awaited(ExportPanel(page)._write(button))
    awaited(ImagesPanel(page)._take([]))
    assert asked == []
    assert "only be looked at" in said[0]
    page.may_edit = True
    awaited(ExportPanel(page)._write(button))
    assert asked == ["export"]
