"""A wrong combination that overfits one view: how often does it deceive the paper's loss, and what does `default` do?

    python benchmarks/overfit.py --set pairs,hard --count 40 --seed 7 -o overfit-out

In the paper's Set 3 the wrong combination, registered, has a good loss in one view and a bad one in the other, and the
mean hides it. Here every combination of a case is registered by the paper's method (mean loss over the views,
differential evolution on silhouettes). A case deceives where some wrong combination then has a better score than the
right one: a lower loss or a higher Dice, in one view or in the mean. The same cases are then solved by `default`, which
registers by thickness and judges by the marks. Writes cases.csv, views.csv and overfit.md.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rich.console import Console
from rich.progress import Progress

from screwpose.benchmark import get_set
from screwpose.benchmark.rows import to_csv
from screwpose.benchmark.scoring import pairing_is_right
from screwpose.files import ensure_can_write_folder, read_case, write_text
from screwpose.files.case import Case
from screwpose.files.schema import CombinationFile, ResultFile, Scores, StageScores, TruthFile
from screwpose.files.truth import read_truth
from screwpose.registration import SearchOptions
from screwpose.report.meshes import make_folder
from screwpose.report.tables import same_pairs
from screwpose.solve import SolveOptions, solve


@dataclass(frozen=True)
class View:
    """Right and best wrong combination in one view, or in the mean of all, after the paper's registration."""

    set: str
    index: int
    view: str
    right_loss: float
    wrong_loss: float
    right_dice: float
    wrong_dice: float

    @property
    def by_loss(self) -> bool:
        """Whether the wrong combination's loss is better."""
        return self.wrong_loss < self.right_loss

    @property
    def by_dice(self) -> bool:
        """Whether its Dice score is."""
        return self.wrong_dice > self.right_dice


@dataclass(frozen=True)
class Outcome:
    """One case: who is deceived.

    Parameters
    ----------
    loss_in_a_view, dice_in_a_view : a wrong combination beats the right one in some view.
    hidden_by_mean : in one view it has the better loss and in another the worse, as in the paper's Set 3.
    mean_loss, mean_dice : in the mean of the views: by these the paper would take it.
    default_right, default_status, default_probability : what `default` answers.
    """

    set: str
    index: int
    loss_in_a_view: bool
    dice_in_a_view: bool
    hidden_by_mean: bool
    mean_loss: bool
    mean_dice: bool
    paper_right: bool
    default_right: bool
    default_status: str
    default_probability: float

    @property
    def default_is_safe(self) -> bool:
        """Whether `default` pairs right, or says that it is not sure."""
        return self.default_right or self.default_status != "confident"


def views_of(name: str, index: int, answer: ResultFile, truth: TruthFile) -> list[View]:
    """The right combination beside the wrong one with the lowest mean loss, view by view, then the mean.

    Empty where the right combination, or a wrong one, was not registered.
    """
    true_pairs = [screw.labels for screw in truth.screws if len(screw.labels) > 1]
    done = [one for one in answer.combinations if one.post is not None]
    right = [one for one in done if same_pairs(one.pairs, true_pairs)]
    wrong = sorted((one for one in done if not same_pairs(one.pairs, true_pairs)), key=_mean_loss)
    if not right or not wrong:
        return []
    stages = [_post(right[0]), _post(wrong[0])]
    scores = {view: [stage.views[view] for stage in stages] for view in stages[0].views}
    rows = [View(name, index, view, *_numbers(*pair)) for view, pair in scores.items()]
    return [*rows, View(name, index, "mean", *_numbers(*stages))]


def _post(one: CombinationFile) -> StageScores:
    assert one.post is not None, "only those that were registered are asked"
    return one.post


def _mean_loss(one: CombinationFile) -> float:
    return _post(one).loss


def _numbers(right: Scores, wrong: Scores) -> tuple[float, float, float, float]:
    return right.loss, wrong.loss, right.dice, wrong.dice


def outcome(rows: Sequence[View], paper: ResultFile, default: ResultFile, truth: TruthFile) -> Outcome:
    """What the scores of one case say, and what the methods answer."""
    views = [row for row in rows if row.view != "mean"]
    (mean,) = (row for row in rows if row.view == "mean")
    beaten = [row.by_loss for row in views]
    return Outcome(
        mean.set,
        mean.index,
        any(beaten),
        any(row.by_dice for row in views),
        any(beaten) and not all(beaten),
        mean.by_loss,
        mean.by_dice,
        pairing_is_right(paper, truth),
        pairing_is_right(default, truth),
        default.status,
        default.pairing.probability or 0.0,
    )


def solved(case: Case, method: str, generations: int) -> ResultFile:
    """The answer of a method; the paper's draws its masks as bit rows, which gives the same losses in less time."""
    if method == "default":
        return solve(case, SolveOptions()).answer
    return solve(case, SolveOptions("paper", engine="bitrows", search=SearchOptions(generations=generations))).answer


_KINDS = (
    ("all that have a wrong combination", lambda one: one.set != ""),
    ("wrong has the better loss in one view, the worse in another", lambda one: one.hidden_by_mean),
    ("wrong has the better loss in the mean", lambda one: one.mean_loss),
    ("wrong has the better Dice in some view", lambda one: one.dice_in_a_view),
    ("wrong has the better Dice in the mean: the paper is deceived", lambda one: one.mean_dice),
    ("any of these", lambda one: one.loss_in_a_view or one.dice_in_a_view or one.mean_loss or one.mean_dice),
)


def page(outcomes: Sequence[Outcome], rows: Sequence[View]) -> str:
    """The report."""
    sets = " and ".join(f"`{name}`" for name in dict.fromkeys(one.set for one in outcomes))
    lines = [
        "# Wrong combinations that overfit",
        "",
        f"{len(outcomes)} cases of {sets}. Every combination is registered by the paper's mean loss of the views.",
        "",
        "| cases | how many | paper right | `default` right | `default` wrong and confident | `default` asks to look |",
        "|---|---|---|---|---|---|",
    ]
    for name, belongs in _KINDS:
        some = [one for one in outcomes if belongs(one)]
        right = sum(one.default_right for one in some)
        sure_and_wrong = sum(not one.default_is_safe for one in some)
        asks = sum(one.default_status != "confident" for one in some)
        paper = sum(one.paper_right for one in some)
        lines.append(f"| {name} | {len(some)} | {paper} | {right} | {sure_and_wrong} | {asks} |")
    lines += ["", "## The worst", "", "The cases in which the wrong combination gains most in one view.", ""]
    lines += ["| case | view | loss right | loss wrong | Dice right | Dice wrong |", "|---|---|---|---|---|---|"]
    single = [row for row in rows if row.view != "mean"]
    ranked = sorted(single, key=lambda row: row.wrong_loss - row.right_loss)
    for case in list(dict.fromkeys((row.set, row.index) for row in ranked))[:5]:
        lines += [_row(row) for row in rows if (row.set, row.index) == case]
    return "\n".join(lines) + "\n"


def _row(row: View) -> str:
    numbers = f"{row.right_loss:.3f} | {row.wrong_loss:.3f} | {row.right_dice:.3f} | {row.wrong_dice:.3f}"
    return f"| {row.set} {row.index} | {row.view} | {numbers} |"


def main(arguments: list[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", default="pairs,hard", help="sets of cases, with commas between them")
    parser.add_argument("--count", type=int, default=40, help="cases of each set")
    parser.add_argument("--seed", type=int, default=7, help="of the cases")
    parser.add_argument("--generations", type=int, default=SearchOptions().generations, help="of the paper's search")
    parser.add_argument("-o", "--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    ensure_can_write_folder(given.out, marker="cases.csv")
    folder = make_folder(given.out)
    outcomes: list[Outcome] = []
    rows: list[View] = []
    with Progress(console=Console(stderr=True)) as bar, TemporaryDirectory() as scratch:
        for name in given.set.split(","):
            task = bar.add_task(name, total=given.count)
            for index in range(given.count):
                where = Path(scratch) / f"{name}-{index}"
                case = read_case(get_set(name).make(given.seed, index, where))
                truth = read_truth(where / "truth.json")
                paper = solved(case, "paper", given.generations)
                found = views_of(name, index, paper, truth)
                if found:
                    rows += found
                    outcomes.append(outcome(found, paper, solved(case, "default", given.generations), truth))
                    write_text(folder / "views.csv", to_csv([asdict(one) for one in rows]))
                    write_text(folder / "cases.csv", to_csv([asdict(one) for one in outcomes]))
                    write_text(folder / "overfit.md", page(outcomes, rows))
                bar.advance(task)
    if outcomes:
        report = (folder / "overfit.md").read_text(encoding="utf-8")
        Console(soft_wrap=True).print(report, highlight=False, markup=False)


if __name__ == "__main__":
    main()
