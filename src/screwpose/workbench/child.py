"""The other end of `screwpose.workbench.process`: ``python -m screwpose.workbench.child BYTES``."""

import contextlib
import json
import os
import sys
from typing import IO, Any

from screwpose.errors import ScrewposeError


def limit_memory(number: int) -> None:
    """Let this process have no more address space than so many bytes, or than it has already; where the system refuses
    to, as macOS may, it goes on without."""
    if sys.platform == "win32":
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    least = number if hard == resource.RLIM_INFINITY else min(number, hard)
    for kind, limit in ((resource.RLIMIT_AS, least), (resource.RLIMIT_CORE, 0)):
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(kind, (limit, limit))


def answer(line: str, out: IO[str]) -> None:
    """Do the task of one line and write what came of it."""
    from screwpose.workbench.tasks import TASKS

    def say(message: dict[str, Any]) -> None:
        out.write(json.dumps(message, allow_nan=False) + "\n")
        out.flush()

    asked = json.loads(line)
    try:
        value = TASKS[asked["task"]](lambda fraction, what: say({"progress": [fraction, what]}), **asked["arguments"])
        say({"value": value})
    except BrokenPipeError:
        raise
    except ScrewposeError as error:
        say({"error": str(error)})
    except MemoryError:
        say({"error": "it needs more memory than it may have: is the file what it seems to be?"})
    except Exception as error:  # noqa: BLE001 - the parent must hear of a bug too, and go on
        say({"error": f"an error of the program, {type(error).__name__}: {error}"})


def main() -> None:
    """Answer until the other end closes."""
    limit_memory(int(sys.argv[1]))
    # The parent dies: nobody closes a task that runs. A new session keeps Ctrl-C in the terminal to the parent.
    if hasattr(os, "setsid"):
        os.setsid()
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints is no answer
    try:
        for line in sys.stdin:
            answer(line, out)
    except BrokenPipeError:
        os._exit(0)  # the other end is gone: nobody is left to tell, and closing the pipe would say so again


if __name__ == "__main__":
    main()
