"""One open case: its store, what is known of it, its jobs, and the tabs that show it."""

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from screwpose.errors import CancelledError, ScrewposeError
from screwpose.workbench.draft import Draft
from screwpose.workbench.process import Child, TaskError
from screwpose.workbench.side_file import Begun, Choice, HeldPose
from screwpose.workbench.store import RESULT_FOLDER, CaseStore

LOG = logging.getLogger(__name__)

READER_BYTES = 6 * 2**30
SOLVER_BYTES = 12 * 2**30
_SETTLE_S = 0.35  # a hand that goes on makes looking at once worthless
_WATCH_S = 1.0


@dataclass
class Job:
    """A solve that waits, runs, or ran: `state` says which, in a word that is shown."""

    asked: Begun
    state: str = "waiting"
    fraction: float = 0.0
    what: str = "waiting for its turn"
    began: float | None = None
    problem: str = ""
    child: Child | None = None

    @property
    def is_open(self) -> bool:
        """Whether it waits or runs."""
        return self.state in ("waiting", "running")

    @property
    def left_s(self) -> float | None:
        """How long it will still take, if it goes on as it went."""
        if self.began is None or self.fraction < 0.05:
            return None
        spent = time.perf_counter() - self.began
        return spent * (1.0 - self.fraction) / self.fraction


@dataclass(eq=False)
class Session:
    """A case that is open in one tab or several; `owner` is the tab that may change it."""

    key: str
    store: CaseStore
    cache: Path
    queue: asyncio.Semaphore
    owner: str | None = None
    known: dict[str, Any] = field(default_factory=dict)
    reviewed: dict[str, Any] | None = None
    live: dict[str, Any] | None = None
    problem: str = ""
    told_of_files: list[dict[str, str]] = field(default_factory=list)
    notes_of_models: dict[str, list[str]] = field(default_factory=dict)
    job: Job | None = None
    listeners: dict[str, Callable[[], None]] = field(default_factory=dict)
    reader: Child = field(default_factory=lambda: Child(READER_BYTES))
    _looking: asyncio.Task[None] | None = None
    _watching: asyncio.Task[None] | None = None
    _drawn_from: float | None = None
    _running: set[asyncio.Task[None]] = field(default_factory=set)

    def tell(self) -> None:
        """Have every tab show the case as it is now."""
        for listener in list(self.listeners.values()):
            listener()

    # ---- changing the case
    def change(self, draft: Draft) -> None:
        """Save a changed case, and look at it again."""
        self._saved(lambda: self.store.change(draft))

    def undo(self) -> None:
        """Take back the last action."""
        self._saved(self.store.undo)

    def redo(self) -> None:
        """Do again what was taken back."""
        self._saved(self.store.redo)

    def change_side(self, **changes: Any) -> bool:
        """Save what the case's format has no place for; False where it could not be."""
        return self._saved(lambda: self.store.change_side(**changes), looks=False)

    def _saved(self, act: Callable[[], Any], looks: bool = True) -> bool:
        try:
            act()
            self.problem = ""
        except ScrewposeError as error:
            self.problem = str(error)
        if looks:
            self.look_soon()
        self.tell()
        return not self.problem

    # ---- whose the case is
    @property
    def may_write(self) -> bool:
        """Whether no other server has the case, as far as is known."""
        return self.store.claim.other is None

    def watch(self) -> None:
        """From now on, while a tab shows the case: keep it, or show what the server does that has it."""
        self.keep()
        if self._watching is None or self._watching.done():
            self._watching = self._started(self._watch())

    async def _watch(self) -> None:
        while self.listeners or (self.job is not None and self.job.is_open):
            await asyncio.sleep(_WATCH_S)
            self.keep()
        self.store.claim.release()

    def keep(self, takes: bool = False) -> None:
        """Say that the case is ours; where another server has it, show the case as that one saved it, and go on once it
        is done with it. With `takes` that one is told that it is ours now."""
        before = self.store.claim.other
        try:
            self.store.claim.renew(takes)
            if takes or (before or self.store.claim.other) is not None:
                self._follow()
        except ScrewposeError as error:
            self.problem = str(error)
        if not self.may_write and self.job is not None and self.job.is_open:
            self.job.state, self.job.what = "cancelled", "cancelled"  # it is the other server's to ask for again
            if self.job.child is not None:
                self.job.child.end()
        if before != self.store.claim.other:
            self.tell()

    def _follow(self) -> None:
        """Show what another server saved."""
        if self.store.is_changed_elsewhere:
            self.reread()
        if self.is_solved and self.reviewed is not None and self._drawn_from != self._result_time:
            self._started(self.load_review())

    def reread(self) -> None:
        """Go on with the case as it is on the disk.

        Raises
        ------
        CaseError
            It cannot be read any more.
        """
        self.store.reread()
        self.problem = ""
        self.look_soon()
        if self.reviewed is not None:
            self._started(self._show_held())
        self.tell()

    @property
    def _result_time(self) -> float | None:
        try:
            return (self.store.folder / RESULT_FOLDER / "result.json").stat().st_mtime
        except FileNotFoundError:
            return None

    @property
    def is_solved(self) -> bool:
        """Whether there is a result, of this case or of an older state of it."""
        return (self.store.folder / RESULT_FOLDER / "result.json").exists()

    @property
    def is_stale(self) -> bool:
        """Whether the case was changed since it was solved here."""
        return self.store.is_stale

    # ---- looking
    def look_soon(self) -> None:
        """Look at the case again once nothing changed for a moment."""
        if self._looking is not None:
            self._looking.cancel()
        self._looking = self._started(self._look())

    async def _look(self) -> None:
        await asyncio.sleep(_SETTLE_S if self.known else 0.0)
        # What is being read is read to its end: to stop it would be to start a process anew.
        known = await asyncio.shield(self._started_value(self.ask("look", cache=str(self.cache))))
        if known is not None:
            self.known = known
            self.tell()

    async def ask(self, task: str, **arguments: Any) -> Any:
        """Have the case's own process do something; None, with the reason shown, where it cannot."""
        try:
            return await self.reader.ask(task, {"folder": str(self.store.folder), **arguments})
        except CancelledError:
            return None
        except TaskError as error:
            self.problem = str(error)
            self.tell()
            return None

    async def load_review(self) -> None:
        """Draw the result again."""
        if self.is_solved:
            self._drawn_from = self._result_time
            self.reviewed = await self.ask("review", cache=str(self.cache))
            await self._show_held()

    async def _show_held(self) -> None:
        """Draw and score the screws where a person put them, after a restart as before it."""
        self.live = None
        if self.reviewed is not None and self.reviewed["screws"] and self.store.side.by_hand:
            view = next(iter(self.store.draft["views"]))
            self.live = await self.ask("nudge", poses=self.poses_now, index=0, view=view, move={})
        self.tell()

    @property
    def poses_now(self) -> list[Any]:
        """world_from_cad of every screw of the result, where it was put by hand if it was."""
        assert self.reviewed is not None
        if self.live is not None:
            return list(self.live["poses"])
        held = {frozenset(one.labels.items()): one.world_from_cad for one in self.store.side.by_hand}
        return [held.get(frozenset(one["labels"].items()), one["world_from_cad"]) for one in self.reviewed["screws"]]

    # ---- solving
    def solve(self, asked: Begun) -> None:
        """Put a solve into the queue."""
        if self.job is not None and self.job.is_open:
            return
        self.job = job = Job(asked)
        if self.change_side(job=asked):
            self._started(self._solve(job))
        else:
            job.state, job.problem = "failed", self.problem
            self.tell()

    def cancel(self) -> None:
        """Stop the solve that waits or runs; what was found before stays."""
        if self.job is not None and self.job.is_open:
            self.job.state, self.job.what = "cancelled", "cancelled"
            if self.job.child is not None:
                self.job.child.end()
            self.change_side(job=None)

    async def _solve(self, job: Job) -> None:
        async with self.queue:
            if job.state != "waiting":
                return
            job.state, job.what = "running", "starting"
            job.began, job.child = time.perf_counter(), Child(SOLVER_BYTES)
            digest, asked = self.store.digest, job.asked
            pairs = None if asked.pairs is None else [dict(one) for one in asked.pairs]
            poses = [one.model_dump(mode="json") for one in asked.poses]
            reason = None if asked.choice is None else asked.choice.reason

            def told(fraction: float, what: str) -> None:
                job.fraction, job.what = max(job.fraction, fraction), what

            try:
                await job.child.ask(
                    "solve",
                    {"folder": str(self.store.folder), "pairs": pairs, "poses": poses, "reason": reason},
                    told, quiet_s=1800.0,
                )  # fmt: skip
            except CancelledError:
                return
            except TaskError as error:
                job.state, job.problem = "failed", str(error)
                self.change_side(job=None)
                return
            finally:
                job.child.end()
                await job.child.gone()
            if job.state != "running":
                return
            job.state, job.fraction = "done", 1.0
            self.change_side(job=None, solved_from=digest, choice=asked.choice, by_hand=())
        await self.load_review()

    def choose(self, number: int, reason: str, when: str) -> None:
        """The person's pairing in place of the solver's: it is registered and judged as the solver's was."""
        assert self.reviewed is not None
        by_id = {one["id"]: one["pairs"] for one in self.reviewed["combinations"]}
        before = self.store.side.choice
        solver_pairs = before.solver_pairs if before is not None else tuple(by_id[self.reviewed["chosen"]])
        pairs = tuple(by_id[number])
        if {frozenset(one.items()) for one in pairs} == {frozenset(one.items()) for one in solver_pairs}:
            self.solve(Begun())  # the solver's own again, judged among all others
            return
        self.solve(Begun(pairs=pairs, choice=Choice(pairs=pairs, solver_pairs=solver_pairs, reason=reason, when=when)))

    def refine_from_here(self) -> None:
        """Register anew from where the screws were put by hand."""
        assert self.reviewed is not None
        pairs = tuple(one["labels"] for one in self.reviewed["screws"])
        self.solve(Begun(pairs=pairs, poses=self.store.side.by_hand, choice=self.store.side.choice))

    def put_by_hand(self, poses: list[list[list[float]]]) -> None:
        """Keep where a person put the screws."""
        assert self.reviewed is not None
        held = tuple(
            HeldPose(labels=one["labels"], world_from_cad=_rows(pose))
            for one, pose in zip(self.reviewed["screws"], poses, strict=True)
        )
        self.change_side(by_hand=held)

    def close(self) -> None:
        """End its processes, and leave the case to others."""
        self.reader.end()
        if self.job is not None and self.job.child is not None:
            self.job.child.end()
        self.store.claim.release()

    async def gone(self) -> None:
        """Wait until they are no more."""
        await self.reader.gone()
        if self.job is not None and self.job.child is not None:
            await self.job.child.gone()

    def _started(self, work: Any) -> "asyncio.Task[None]":
        task = asyncio.get_running_loop().create_task(_logged(work))
        self._running.add(task)
        task.add_done_callback(self._running.discard)
        return task

    def _started_value(self, work: Any) -> "asyncio.Task[Any]":
        return asyncio.get_running_loop().create_task(work)


def _rows(pose: list[list[float]]) -> Any:
    return tuple(tuple(float(x) for x in row) for row in pose)


async def _logged(work: Any) -> None:
    """A background task whose bug is heard of."""
    try:
        await work
    except asyncio.CancelledError:
        raise
    except Exception:
        LOG.exception("a task of the workbench broke down")
        raise
