"""What is each part of the recipe worth? `default` with one part taken out at a time, on the same cases.

    python benchmarks/ablations.py --set pairs --count 20 --seed 7 -o ablations-out

Every row is the method with one of its constants or steps replaced, and nothing tuned again. Errors are those of
screws that are paired right; a case is good where all its screws are within 1 mm and 1 degree. Writes errors.csv and
ablations.md; the same seed gives the same cases. Development seeds are below 1000.
"""

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from rich.console import Console
from rich.progress import Progress

from screwpose._types import ImageArray
from screwpose.benchmark import get_set
from screwpose.benchmark.judging import implant_symmetry
from screwpose.benchmark.measures import roll_by_symmetry_deg
from screwpose.benchmark.rows import to_csv
from screwpose.benchmark.scoring import screw_errors
from screwpose.errors import ScrewposeError
from screwpose.files import ensure_can_write_folder, read_case, write_text
from screwpose.files.case import Case
from screwpose.files.schema import TruthFile
from screwpose.files.truth import read_truth
from screwpose.images import log_image
from screwpose.registration import SearchOptions
from screwpose.registration.recipe import STAGES, Stage, scaled_stages
from screwpose.report.meshes import make_folder
from screwpose.similarity.thickness import GradientTarget, make_gradient_target
from screwpose.solve import SolveOptions, solve

_FIT = "screwpose.pairing.thickness"
_MEASURE = "screwpose.similarity.thickness"
_GOOD_MM, _GOOD_DEG = 1.0, 1.0


@dataclass(frozen=True)
class Ablation:
    """One part taken out: attributes by the place they are looked up, `module:name`, or other options."""

    name: str
    replaced: tuple[tuple[str, object], ...] = ()
    options: SolveOptions | None = None

    @contextmanager
    def in_force(self) -> Iterator[SolveOptions]:
        with ExitStack() as stack:
            for place, value in self.replaced:
                stack.enter_context(patch(place.replace(":", "."), value))
            yield self.options or SolveOptions()


def with_stages(change: Callable[[Stage], Stage], stages: tuple[Stage, ...] = STAGES) -> tuple[tuple[str, object], ...]:
    """Other stages of the recipe."""
    return ((f"{_FIT}:scaled_stages", partial(scaled_stages, stages=tuple(change(stage) for stage in stages))),)


def parts() -> list[Ablation]:
    """The whole recipe first, then what is taken out of it."""
    return [
        Ablation("the whole recipe"),
        Ablation("no grid of directions", with_stages(lambda stage: replace(stage, tilts_deg=()))),
        Ablation("no grids of rolls", with_stages(lambda stage: replace(stage, rolls_deg=()))),
        Ablation("no second start of doubtful screws", with_stages(lambda stage: replace(stage, doubtful_below=0.0))),
        Ablation("no other turns tried", with_stages(lambda stage: replace(stage, other_ways=False))),
        Ablation("from half the resolution on", with_stages(_all_grids, STAGES[2:])),
        Ablation("marks are no prior", with_stages(lambda stage: replace(stage, mark_sigma_px=1e6))),
        Ablation("no sharp end", ((f"{_FIT}:_BETWEEN_ITERATIONS", 8), (f"{_FIT}:_SHARP_ITERATIONS", 0))),
        Ablation("sharp end on the log, not the greys", ((f"{_FIT}:make_gradient_target", _of_the_log),)),
        Ablation("sharp end with the mean left in", ((f"{_FIT}:_MEAN_PX", 0),)),
        Ablation("one gain and one noise everywhere", ((f"{_FIT}:make_gradient_target", _the_same_everywhere),)),
        Ablation("no robust weights", ((f"{_MEASURE}:CAUCHY", 1e6),)),
        Ablation("one saturating exponential", ((f"{_MEASURE}:SATURATION_MM", np.array([6.0], dtype=np.float32)),)),
        Ablation("whole meshes at all scales", ((f"{_FIT}:_COARSER_FACES", {}),)),
        Ablation("2,500 faces to the end", ((f"{_FIT}:_COARSER_FACES", {1: 2500}),)),
        Ablation("silhouettes in place of thickness", options=SolveOptions(refinement="evolution")),
        Ablation("marks alone", options=SolveOptions(search=SearchOptions(generations=0))),
    ]


def _of_the_log(pixels: ImageArray, *others: Any) -> GradientTarget:
    """The sharp target, which alone is local, of the log image."""
    target = make_gradient_target(pixels, *others)
    return make_gradient_target(log_image(pixels), *others) if target.is_local else target


def _the_same_everywhere(*arguments: Any) -> GradientTarget:
    """The sharp target with one gain and one noise."""
    return replace(make_gradient_target(*arguments), is_local=False)


def _all_grids(stage: Stage) -> Stage:
    """The first of fewer stages has all the grids."""
    if stage is not STAGES[2]:
        return stage
    return replace(stage, tilts_deg=STAGES[0].tilts_deg, rolls_deg=STAGES[0].rolls_deg)


@dataclass(frozen=True)
class Row:
    """One screw of one case under one ablation; NaN where it was not paired right, or not at all."""

    part: str
    case: str
    status: str
    tip_mm: float
    axis_deg: float
    roll_deg: float
    cpu_s: float


def measured(part: Ablation, name: str, case: Case, truth: TruthFile) -> list[Row]:
    """Solve a case with one part taken out."""
    start = process_time()
    with part.in_force() as options:
        try:
            answer = solve(case, options).answer
        except ScrewposeError as error:
            return [Row(part.name, name, f"error: {error}"[:80], np.nan, np.nan, np.nan, process_time() - start)]
    cpu_s = process_time() - start
    rows = []
    for screw, errors in screw_errors(answer, truth, case.implants):
        off = (np.nan, np.nan, np.nan)
        if errors is not None:
            roll_deg = roll_by_symmetry_deg(errors.roll_deg, implant_symmetry(case.implants[screw.model]))
            off = (errors.tip_mm, errors.axis_deg, np.nan if roll_deg is None else abs(roll_deg))
        rows.append(Row(part.name, name, screw.status, *off, cpu_s))
    return rows or [Row(part.name, name, answer.status, np.nan, np.nan, np.nan, cpu_s)]


def table(rows: list[Row], names: list[str]) -> str:
    """The Markdown table, a line a part."""
    lines = [
        "| Taken out | good cases, % | of the others flagged, % | tip, mm median / p90 / max | axis, deg | roll, deg | "
        "CPU s a case |",
        "| :--- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name in names:
        own = [row for row in rows if row.part == name]
        cases = sorted({row.case for row in own})
        bad, flagged, seconds = 0, 0, []
        for case in cases:
            screws = [row for row in own if row.case == case]
            seconds.append(screws[0].cpu_s)
            if not all(row.tip_mm < _GOOD_MM and row.axis_deg < _GOOD_DEG for row in screws):
                bad += 1
                flagged += any(row.status != "ok" for row in screws)
        errors = [spread([getattr(row, key) for row in own]) for key in ("tip_mm", "axis_deg", "roll_deg")]
        share = f"{100.0 * flagged / bad:.0f}" if bad else "-"
        lines.append(
            f"| {name} | {100.0 * (1.0 - bad / max(len(cases), 1)):.0f} | {share} | {' | '.join(errors)} | "
            f"{np.median(seconds):.2f} |"
        )
    return "\n".join(lines) + "\n"


def spread(values: list[float]) -> str:
    """Median, 90th percentile and largest."""
    known = np.array(values)[np.isfinite(values)]
    if not len(known):
        return "-"
    return " / ".join(f"{value:.3g}" for value in (np.median(known), np.percentile(known, 90), known.max()))


def main() -> None:
    """Read the command line, solve every case with every part taken out, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", default="pairs", help="where the cases come from")
    parser.add_argument("--count", type=int, default=20, help="cases")
    parser.add_argument("--seed", type=int, default=7, help="of the cases")
    parser.add_argument("--only", nargs="*", help="names, or beginnings of names, of parts")
    parser.add_argument("-o", "--out", "--output", type=Path, default=Path("ablations-out"), dest="output")
    options = parser.parse_args()
    chosen = [part for part in parts() if not options.only or part.name.startswith(tuple(options.only))]
    for wanted in options.only or ():
        if not any(part.name.startswith(wanted) for part in chosen):
            parser.error(f"--only {wanted!r}: no part begins so; there are: {'; '.join(part.name for part in parts())}")
    ensure_can_write_folder(options.output)
    console, rows = Console(stderr=True), []
    names = [part.name for part in chosen]
    with TemporaryDirectory() as scratch, Progress(console=console) as progress:
        job = progress.add_task("solving", total=options.count * len(chosen))
        for index in range(options.count):
            name = f"{options.set}-{index}"
            case = read_case(get_set(options.set).make(options.seed, index, Path(scratch) / name))
            truth = read_truth(Path(scratch) / name / "truth.json")
            for part in chosen:
                progress.update(job, description=f"case {index + 1}: {part.name}")
                rows += measured(part, name, case, truth)
                progress.advance(job)
            make_folder(options.output)
            write_text(options.output / "errors.csv", to_csv([asdict(row) for row in rows]))
            write_text(options.output / "ablations.md", table(rows, names))
    console.print((options.output / "ablations.md").read_text(), soft_wrap=True)


if __name__ == "__main__":
    main()
