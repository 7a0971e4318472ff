"""The smoke run that gates every change: a few small cases, and a search short enough for one core.

``python -m tests.benchmark.smoke`` writes the baseline anew: when figures are meant to move; say in the commit
which did, and why.
"""

from datetime import UTC, datetime
from pathlib import Path

from screwpose.benchmark.gate import baseline_of
from screwpose.benchmark.record import CaseRecord
from screwpose.benchmark.request import make_request
from screwpose.benchmark.run_folder import RunFolder
from screwpose.benchmark.summary import measures_file
from screwpose.benchmark.tasks import outcomes_of
from screwpose.files.atomic import write_json
from screwpose.registration import SearchOptions
from screwpose.solve import SolveOptions

BASELINE = Path(__file__).with_name("smoke_baseline.json")
SEED = 11
CASES = 4
METHODS = ("paper", "epipolar", "default")
OPTIONS = SolveOptions(faces=300, search=SearchOptions(generations=4, population=1))


def smoke_records() -> list[CaseRecord]:
    """The records of the smoke run; nothing is written."""
    request = make_request(sets=["smoke"], methods=METHODS, count=CASES, seed=SEED, options=OPTIONS)
    tasks = RunFolder(Path(), request).tasks(keep_cases=False)
    return [outcome.record for task in tasks for outcome in outcomes_of(task)]


def main() -> None:
    """Write the baseline."""
    started = datetime.now(UTC).isoformat(timespec="seconds")
    write_json(BASELINE, baseline_of(measures_file(smoke_records(), seed=SEED, started=started)))


if __name__ == "__main__":
    main()
