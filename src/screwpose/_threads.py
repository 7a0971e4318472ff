"""Work that is cut into independent parts, done side by side: results never depend on how many threads there are."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Answer = TypeVar("Answer")


def each_in_threads(work: Callable[[Item], Answer], items: Sequence[Item]) -> list[Answer]:
    """What `work` makes of every item, in their order, one thread an item: for a few X-rays, not for thousands.

    The first error, in the order of the items, is raised when all are done.
    """
    if len(items) < 2:
        return [work(item) for item in items]
    with ThreadPoolExecutor(len(items)) as pool:
        return list(pool.map(work, items))
