"""How fast are masks, losses and whole cases? Ours, its rivals and the lower bound, side by side in one run.

    python benchmarks/engines.py -o engines-out
    python benchmarks/engines.py --quick -o engines-quick

All take turns in every round, so that a busy moment meets them alike; the figures are medians over the rounds, with
quartiles, and ratios are taken within a round. Each rival's mask is held against ours before it is timed. Rays need
`embreex`, VTK needs `vtk`; without them their rows say so. Writes engines.csv, engines.md and engines.png; Ctrl-C
writes what is done so far.
"""

import argparse
import os
import platform
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter, process_time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import engine_rivals as rivals
import numpy as np
from rich.console import Console
from rich.progress import Progress

from screwpose.benchmark import get_set
from screwpose.benchmark.rows import to_csv
from screwpose.files import ensure_can_write_folder, read_case, write_bytes, write_text
from screwpose.report.meshes import make_folder
from screwpose.solve import SolveOptions, solve

_OURS = "ours, 2,000 faces"
_CLOCKS: dict[str, Callable[[], float]] = {"wall": perf_counter, "cpu": process_time}
_LEAST_SECONDS = 0.02  # a turn is repeated until it takes so long: the clock and a task switch are then small beside it
_TRIANGLES = (1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000, 200_000)
_PIXELS = (512, 768, 1024, 1536, 2048, 3000)
_SCREWS = (1, 2, 4, 8, 12, 16)

Job = tuple[Callable[[], object], int]
"""What is timed, and how many evaluations (one scene in one view, or one case) it holds."""


@dataclass(frozen=True)
class Plan:
    """How it is timed: how many turns of everything, small or not, and by which clock what runs on one thread."""

    rounds: int
    quick: bool
    clock: Callable[[], float]


@dataclass(frozen=True)
class Timed:
    """One figure.

    Parameters
    ----------
    block : what was compared: `scene`, `lengths`, `cases`, or the curve's name.
    at : where on the curve.
    us, us_low, us_high : median and quartiles of the time for one evaluation, microseconds.
    ratio, ratio_low, ratio_high : of it to the block's first job, in the same round.
    same : the Dice coefficient of its mask with ours; NaN where nothing is painted.
    """

    block: str
    at: float
    job: str
    us: float
    us_low: float
    us_high: float
    ratio: float
    ratio_low: float
    ratio_high: float
    rounds: int
    same: float = float("nan")


def take_turns(
    block: str,
    at: float,
    jobs: dict[str, Job],
    rounds: int,
    same: dict[str, float] | None = None,
    clock: Callable[[], float] = perf_counter,
) -> list[Timed]:
    """Time jobs A, B, C, A, B, C, ...; the first is what the others are compared with."""
    repeats = {}
    for name, (work, _) in jobs.items():
        work()  # compiled, and in the cache
        begin = clock()
        work()
        repeats[name] = max(1, round(_LEAST_SECONDS / max(clock() - begin, 1e-6)))
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, (work, evaluations) in jobs.items():
            begin = clock()
            for _ in range(repeats[name]):
                work()
            seconds[name].append((clock() - begin) / (repeats[name] * evaluations))
    first = np.array(seconds[next(iter(jobs))])
    made = []
    for name, values in seconds.items():
        low, middle, high = (float(q) for q in np.percentile(values, [25, 50, 75]) * 1e6)
        ratios = [float(q) for q in np.percentile(np.array(values) / first, [25, 50, 75])]
        made.append(
            Timed(
                block,
                at,
                name,
                middle,
                low,
                high,
                ratios[1],
                ratios[0],
                ratios[2],
                rounds,
                (same or {}).get(name, np.nan),
            )
        )
    return made


def ours(scene: rivals.Scene, threads: int = 1) -> Job:
    """Mask, loss and Dice of all candidates in one call."""
    engine = scene.engine(threads)
    return lambda: engine.scores(scene.poses), len(scene.poses)


def one_by_one(scene: rivals.Scene) -> Job:
    """The same, a call a candidate."""
    engine = scene.engine()
    count = len(scene.poses)
    return lambda: [engine.scores(scene.poses[k : k + 1]) for k in range(count)], count


def painted(scene: rivals.Scene, draw: Callable[[int], rivals.BoolArray]) -> Job:
    """A rival's mask, scored as the paper's method scores it: one candidate a turn, another each time."""
    turn = iter(range(10**9))
    return lambda: rivals.scored(scene, draw(next(turn) % len(scene.poses))), 1


def compare_scene(plan: Plan, notes: list[str]) -> Iterator[list[Timed]]:
    """Two screws at 1024 x 1024, by everything there is."""
    full, small = rivals.make_scene(None), rivals.make_scene(2000)
    notes.append(
        f"Full CAD: {len(full.meshes[0].faces)} faces a screw; reduced: {len(small.meshes[0].faces)}. Pixels of the "
        f"first candidate in which our mask is not the reference's: {rivals.differs_from_reference(small)} reduced"
        + ("." if plan.quick else f", {rivals.differs_from_reference(full)} full.")
    )
    drawn: dict[str, Callable[[int], rivals.BoolArray]] = {
        "OpenCV, a call a triangle, full CAD": rivals.opencv_triangles(full),
        "OpenCV, one fillPoly call, full CAD": rivals.opencv_one_call(full),
        "bit rows face by face, full CAD": rivals.bit_rows_by_face(full),
    }
    if find_spec("embreex"):
        drawn["Embree rays, full CAD"] = rivals.EmbreeRays(full).mask
    else:
        notes.append("Embree rays: skipped, `embreex` is not installed.")
    if find_spec("vtk"):
        drawn["VTK off-screen, full CAD"] = rivals.VtkRender(full).mask
    else:
        notes.append("VTK off-screen: skipped, `vtk` is not installed.")
    same = {name: rivals.agreement(full, draw) for name, draw in drawn.items()}
    bound, bound_full = rivals.LowerBound(small), rivals.LowerBound(full)
    jobs: dict[str, Job] = {
        _OURS: ours(small),
        "ours, 2,000 faces, a call each": one_by_one(small),
        "ours, full CAD": ours(full),
        "lower bound, 2,000 faces": (bound, len(small.poses)),
        "lower bound, full CAD": (bound_full, len(full.poses)),
        **{name: painted(full, draw) for name, draw in drawn.items()},
    }
    yield take_turns("scene", 0, jobs, plan.rounds, same, plan.clock)


def compare_lengths(plan: Plan, notes: list[str]) -> Iterator[list[Timed]]:
    """Path lengths through one screw."""
    scene = rivals.make_scene(2000 if plan.quick else None)
    jobs: dict[str, Job] = {"ours, path lengths": (lambda: rivals.our_lengths(scene, 0), 1)}
    if find_spec("embreex"):
        rays = rivals.EmbreeRays(scene)
        off_mm = np.abs(rays.lengths(0) - rivals.our_lengths(scene, 0))
        notes.append(
            f"Path lengths by Embree: {np.mean(off_mm > 0.05):.2%} of the window's pixels more than 0.05 mm off."
        )
        jobs["Embree rays, path lengths"] = (lambda: rays.lengths(0), 1)
    yield take_turns("lengths", 0, jobs, max(3, plan.rounds // 3), clock=plan.clock)


def along_triangles(plan: Plan, _: list[str]) -> Iterator[list[Timed]]:
    """Against the number of faces a screw."""
    for faces in (1000, 2000) if plan.quick else _TRIANGLES:
        scene = rivals.make_scene(faces, candidates=8 if plan.quick or faces > 20_000 else 40)
        jobs = {
            "ours": ours(scene),
            "lower bound": (rivals.LowerBound(scene), len(scene.poses)),
            "bit rows face by face": painted(scene, rivals.bit_rows_by_face(scene)),
            "OpenCV, a call a triangle": painted(scene, rivals.opencv_triangles(scene)),
        }
        yield take_turns("triangles", len(scene.meshes[0].faces), jobs, plan.rounds, clock=plan.clock)


def along_pixels(plan: Plan, _: list[str]) -> Iterator[list[Timed]]:
    """Against the side of the image."""
    for pixels in (256, 512) if plan.quick else _PIXELS:
        yield beside_rivals("pixels", pixels, plan, pixels=pixels)


def along_screws(plan: Plan, _: list[str]) -> Iterator[list[Timed]]:
    """Against the number of screws in the image."""
    for screws in (1, 2) if plan.quick else _SCREWS:
        yield beside_rivals("screws", screws, plan, screws=screws)


def beside_rivals(block: str, at: float, plan: Plan, **of_scene: int) -> list[Timed]:
    """Screws of 2,000 faces by us, the lower bound and OpenCV."""
    scene = rivals.make_scene(2000, candidates=8 if plan.quick else 40, **of_scene)
    jobs = {
        "ours": ours(scene),
        "lower bound": (rivals.LowerBound(scene), len(scene.poses)),
        "OpenCV, a call a triangle": painted(scene, rivals.opencv_triangles(scene)),
    }
    return take_turns(block, at, jobs, plan.rounds, clock=plan.clock)


def along_threads(plan: Plan, _: list[str]) -> Iterator[list[Timed]]:
    """A population of 300 candidates on one thread and on more."""
    cores = os.cpu_count() or 1
    scene = rivals.make_scene(2000, candidates=20 if plan.quick else 300)
    counts = sorted({1, 2, *(n for n in (4, 8, 16) if n <= cores)})
    found = take_turns("threads", 0, {f"{n}": ours(scene, n) for n in counts}, plan.rounds)
    yield [Timed(**{**asdict(one), "at": float(one.job), "job": "ours"}) for one in found]


def whole_cases(set_name: str, seed: int, count: int, rounds: int, with_opencv: bool) -> Iterator[list[Timed]]:
    """Both combinations of a simulated case placed, scored, registered and judged."""
    for index in range(count):
        with tempfile.TemporaryDirectory() as folder:
            case = read_case(get_set(set_name).make(seed, index, Path(folder)))
            jobs: dict[str, Job] = {
                "default": (lambda case=case: solve(case, SolveOptions()), 1),
                "paper, bit rows": (lambda case=case: solve(case, SolveOptions(method="paper", engine="bitrows")), 1),
            }
            found = take_turns("cases", index, jobs, rounds)
            if with_opencv:  # minutes: once, with a default case right before and after it
                before = _seconds(jobs["default"])
                paper = _seconds((lambda case=case: solve(case, SolveOptions(method="paper")), 1))
                after = _seconds(jobs["default"])
                ratios = sorted((paper / before, paper / after))
                middle = 2.0 * paper / (before + after)
                found.append(
                    Timed("cases", index, "paper, OpenCV", *[paper * 1e6] * 3, middle, ratios[0], ratios[1], rounds=1)
                )
            yield found


def _seconds(job: Job) -> float:
    begin = perf_counter()
    job[0]()
    return perf_counter() - begin


def markdown(found: list[Timed], notes: list[str]) -> str:
    """All figures as tables, the machine and the notes above them."""
    lines = [
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, numba {version('numba')}, "
        f"OpenCV {cv2.__version__}, screwpose {version('screwpose')}.",
        *notes,
    ]
    for block in dict.fromkeys(one.block for one in found):
        lines += [
            "",
            f"## {block}",
            "",
            "| at | job | us | quartiles | times the first | quartiles | mask, Dice with ours |",
        ]
        lines.append("| ---: | :--- | ---: | ---: | ---: | ---: | ---: |")
        for one in found:
            if one.block == block:
                same = "" if np.isnan(one.same) else f"{one.same:.4f}"
                cells = (
                    f"{one.at:g}",
                    one.job,
                    f"{one.us:,.1f}",
                    f"{one.us_low:,.1f} to {one.us_high:,.1f}",
                    f"{one.ratio:,.3g}",
                    f"{one.ratio_low:,.3g} to {one.ratio_high:,.3g}",
                    same,
                )
                lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def plot(found: list[Timed]) -> bytes:
    """The curves, as PNG."""
    import io

    from matplotlib.figure import Figure

    axes_of = {"triangles": "faces a screw", "pixels": "pixels a side", "screws": "screws", "threads": "threads"}
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    grid = figure.subplots(2, 2)
    styles = {
        "ours": ("#0072B2", "o"),
        "lower bound": ("#666666", "v"),
        "bit rows face by face": ("#009E73", "s"),
        "OpenCV, a call a triangle": ("#D55E00", "^"),
    }
    for axes, (block, label) in zip(grid.flat, axes_of.items(), strict=True):
        of_block = [one for one in found if one.block == block]
        for job, (color, marker) in styles.items():
            points = [one for one in of_block if one.job == job]
            if points:
                at = [one.at for one in points]
                axes.fill_between(at, [p.us_low for p in points], [p.us_high for p in points], color=color, alpha=0.2)
                axes.plot(at, [one.us for one in points], marker=marker, color=color, label=job)
        if of_block:
            axes.set_xscale("log", base=10 if block == "triangles" else 2)
            if block == "threads":
                axes.set_ylim(0.0, 1.2 * max(one.us_high for one in of_block))
            else:
                axes.set_yscale("log")
            ticks = sorted({one.at for one in of_block})
            if block != "triangles":
                axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
                axes.minorticks_off()
        axes.set_xlabel(label)
        axes.set_ylabel("µs for mask, loss and Dice of one view")
        axes.grid(visible=True, alpha=0.3)
    lines, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside upper center", ncols=len(labels), fontsize=9)
    with io.BytesIO() as stream:
        figure.savefig(stream, format="png", dpi=110)
        return stream.getvalue()


def main(arguments: list[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15, help="turns of everything")
    parser.add_argument("--set", default="pairs", help="where whole cases come from")
    parser.add_argument("--seed", type=int, default=7, help="of the whole cases")
    parser.add_argument("--cases", type=int, default=3, help="whole cases; 0: none")
    parser.add_argument(
        "--no-opencv-cases", action="store_true", help="leave out `paper` with OpenCV: a minute or two a case"
    )
    parser.add_argument(
        "--clock",
        choices=sorted(_CLOCKS),
        default="wall",
        help="cpu: where other work runs; threads and cases are wall",
    )
    parser.add_argument("--quick", action="store_true", help="small and few: to see that everything runs")
    parser.add_argument("-o", "--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    ensure_can_write_folder(given.out, marker="engines.csv")
    cv2.setNumThreads(1)
    plan = Plan(1 if given.quick else given.rounds, given.quick, _CLOCKS[given.clock])
    notes: list[str] = []
    parts = (compare_scene, compare_lengths, along_triangles, along_pixels, along_screws, along_threads)
    blocks = [(part.__name__, part(plan, notes)) for part in parts]
    if given.cases and not given.quick:
        cases = whole_cases(given.set, given.seed, given.cases, max(3, plan.rounds // 3), not given.no_opencv_cases)
        blocks.append(("whole_cases", cases))
    folder = make_folder(given.out)
    console = Console()
    found: list[Timed] = []
    try:
        with Progress(console=Console(stderr=True)) as bar:
            task = bar.add_task("engines", total=len(blocks))
            for name, timings in blocks:
                bar.update(task, description=name.replace("_", " "))
                for timed in timings:
                    found += timed
                    write_text(folder / "engines.csv", to_csv([asdict(one) for one in found]))
                    for one in timed:
                        console.print(
                            f"{one.block} {one.at:g}: {one.job}: {one.us:,.1f} us, {one.ratio:,.3g} times the first",
                            highlight=False,
                        )
                bar.advance(task)
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        write_text(folder / "engines.md", markdown(found, notes))
        write_bytes(folder / "engines.png", plot(found))


if __name__ == "__main__":
    main()
