"""How far a run is, and how long it will take."""

from collections.abc import Callable
from time import perf_counter

from screwpose.registration import Progress

# A forecast from less than this share of a case would be a guess.
_LEAST_CASES = 0.2


class Forecast:
    """Tells of the cases that are done, and of the time that the rest will take at the pace so far.

    Parameters
    ----------
    total, already : cases in all, and those that an earlier run has done: they say nothing about the pace.
    tell : is called with the share that is done and a few words.
    clock : seconds.
    """

    def __init__(self, total: int, already: int, tell: Progress, clock: Callable[[], float] = perf_counter) -> None:
        self._total, self._already, self._tell, self._clock = total, already, tell, clock
        self._done = 0
        self._start = clock()

    def case_done(self, what: str = "") -> None:
        """One more case is done."""
        self._done += 1
        self.say(what)

    def say(self, what: str = "", fraction: float = 0.0) -> None:
        """Tell how it stands, with `fraction` of one more case done."""
        done = self._already + self._done
        words = [f"{done} of {self._total} cases"]
        worked = self._done + fraction
        left = self._total - done - fraction
        if worked >= _LEAST_CASES and left > 0:
            words.append(f"about {told_duration((self._clock() - self._start) / worked * left)} left")
        if what:
            words.append(what)
        self._tell((done + fraction) / max(self._total, 1), ", ".join(words))

    def within_case(self, name: str) -> Progress:
        """A progress for one case."""
        return lambda fraction, what: self.say(f"{name}: {what}", fraction)


def told_duration(seconds: float) -> str:
    """``40 s``, ``14 min``, ``3 h 20 min``."""
    if seconds < 59.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
