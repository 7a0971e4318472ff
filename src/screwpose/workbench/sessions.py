"""The open cases of a server, and the processes that they may have."""

import asyncio
import os
import shutil
import tempfile
from pathlib import Path

from screwpose.workbench.process import Child
from screwpose.workbench.session import READER_BYTES, Session
from screwpose.workbench.store import CaseStore
from screwpose.workbench.workspace import Workspace

_MOST_READERS = 6  # processes that keep a case in memory, some 300 MB each


class Sessions:
    """All cases that are open, by key. The cache has pixels and meshes that were read from uploaded files."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.cache = Path(tempfile.mkdtemp(prefix="screwpose-workbench-"))
        self.uploads = self.cache / "uploads"
        self.uploads.mkdir()
        # A solve uses all processors for much of its time: more at once would only make each slower.
        self.queue = asyncio.Semaphore(max(1, (os.cpu_count() or 2) // 4))
        self._open: dict[str, Session] = {}
        self._helpers = asyncio.Semaphore(2)

    def get(self, key: str) -> Session:
        """The session of a case, opened where it was not.

        Raises
        ------
        CaseError
            There is no such case, or it cannot be read.
        """
        folder = self.workspace.folder_of(key)
        session = self._open.pop(key, None) or Session(key, CaseStore(folder), self.cache, self.queue)
        self._open[key] = session  # the last one is the one that was used last
        if session.store.is_changed_elsewhere:
            session.reread()
        self._rest()
        return session

    def _rest(self) -> None:
        """End the readers of the cases that were not used for longest: they start again when they are asked."""
        for session in list(self._open.values())[:-_MOST_READERS]:
            if session.job is None or not session.job.is_open:
                session.reader.end()
                session.reader = Child(READER_BYTES)

    async def helped(
        self, task: str, arguments: dict[str, object], told: object = None, quiet_s: float = 90.0
    ) -> object:
        """Have something done by a process that ends with it: what it reads may be anything.

        Raises
        ------
        TaskError
            It cannot be done.
        """
        async with self._helpers:
            child = Child(READER_BYTES)
            try:
                return await child.ask(task, arguments, told, quiet_s)  # type: ignore[arg-type]
            finally:
                child.end()
                await child.gone()

    async def close(self) -> None:
        """End all processes, and throw the cache away: it has pixels of patients."""
        try:
            for session in self._open.values():
                session.close()
            for session in self._open.values():
                await session.gone()
        finally:
            shutil.rmtree(self.cache, ignore_errors=True)
