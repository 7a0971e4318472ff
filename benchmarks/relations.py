"""What do wrong cameras cost, and what does refining them give back? Distances and angles between two screws.

    python benchmarks/relations.py --count 16 --seed 1

Two screws with towers are X-rayed once a case; the case then reports matrices that are wrong by more and more. Each is
solved with the cameras held, with the sigmas from which their errors were drawn, and with `auto`; `--paper` adds the
paper's method. The sigmas are the amounts of the dials: LAT's turn and shift, both views' focal length and principal
point.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from rich.console import Console
from rich.progress import track

from screwpose._types import FloatArray
from screwpose.benchmark.judging import relation_records
from screwpose.benchmark.scoring import screw_errors
from screwpose.files.case import Case, read_case
from screwpose.files.schema import TruthFile
from screwpose.files.truth import read_truth
from screwpose.geometry.correction import CameraSigma
from screwpose.report.tables import Column, Table
from screwpose.simulation.imperfections import Imperfections, reported_cameras
from screwpose.simulation.scenes import simulate_scene
from screwpose.simulation.scenes_options import SceneOptions
from screwpose.simulation.writing import write_case
from screwpose.solve import SolveOptions, solve

SCENE = SceneOptions(lengths_mm=(30.0, 60.0), diameters_mm=(4.5, 8.5), angle_deg=(75.0, 105.0), overlap_lat=(0.0, 1.0))
LEVELS = {  # rotation deg, translation mm, focal %, principal point px
    "exact": CameraSigma(0.0, 0.0, 0.0, 0.0),
    "0.2 deg, 0.25 mm, 1 px": CameraSigma(0.2, 0.25, 0.0, 1.0),
    "0.5 deg, 1 mm, 0.2 %, 2 px": CameraSigma(0.5, 1.0, 0.2, 2.0),
    "1 deg, 2.5 mm, 0.5 %, 5 px": CameraSigma(1.0, 2.5, 0.5, 5.0),
    "2 deg, 5 mm, 1 %": CameraSigma(2.0, 5.0, 1.0, 0.0),
    "2 deg, 5 mm, 1 %, 10 px": CameraSigma(2.0, 5.0, 1.0, 10.0),
}


@dataclass(frozen=True)
class Outcome:
    """One case by one method; NaN where it gave no answer."""

    distance_mm: float
    angle_deg: float
    tip_mm: float
    refused: bool
    refined: bool
    seconds: float


def made_case(seed: int) -> tuple[Case, TruthFile]:
    """A case whose matrices are exact."""
    with TemporaryDirectory(prefix="relations-") as scratch:
        path = write_case(simulate_scene(SCENE, Imperfections(landmark_noise_px=1.5), seed), Path(scratch) / "case")
        return read_case(path), read_truth(path.parent / "truth.json")


def wrong_case(case: Case, truth: TruthFile, amounts: CameraSigma, seed: int) -> Case:
    """The same with matrices that are wrong by exactly these amounts, in drawn directions."""
    middle: FloatArray = np.mean([np.array(screw.world_from_cad)[:3, 3] for screw in truth.screws], axis=0)
    dials = Imperfections(
        rotation_error_deg=amounts.rotation_deg,
        translation_error_mm=amounts.translation_mm,
        focal_error_percent=amounts.focal_percent,
        principal_error_px=amounts.principal_point_px,
    )
    cameras = {name: view.camera for name, view in case.views.items()}
    reported = reported_cameras(cameras, dict.fromkeys(cameras, middle), dials, seed)
    views = {name: replace(view, camera=reported[name], sigma=amounts) for name, view in case.views.items()}
    return replace(case, views=views)


def solved(case: Case, truth: TruthFile, options: SolveOptions) -> Outcome:
    """Solve and measure."""
    start = perf_counter()
    answer = solve(case, options).answer
    seconds = perf_counter() - start
    relations = relation_records(answer, truth, case.implants)
    tips = [error.tip_mm for _, error in screw_errors(answer, truth, case.implants) if error is not None]
    distance, angle = (relations[0].distance_mm, relations[0].angle_deg) if relations else (np.nan, np.nan)
    refused = answer.status == "refused"
    return Outcome(abs(distance), abs(angle), max(tips, default=np.nan), refused, answer.cameras is not None, seconds)


def spread(values: Sequence[float]) -> str:
    """Median / 90th percentile / worst."""
    known = np.array([value for value in values if np.isfinite(value)])
    if not len(known):
        return ""
    return " / ".join(f"{value:.3f}" for value in (np.median(known), np.quantile(known, 0.9), known.max()))


def main() -> None:
    """Print a row for each amount of error and method."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--count", type=int, default=16, help="cases")
    arguments.add_argument("--seed", type=int, default=1, help="of the cases")
    arguments.add_argument(
        "--levels", type=int, nargs="*", default=list(range(len(LEVELS))), help="how wrong the matrices are; 0: exact"
    )
    arguments.add_argument("--paper", action="store_true", help="the paper's method too, which takes a minute a case")
    given = arguments.parse_args()
    methods = {
        "cameras held": SolveOptions(cameras="off"),
        "sigmas given": SolveOptions(),
        "auto": SolveOptions(cameras="auto"),
    }
    if given.paper:
        methods["paper"] = SolveOptions(method="paper", cameras="off")
    found: dict[tuple[str, str], list[Outcome]] = {}
    for index in track(range(given.count), console=Console(stderr=True)):
        seed = int(np.random.SeedSequence([given.seed, index]).generate_state(1)[0])
        case, truth = made_case(seed)
        for level, amounts in [list(LEVELS.items())[k] for k in given.levels]:
            reported = wrong_case(case, truth, amounts, seed)
            for method, options in methods.items():
                asked = replace(reported, views={n: replace(v, sigma=None) for n, v in reported.views.items()})
                asked = reported if method == "sigmas given" else asked
                found.setdefault((level, method), []).append(solved(asked, truth, options))
    columns = [Column("level", "P is wrong by", is_number=False), Column("method", "Method", is_number=False)]
    words = ("distance, mm", "angle, deg", "worse tip, mm", "refused", "refined", "seconds")
    columns += [Column(word, word, is_number=False) for word in words]
    rows = [
        (
            level,
            method,
            spread([one.distance_mm for one in outcomes]),
            spread([one.angle_deg for one in outcomes]),
            spread([one.tip_mm for one in outcomes]),
            str(sum(one.refused for one in outcomes)),
            str(sum(one.refined for one in outcomes)),
            f"{np.median([one.seconds for one in outcomes]):.1f}",
        )
        for (level, method), outcomes in found.items()
    ]
    title = f"{given.count} cases of two screws with towers, seed {given.seed}: median / 90th percentile / worst"
    Console().print(Table(title, tuple(columns), tuple(rows)).to_markdown(), markup=False, soft_wrap=True)


if __name__ == "__main__":
    main()
