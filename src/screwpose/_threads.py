"""The same function on several things at once, in threads: for compiled loops, which run without the interpreter's
lock."""

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from screwpose.errors import InputError

VARIABLE = "SCREWPOSE_THREADS"

_Item = TypeVar("_Item")
_Value = TypeVar("_Value")
_is_inside = threading.local()


def available_threads() -> int:
    """How many threads this process may run at once: $SCREWPOSE_THREADS, else one for each of its processors.

    Raises
    ------
    InputError
        The variable is set and is no positive integer.
    """
    wanted = os.environ.get(VARIABLE, "").strip()
    if not wanted:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not wanted.isdecimal() or int(wanted) < 1:
        raise InputError(
            f"the environment variable is {wanted!r}",
            field=VARIABLE,
            expected="a positive integer, the number of threads to use",
            remedy="Set it to one, as in `SCREWPOSE_THREADS=2`, or unset it to use all processors.",
        )
    return int(wanted)


def in_threads(
    function: Callable[[_Item], _Value], items: Iterable[_Item], give_up: Callable[[], None] | None = None
) -> list[_Value]:
    """``[function(item) for item in items]``; the first error in the order of the items is raised.

    Within such a thread it runs one after the other: what is outermost has the threads.

    Parameters
    ----------
    give_up : called at an error or interrupt, before the threads that still run are waited for: it may tell them.
    """
    todo = list(items)
    threads = 1 if len(todo) < 2 or getattr(_is_inside, "value", False) else min(available_threads(), len(todo))
    if threads < 2:
        return [function(item) for item in todo]

    def inside(item: _Item) -> _Value:
        _is_inside.value = True
        return function(item)

    with ThreadPoolExecutor(threads) as pool:
        try:
            return list(pool.map(inside, todo))
        except BaseException:
            if give_up is not None:
                give_up()
            raise
