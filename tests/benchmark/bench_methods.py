"""Methods for tests of the runner, named to it as ``tests.benchmark.bench_methods:near`` and so on."""

import os
import signal
from pathlib import Path
from time import sleep

import numpy as np

from screwpose.errors import BehindSourceError
from screwpose.files.case import Case
from screwpose.files.result import Result
from screwpose.geometry import rigid
from screwpose.pairing.answer import refused
from screwpose.registration import Progress
from screwpose.solve import SolveOptions
from tests.benchmark.worked import TRUE_POSES, result_of

PLACE = "tests.benchmark.bench_methods"
# A folder in which attempts are noted, and the id of a case whose first attempt, or every attempt, kills its process.
NOTES, KILLS_ONCE, KILLS_ALWAYS = "BENCH_TEST_NOTES", "BENCH_TEST_KILLS_ONCE", "BENCH_TEST_KILLS_ALWAYS"


def note(case: Case) -> int:
    """Note an attempt at a case; returns how many there were before."""
    folder = os.environ.get(NOTES)
    if not folder:
        return 0
    before = len(list(Path(folder).glob(f"{case.id}.*")))
    Path(folder, f"{case.id}.{before}.{os.getpid()}").touch()
    return before


def instant(case: Case, options: SolveOptions, progress: Progress | None) -> Result:
    """No answer, at once; the reason tells the seed."""
    before = note(case)
    if os.environ.get(KILLS_ALWAYS) == case.id or (os.environ.get(KILLS_ONCE) == case.id and not before):
        os.kill(os.getpid(), signal.SIGKILL)
    return refused(case, [f"seed {options.search.seed}, {options.faces} faces"], {"total": 0.0})


def near(case: Case, options: SolveOptions, progress: Progress | None) -> Result:
    """The truth of the case that is worked by hand, moved a little by the search's seed."""
    instant(case, options, progress)
    rng = np.random.default_rng(options.search.seed)
    poses = [pose @ rigid.exp(rng.normal(0, [0.01] * 3 + [0.3] * 3)) for pose in TRUE_POSES]
    return result_of(poses, sigma_mm=0.3)


def behind(case: Case, options: SolveOptions, progress: Progress | None) -> Result:
    """An error that is foreseen, in the second case."""
    if case.id.endswith("-1"):
        raise BehindSourceError("a vertex has depth -3 mm")
    return instant(case, options, progress)


def buggy(case: Case, options: SolveOptions, progress: Progress | None) -> Result:
    """An error that is not, in the second case."""
    if case.id.endswith("-1"):
        return {}[case.id]  # type: ignore[return-value]  # it never returns
    return instant(case, options, progress)


def sleepy(case: Case, options: SolveOptions, progress: Progress | None) -> Result:
    """As `near`; every case but the first takes a minute."""
    if not case.id.endswith("-0"):
        sleep(60)
    return near(case, options, progress)


not_a_function = "text"
