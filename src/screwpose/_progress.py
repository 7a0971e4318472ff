"""How far a job is that has several parts, one after the other or side by side."""

from collections.abc import Callable
from threading import Lock

from screwpose.errors import CancelledError

Progress = Callable[[float, str], None]
"""``progress(fraction, what)``: told how far the work is; may raise CancelledError to stop it."""


def part_of(tell: Progress, first: float, last: float, prefix: str = "") -> Progress:
    """A progress that fills a part of another."""
    return lambda fraction, what: tell(first + (last - first) * fraction, prefix + what)


def tell_nobody(_fraction: float, _what: str) -> None:
    """The progress of a job that nobody watches."""


def of_several(tell: Progress, index: int, count: int) -> Progress:
    """The progress of one of several combinations that are registered one after the other."""
    return part_of(tell, index / count, (index + 1) / count, f"registering combination {index + 1} of {count}: ")


class SideBySide:
    """The progress of combinations that are registered at once: how far all of them are together."""

    def __init__(self, tell: Progress, count: int) -> None:
        self._tell = tell
        self._shares = [0.0] * count
        self._turn = Lock()
        self._is_given_up = False

    def give_up(self) -> None:
        """Stop them all when they next tell how far they are."""
        self._is_given_up = True

    def progress_of(self, index: int) -> Progress:
        def tell(fraction: float, what: str) -> None:
            with self._turn:
                if self._is_given_up:
                    raise CancelledError("stopped with the other combinations")
                self._shares[index] = max(fraction, self._shares[index])
                self._tell(sum(self._shares) / len(self._shares), f"registering side by side: {what}")

        return tell
