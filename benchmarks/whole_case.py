"""How long does a whole case take, where does the time go, and how much memory? `default`, in process, warm.

    python benchmarks/whole_case.py -o whole-case-out
    python benchmarks/whole_case.py --seed 7 --cases 5 --curve 2000 10000 50000 -o out
    python benchmarks/whole_case.py --seed 7 --cases 5 --parts paper --opencv -o out
    python benchmarks/whole_case.py --seed 7 --cases 2 --parts screws -o out

Two-screw cases of the set `pairs`, one case of twelve screws, and one pair of screws at ever more CAD triangles (the
models themselves, reduced or split). Every block runs in a process of its own, whose first solve is thrown away:
compiling, and what is kept of CAD models, are told apart as `first_s`. Reading is timed beside. The part `paper` sets
`default` against the paper's method, with its own optimiser's settings, on the same two-screw cases in one process:
case by case they take turns, with bit rows every round, and with OpenCV (a minute or more) once, between two of
`default`.
Writes whole_case.json and whole_case.md; development seeds are below 1000.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from screwpose.files import ensure_can_write_folder, write_text
from screwpose.files.case import Case
from screwpose.implants.model import Implant, Mesh

if TYPE_CHECKING:
    from engines import Timed

_CURVE = (2000, 5000, 10_000, 20_000, 50_000, 100_000, 200_000)
_SCREWS = 12
_MANY_SCREWS = (2, 4, 8, 12, 16)
_STEPS = {
    "read": "screwpose.files.case:read_case",
    "plausibility": "screwpose.solve:check_plausibility",
    "combinations": "screwpose.solve:ranked_pairings",
    "X-rays and search meshes": "screwpose.solve:gather",
    "placing": "screwpose.solve:place",
    "metal": "screwpose.solve:with_metal",
    "scores": "screwpose.solve:score",
    "scales and closed meshes": "screwpose.solve:prepare_thickness",
    "fit": "screwpose.solve:refine_by_thickness",
    "end": "screwpose.solve:settle_by_thickness",
    "answer": "screwpose.solve:answered",
}
"""The steps of a solve, and the functions that do them."""


class Watch:
    """Counts the seconds in functions that are named by module and name, wherever they are called from."""

    def __init__(self, steps: dict[str, str]) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        for step, place in steps.items():
            module_name, name = place.split(":")
            module = __import__(module_name, fromlist=[name])
            setattr(module, name, self._timed(step, getattr(module, name)))

    def _timed(self, step: str, function: Any) -> Any:
        def timed(*args: Any, **kwargs: Any) -> Any:
            start = perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds[step] += perf_counter() - start

        return timed


def with_triangles(mesh: Mesh, faces: int) -> Mesh:
    """The mesh reduced to about so many triangles, or split at the middles of its edges and then reduced."""
    import trimesh

    from screwpose.implants.mesh import reduced

    split = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    while len(split.faces) < faces:
        split = split.subdivide()
    whole = Mesh(np.array(split.vertices, dtype=np.float64), np.array(split.faces, dtype=np.int64))
    return whole if len(whole.faces) <= faces else reduced(whole, faces)


def recut(case: Case, faces: int) -> Case:
    """The case with models of about so many triangles."""

    def cut(implant: Implant) -> Implant:
        return replace(implant, mesh=with_triangles(implant.mesh, faces))

    return replace(case, implants={name: cut(implant) for name, implant in case.implants.items()})


def measured(paths: list[str], rounds: int, faces: int | None) -> dict[str, Any]:
    """Solve cases again and again in this process; what the parent asks a fresh one for."""
    from screwpose import solve as solving
    from screwpose.files import case as files

    watch = Watch(_STEPS)
    records = []
    first_s: float | None = None
    for path in paths:
        for turn in range(rounds + (first_s is None)):
            watch.seconds.clear()
            start = perf_counter()
            case = files.read_case(path)
            read_s = perf_counter() - start
            if faces is not None:
                case = recut(case, faces)
            start = perf_counter()
            result = solving.solve(case, solving.SolveOptions())
            solve_s = perf_counter() - start
            if first_s is None:
                first_s = solve_s
                continue
            steps = {step: watch.seconds[step] for step in _STEPS if step != "read"}
            records.append(
                {
                    "case": Path(path).name,
                    "turn": turn,
                    "read_s": read_s,
                    "solve_s": solve_s,
                    "steps_s": steps,
                    "status": result.answer.status,
                    "triangles": max(len(implant.mesh.faces) for implant in case.implants.values()),
                }
            )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    unit = 1 if sys.platform == "darwin" else 1024
    return {"first_s": first_s, "peak_mb": peak * unit / 1e6, "records": records}


def in_fresh_process(paths: list[Path], rounds: int, faces: int | None = None) -> dict[str, Any]:
    """`measured` where nothing was imported or allocated before."""
    request = json.dumps({"paths": [str(path) for path in paths], "rounds": rounds, "faces": faces})
    done = subprocess.run(
        [sys.executable, __file__, "--measure", request], capture_output=True, text=True, check=False, env=os.environ
    )
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def make_cases(folder: Path, seed: int, count: int) -> tuple[list[Path], Path]:
    """The pairs of a seed, and one case of twelve screws."""
    from screwpose.benchmark import get_set
    from screwpose.cli.making import make_scene

    pairs = [get_set("pairs").make(seed, index, folder / f"pair-{index}") for index in range(count)]
    return pairs, make_scene(folder / "twelve", seed, {"screws": _SCREWS})


def power_of_growth(screws: Sequence[float], seconds: Sequence[float]) -> float:
    """The slope of log seconds over log screws, by least squares."""
    return float(np.polyfit(np.log(screws), np.log(seconds), 1)[0])


def growth_page(blocks: dict[str, dict[str, Any]]) -> str:
    """By which power of the number of screws the medians grow."""
    found: dict[str, list[float]] = defaultdict(list)
    for count in _MANY_SCREWS:
        rows = blocks[f"{count} screws"]["records"]
        found["solve"].append(float(np.median([row["solve_s"] for row in rows])))
        pairing = [row["steps_s"]["plausibility"] + row["steps_s"]["combinations"] for row in rows]
        found["pairing by landmarks"].append(float(np.median(pairing)))
    lines = [f"| | {' | '.join(map(str, _MANY_SCREWS))} | power |", "| :--- |" + " ---: |" * (len(_MANY_SCREWS) + 1)]
    lines += [
        f"| {what} | {' | '.join(f'{one:.3f}' for one in seconds)} | {power_of_growth(_MANY_SCREWS, seconds):.2f} |"
        for what, seconds in found.items()
    ]
    return "\n".join(lines) + "\n"


def beside_paper(seed: int, count: int, rounds: int, with_opencv: bool) -> Iterator[list["Timed"]]:
    """Each case by `default` and by `paper`, in turns, here."""
    from engines import whole_cases  # with all of its rivals: not for the processes that are measured

    yield from whole_cases("pairs", seed, count, rounds, with_opencv)


def paper_page(timings: list["Timed"]) -> str:
    """`default` against `paper` as Markdown: each case, then the cases' ratios together."""
    lines = ["Seconds, and times `default` in the same round: median (quartiles).", ""]
    lines += ["| case | job | s | times `default` |", "| ---: | :--- | ---: | ---: |"]
    for one in timings:
        seconds = " to ".join(f"{us / 1e6:.2f}" for us in (one.us_low, one.us_high))
        times = f"{one.ratio:.1f} ({one.ratio_low:.1f} to {one.ratio_high:.1f})"
        lines.append(f"| {one.at:g} | {one.job} | {one.us / 1e6:.2f} ({seconds}) | {times} |")
    lines += ["", "All cases, of each its median:", "", "| job | s | times `default` |", "| :--- | :--- | :--- |"]
    for job in dict.fromkeys(one.job for one in timings):
        of_job = [one for one in timings if one.job == job]
        seconds = quartiles([one.us / 1e6 for one in of_job])
        lines.append(f"| {job} | {seconds} | {quartiles([one.ratio for one in of_job])} |")
    return "\n".join(lines) + "\n"


def quartiles(values: list[float]) -> str:
    """``median (lower to upper quartile; 90 %)``."""
    low, middle, high, late = np.percentile(values, [25, 50, 75, 90])
    return f"{middle:.2f} ({low:.2f} to {high:.2f}; p90 {late:.2f})"


def page(blocks: dict[str, dict[str, Any]], timings: list["Timed"], about: str) -> str:
    """Everything as Markdown."""
    parts = ["# Whole cases\n", f"{about}\n"]
    if blocks:
        parts.append(blocks_page(blocks))
    if all(f"{count} screws" in blocks for count in _MANY_SCREWS):
        parts += ["## Seconds by the number of screws\n", growth_page(blocks)]
    if timings:
        parts += ["## `default` against `paper`\n", paper_page(timings)]
    return "\n".join(parts)


def blocks_page(blocks: dict[str, dict[str, Any]]) -> str:
    """The blocks' times, steps and memory as Markdown."""
    lines = ["Seconds: median (quartiles; 90th percentile).", ""]
    lines += ["| | solve | read | first | peak, MB | status |", "| :--- | :--- | :--- | ---: | ---: | :--- |"]
    for name, block in blocks.items():
        rows = block["records"]
        status = ", ".join(sorted({row["status"] for row in rows}))
        lines.append(
            f"| {name} | {quartiles([row['solve_s'] for row in rows])} | {quartiles([row['read_s'] for row in rows])} "
            f"| {block['first_s']:.1f} | {block['peak_mb']:.0f} | {status} |"
        )
    lines += ["", "Where the time goes, medians in seconds:", ""]
    steps = [step for step in _STEPS if step != "read"]
    lines += [f"| | {' | '.join(steps)} |", "| :--- |" + " ---: |" * len(steps)]
    for name, block in blocks.items():
        medians = [np.median([row["steps_s"][step] for row in block["records"]]) for step in steps]
        lines.append(f"| {name} | {' | '.join(f'{one:.3f}' for one in medians)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("whole-case-out"))
    parser.add_argument("--seed", type=int, default=11, help="of the cases")
    parser.add_argument("--cases", type=int, default=6, help="of the set pairs")
    parser.add_argument("--rounds", type=int, default=3, help="how often each case is solved by each method")
    parser.add_argument("--curve", type=int, nargs="*", default=list(_CURVE), help="triangles a model; none: no curve")
    parser.add_argument(
        "--parts",
        nargs="+",
        choices=("blocks", "paper", "screws"),
        default=["blocks"],
        help="what is timed: by default, blocks",
    )
    parser.add_argument("--opencv", action="store_true", help="in the part `paper`, also with OpenCV: minutes a case")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measured(**json.loads(options.measure))))  # noqa: T201  (for the parent, not for people)
        return
    console = Console()
    ensure_can_write_folder(options.out)
    options.out.mkdir(parents=True, exist_ok=True)
    blocks: dict[str, dict[str, Any]] = {}
    timings: list[Timed] = []

    def keep() -> None:
        told = {"about": about, "blocks": blocks, "paper": [asdict(one) for one in timings]}
        write_text(options.out / "whole_case.json", json.dumps(told, indent=2))
        write_text(options.out / "whole_case.md", page(blocks, timings, about))

    about = (
        f"Seed {options.seed}, {options.cases} cases, {options.rounds} rounds; {platform.machine()}, {os.cpu_count()} "
        f"processors, Python {platform.python_version()}, numpy {version('numpy')}, numba {version('numba')}."
    )
    if "blocks" in options.parts:
        with tempfile.TemporaryDirectory() as folder:
            pairs, twelve = make_cases(Path(folder), options.seed, options.cases)
            plan: list[tuple[str, list[Path], int | None]] = [
                ("two screws", pairs, None),
                ("twelve screws", [twelve], None),
            ]
            plan += [(f"two screws, {faces:,} triangles a model", pairs[:1], faces) for faces in options.curve]
            for name, paths, faces in plan:
                blocks[name] = in_fresh_process(paths, options.rounds, faces)
                console.print(name, quartiles([row["solve_s"] for row in blocks[name]["records"]]))
                keep()
    if "screws" in options.parts:
        from screwpose.cli.making import make_scene

        with tempfile.TemporaryDirectory() as folder:
            for count in _MANY_SCREWS:
                given = {"screws": count}
                paths = [
                    make_scene(Path(folder) / f"{count}-{index}", options.seed + index, given)
                    for index in range(options.cases)
                ]
                blocks[f"{count} screws"] = in_fresh_process(paths, options.rounds)
                console.print(count, quartiles([row["solve_s"] for row in blocks[f"{count} screws"]["records"]]))
                keep()
    if "paper" in options.parts:
        for timed in beside_paper(options.seed, options.cases, options.rounds, options.opencv):
            timings += timed
            console.print(f"case {timed[0].at:g}:", *[f"{one.job} {one.us / 1e6:.2f} s;" for one in timed])
            keep()
    console.print(page(blocks, timings, about), markup=False)


if __name__ == "__main__":
    main()
