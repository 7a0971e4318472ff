"""From how far off does the registration find home? Starts displaced from the truth by known amounts.

    python benchmarks/capture_range.py --set paper --count 10 --seed 2026 -o capture-out

Writes trials.csv (one row a screw and displacement), capture_range.csv (one row a displacement) and capture_range.png.
"""

import argparse
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from screwpose.benchmark import get_set
from screwpose.benchmark.capture import REGISTRATIONS, capture_plot, capture_rates, capture_trials
from screwpose.benchmark.rows import to_csv
from screwpose.files import ensure_can_write_folder, write_bytes, write_text
from screwpose.registration import SearchOptions
from screwpose.report.meshes import make_folder


def numbers(text: str) -> list[float]:
    """``0,2,5`` as numbers."""
    return [float(part) for part in text.split(",")]


def main(arguments: list[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", default="paper", help="sets of cases, with commas between them")
    parser.add_argument("--count", type=int, default=5, help="cases of each set")
    parser.add_argument("--seed", type=int, default=1, help="of the cases; development seeds are below 1000")
    parser.add_argument("--shifts", type=numbers, default=[0.0, 1.0, 2.0, 5.0, 10.0, 20.0], help="mm, as in 0,2,5")
    parser.add_argument("--turns", type=numbers, default=[0.0, 5.0, 15.0], help="degrees, as in 0,5")
    parser.add_argument("--registration", choices=sorted(REGISTRATIONS), default="evolution", help="what searches")
    parser.add_argument("--generations", type=int, default=SearchOptions().generations, help="of the evolution")
    parser.add_argument("-o", "--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    ensure_can_write_folder(given.out, marker="capture_range.csv")
    trials = []
    with Progress(console=Console(stderr=True)) as bar:
        for name in given.set.split(","):
            task = bar.add_task(name, total=1.0)
            trials += capture_trials(
                get_set(name),
                given.shifts,
                given.turns,
                given.count,
                given.seed,
                SearchOptions(generations=given.generations),
                REGISTRATIONS[given.registration],
                lambda fraction, what, task=task: bar.update(task, completed=fraction, description=what),
            )
            bar.update(task, completed=1.0, description=name)
    rates = capture_rates(trials)
    folder = make_folder(given.out)
    write_text(folder / "trials.csv", to_csv([{**asdict(one), "success": one.is_success} for one in trials]))
    write_text(folder / "capture_range.csv", to_csv([asdict(one) for one in rates]))
    write_bytes(folder / "capture_range.png", capture_plot(rates))
    console = Console()
    for one in rates:
        console.print(
            f"{one.set_name}: {one.shift_mm:g} mm, {one.turn_deg:g} deg: {one.successes} of {one.screws} screws "
            f"({one.low:.0%} to {one.high:.0%}), tip median {one.median_tip_mm:.2f} mm",
            highlight=False,
        )


if __name__ == "__main__":
    main()
