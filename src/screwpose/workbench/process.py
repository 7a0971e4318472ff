"""A process of its own for whatever reads files or computes: it can be limited, and ended, and the page never waits.

One JSON object a line goes in and comes out; `screwpose.workbench.child` is the other end.
"""

import asyncio
import contextlib
import json
import sys
from collections.abc import Callable
from typing import Any

from screwpose.errors import CancelledError, ScrewposeError

Told = Callable[[float, str], None]
_LONGEST_LINE = 256 * 2**20
_QUIET_S = 120.0  # a task that says nothing for so long hangs


class TaskError(ScrewposeError):
    """A task that could not be done; the text is for the person who asked."""


class Child:
    """A process that does one task after the other; started when it is first asked.

    Parameters
    ----------
    memory_bytes : it may have no more.
    """

    def __init__(self, memory_bytes: int) -> None:
        self._memory = memory_bytes
        self._process: asyncio.subprocess.Process | None = None
        self._turn = asyncio.Lock()
        self._killed: list[asyncio.subprocess.Process] = []
        self.is_ended = False

    async def ask(
        self, task: str, arguments: dict[str, Any], told: Told | None = None, quiet_s: float = _QUIET_S
    ) -> Any:
        """Have a task of `screwpose.workbench.tasks` done.

        Parameters
        ----------
        told : called with the fraction done and what is being done.
        quiet_s : how long it may say nothing before it is ended.

        Raises
        ------
        TaskError
            It cannot be done: why, in words.
        CancelledError
            The process was ended by `end`.
        """
        async with self._turn:
            if self.is_ended:
                raise CancelledError("stopped")
            process = await self._started()
            assert process.stdin is not None
            assert process.stdout is not None
            line = json.dumps({"task": task, "arguments": arguments}) + "\n"
            try:
                process.stdin.write(line.encode())
                await process.stdin.drain()
                while True:
                    answer = await asyncio.wait_for(process.stdout.readline(), quiet_s)
                    if not answer:
                        raise ConnectionResetError
                    message = json.loads(answer)
                    if "progress" in message:
                        if told is not None:
                            told(*message["progress"])
                    elif "error" in message:
                        raise TaskError(message["error"])
                    else:
                        return message["value"]
            except TimeoutError as error:
                self._kill()
                raise TaskError(f"it took more than {quiet_s:.0f} s without a sign of life, and was stopped") from error
            except (ConnectionError, json.JSONDecodeError) as error:
                self._kill()
                if self.is_ended:
                    raise CancelledError("stopped") from error
                raise TaskError(
                    "it needed more memory than it may have, or broke down: is the file damaged?"
                ) from error
            except asyncio.CancelledError:
                self._kill()  # a half-read answer would be taken for the next one's
                raise

    def end(self) -> None:
        """Stop whatever it does, for good."""
        self.is_ended = True
        self._kill()

    async def gone(self) -> None:
        """Wait until what was ended is no more: a loop must not close before it has noticed."""
        while self._killed:
            await self._killed.pop().wait()
        await asyncio.sleep(0)

    async def _started(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "screwpose.workbench.child", str(self._memory),
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, limit=_LONGEST_LINE,
            )  # fmt: skip
        return self._process

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            if process.stdin is not None:
                process.stdin.close()
            self._killed = [*(one for one in self._killed if one.returncode is None), process]
