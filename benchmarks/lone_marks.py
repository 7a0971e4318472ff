"""Marks of two screws that fit each other: are they taken for one?

    python benchmarks/lone_marks.py --set hard,multi --count 30 --seed 1

Of each case the screw of one view and the screw of the other are found whose marks fit each other best as one screw;
their own partners are then taken away, as if nobody had marked them. What is left has a pair that the landmarks like
and that is none. It is counted how often the pair is answered, and how often that is sure, by the landmarks alone and
once the X-rays are asked.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.progress import track

from screwpose.benchmark import get_set
from screwpose.files.case import Case, read_case
from screwpose.files.schema import ResultFile
from screwpose.files.truth import read_truth
from screwpose.pairing import LandmarkNoise
from screwpose.pairing.hypotheses import HypothesisTable
from screwpose.registration import SearchOptions
from screwpose.report.tables import Column, Table
from screwpose.solve import SolveOptions, solve

_MOST_CHI_SQUARE = 40.0  # beyond, nobody would take them for one


@dataclass(frozen=True)
class Outcome:
    """What was said of the pair that is none: whether it was answered, the pairing's status, and the result's."""

    answered: bool
    pairing: str
    status: str

    @property
    def sure(self) -> bool:
        """Whether the pairing is confident, the pair in it."""
        return self.answered and self.pairing == "confident"


def with_lone_marks(case: Case, pairs: Sequence[dict[str, str]]) -> tuple[Case, dict[str, str]] | None:
    """The case without the partners of the two marks that fit best, and these two; None where none fit.

    Parameters
    ----------
    pairs : the true ones.
    """
    first, second = case.views
    table = HypothesisTable(case, LandmarkNoise())
    found = []
    for one, other in permutations(pairs, 2):
        labels = ((first, one[first]), (second, other[second]))
        table.fit([labels])
        found.append((table.chi_square(labels), one, other))
    if not found:
        return None
    chi_square, one, other = min(found, key=lambda item: item[0])
    if chi_square > _MOST_CHI_SQUARE:
        return None
    gone = {first: other[first], second: one[second]}
    kept = {
        view: tuple(mark for mark in marks if mark.label != gone.get(view)) for view, marks in case.annotations.items()
    }
    return replace(case, annotations=kept), {first: one[first], second: other[second]}


def outcome(answer: ResultFile, pair: dict[str, str]) -> Outcome:
    """What an answer says of the pair."""
    return Outcome(pair in answer.pairing.pairs, answer.pairing.status, answer.status)


def main() -> None:
    """Print a row for each set."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--set", default="hard,multi", help="sets, with commas between")
    arguments.add_argument("--count", type=int, default=30, help="cases of each set")
    arguments.add_argument("--seed", type=int, default=1, help="of the cases")
    given = arguments.parse_args()
    rows = []
    for name in given.set.split(","):
        by_marks, by_images = [], []
        for index in track(range(given.count), name, console=Console(stderr=True)):
            with TemporaryDirectory(prefix="lone-") as scratch:
                path = get_set(name).make(given.seed, index, Path(scratch) / "case")
                case, truth = read_case(path), read_truth(path.parent / "truth.json")
            made = with_lone_marks(
                case, [screw.labels for screw in truth.screws if len(screw.labels) == len(case.views)]
            )
            if made is None:
                continue
            alone, pair = made
            by_marks.append(outcome(solve(alone, SolveOptions(search=SearchOptions(generations=0))).answer, pair))
            by_images.append(outcome(solve(alone).answer, pair))
        counts = [(sum(one.answered for one in some), sum(one.sure for one in some)) for some in (by_marks, by_images)]
        in_all = sum(one.sure and one.status == "confident" for one in by_images)
        rows.append((name, len(by_marks), *counts[0], *counts[1], in_all))
    columns = [Column("set", "Set", is_number=False), Column("cases", "cases")]
    columns += [
        Column(f"{by} {what}", what, by)
        for by in ("by the landmarks", "with the X-rays")
        for what in ("answered", "answered and confident")
    ]
    columns.append(Column("all", "and the whole result confident"))
    title = f"Pairs that are none, seed {given.seed}"
    Console().print(Table(title, tuple(columns), tuple(rows)).to_markdown(), markup=False, soft_wrap=True)


if __name__ == "__main__":
    main()
