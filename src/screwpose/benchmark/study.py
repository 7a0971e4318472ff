"""A benchmark run: cases made, solved, scored, and summed up."""

import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from os import cpu_count
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from screwpose import __version__
from screwpose.benchmark.scoring import PoseError, compare, pairing_is_right, quantiles, screw_errors
from screwpose.benchmark.sets import BenchmarkSet, case_seed, get_set
from screwpose.errors import GeometryError
from screwpose.files.atomic import atomic_folder
from screwpose.files.case import read_case
from screwpose.files.schema import (
    MethodSummary,
    PairingRates,
    Quantiles,
    ResultFile,
    SetSummary,
    Software,
    StageQuantiles,
    SummaryFile,
    TruthFile,
)
from screwpose.files.truth import read_truth
from screwpose.pairing.answer import refused
from screwpose.report.tables import same_pairs
from screwpose.solve import SolveOptions, solve

CaseProgress = Callable[[int, int, float, str], None]
"""``progress(cases_done, cases, fraction_of_this_case, what)``; what it raises stops the run."""


@dataclass(frozen=True, eq=False)
class CaseOutcome:
    """One case of a run.

    Parameters
    ----------
    errors : for each screw of the answer, in its order; None where its labels belong to different screws.
    seconds : wall time of reading and solving the case, without making or reporting it.
    """

    answer: ResultFile
    truth: TruthFile
    right: bool
    errors: list[PoseError | None]
    seconds: float
    true_screws: int


@dataclass(frozen=True, eq=False)
class Study:
    """All outcomes of one set and method."""

    set_name: str
    method: str
    seed: int
    started: str
    outcomes: list[CaseOutcome] = field(default_factory=list)

    @property
    def true_pairs(self) -> dict[str, tuple[dict[str, str], ...]]:
        """The truth's labels by case id."""
        return {one.truth.case: tuple(dict(screw.labels) for screw in one.truth.screws) for one in self.outcomes}


def run_case(
    cases: BenchmarkSet,
    seed: int,
    index: int,
    options: SolveOptions,
    folder: Path,
    progress: Callable[[float, str], None] | None = None,
) -> CaseOutcome:
    """Make, solve and report one case, through files as users have them, in ``folder/cases`` and ``folder/results``."""
    from screwpose.report.writing import write_report

    name = f"{cases.name}-{index:04d}"
    path = cases.make(seed, index, folder / "cases" / name)
    start = perf_counter()
    case = read_case(path)
    search = replace(options.search, seed=case_seed(f"{cases.name}-search", seed, index))
    try:
        result = solve(case, replace(options, search=search), progress)
    except GeometryError as error:  # counted as refused: one case must not cost the run
        result = refused(case, [str(error)], {"total": perf_counter() - start})
    seconds = perf_counter() - start
    truth = read_truth(path.parent / "truth.json")
    with atomic_folder(folder / "results" / name) as partial:
        write_report(partial, case, result, compare(result.answer, truth, case.implants, cases.origin))
    errors = [error for _, error in screw_errors(result.answer, truth, case.implants)]
    right = pairing_is_right(result.answer, truth)
    return CaseOutcome(result.answer, truth, right, errors, seconds, len(truth.screws))


def run_study(
    set_name: str,
    method_options: SolveOptions,
    count: int,
    seed: int,
    folder: Path,
    progress: CaseProgress | None = None,
) -> Study:
    """Run the first `count` cases of a set; every case's files are on disk as soon as it is done.

    Raises
    ------
    InputError
        There is no such set, or its data is not there.
    """
    cases = get_set(set_name)
    count = count if cases.size is None else min(count, cases.size)
    study = Study(set_name, method_options.method, seed, datetime.now(UTC).isoformat(timespec="seconds"))
    for index in range(count):
        tell = None if progress is None else _of_case(progress, index, count)
        study.outcomes.append(run_case(cases, seed, index, method_options, folder, tell))
    return study


def _of_case(progress: CaseProgress, index: int, count: int) -> Callable[[float, str], None]:
    return lambda fraction, what: progress(index, count, fraction, what)


def summarise(study: Study) -> SummaryFile:
    """summary.json of a run. Errors are over the screws whose pairing is right."""
    outcomes = study.outcomes
    share = 1.0 / max(len(outcomes), 1)
    right_errors = [error for one in outcomes for error in one.errors if error is not None]
    true_pairs = study.true_pairs
    pairs = [(dict(pair), true_pairs[one.truth.case]) for one in outcomes for pair in one.answer.pairing.pairs]
    all_pairs = sum(len(screw.labels) > 1 for one in outcomes for screw in one.truth.screws)
    statuses = [one.answer.pairing.status for one in outcomes]
    pairing = PairingRates(
        right=share * sum(one.right for one in outcomes),
        confident=share * statuses.count("confident"),
        confident_wrong=share
        * sum(s == "confident" and not one.right for s, one in zip(statuses, outcomes, strict=True)),
        ambiguous=share * statuses.count("ambiguous"),
        refused=share * statuses.count("refused"),
        pairs_right=sum(pair in truth for pair, truth in pairs) / max(all_pairs, 1),
    )
    method = MethodSummary(
        cases=len(outcomes),
        screws=sum(one.true_screws for one in outcomes),
        pairing=pairing,
        tip_mm=_block([error.tip_mm for error in right_errors]),
        center_mm=_block([error.center_mm for error in right_errors]),
        head_mm=_block([error.head_mm for error in right_errors if error.head_mm is not None]),
        axis_deg=_block([error.axis_deg for error in right_errors]),
        roll_deg=_block([abs(error.roll_deg) for error in right_errors]),
        pre=_stage(outcomes, "pre"),
        post=_stage(outcomes, "post"),
        seconds=_block([one.seconds for one in outcomes]),
    )
    return SummaryFile(
        format="screwpose-summary/1",
        sets={study.set_name: SetSummary(methods={study.method: method})},
        seed=study.seed,
        started=study.started,
        machine=f"{platform.machine()}, {cpu_count()} cores, {platform.system()}, Python {platform.python_version()}",
        software=Software(name="screwpose", version=__version__),
    )


def _block(values: Sequence[float]) -> Quantiles | None:
    return Quantiles(**quantiles(values)) if values else None


def _stage(outcomes: Sequence[CaseOutcome], stage: str) -> StageQuantiles | None:
    """Dice and loss of the true combinations, chosen or not."""
    scores = [
        getattr(combination, stage)
        for one in outcomes
        for combination in one.answer.combinations
        if same_pairs(combination.pairs, [dict(screw.labels) for screw in one.truth.screws])
        and getattr(combination, stage) is not None
    ]
    if not scores:
        return None
    return StageQuantiles(dice=_block([s.dice for s in scores]), loss=_block([s.loss for s in scores]))


def case_rows(study: Study) -> list[dict[str, Any]]:
    """One row a screw, for screws.csv: the case, what was answered, and the errors."""
    rows = []
    for one in study.outcomes:
        common = {
            "set": study.set_name,
            "method": study.method,
            "case": one.answer.case,
            "status": one.answer.status,
            "pairing_status": one.answer.pairing.status,
            "pairing_right": one.right,
            "probability": one.answer.pairing.probability,
            "dice_pre_right": _dice_names_the_truth(one, "pre"),
            "dice_post_right": _dice_names_the_truth(one, "post"),
            "seconds": one.seconds,
        }
        if not one.answer.screws:
            rows.append(common)
        for screw, error in zip(one.answer.screws, one.errors, strict=True):
            row = {**common, "screw": " ".join(screw.labels.values()), "screw_status": screw.status}
            if error is not None:
                errors = asdict(error)
                shift, turn = errors.pop("shift_in_cad_mm"), errors.pop("turn_in_cad_deg")
                row |= errors
                row |= {f"shift_{axis}_mm": float(value) for axis, value in zip("xyz", shift, strict=True)}
                row |= {f"turn_{axis}_deg": float(value) for axis, value in zip("xyz", turn, strict=True)}
            rows.append(row)
    return rows


def _dice_names_the_truth(one: CaseOutcome, stage: str) -> bool | None:
    """Whether the combination with the higher Dice is the true one; None where there was no choice."""
    chosen = None if one.answer.pairing.chosen_by is None else getattr(one.answer.pairing.chosen_by, stage)
    if chosen is None or len(one.answer.combinations) < 2:
        return None
    true = [dict(screw.labels) for screw in one.truth.screws]
    return next(same_pairs(c.pairs, true) for c in one.answer.combinations if c.id == chosen)


def spread(values: Sequence[float]) -> tuple[float, float, float]:
    """Median, p90 and worst of absolute values."""
    magnitude = np.abs(np.asarray(values, dtype=np.float64))
    return float(np.median(magnitude)), float(np.quantile(magnitude, 0.9)), float(magnitude.max())
