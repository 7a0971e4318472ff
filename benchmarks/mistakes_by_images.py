"""The mistakes of a person, in whole cases: how often is each named, and is anything sure and wrong?

    python benchmarks/mistakes_by_images.py --set pairs,hard --count 20 --seed 1

As the third table of `pairing_by_landmarks.py`, but the X-rays are rendered and asked too: a mistake that the marks do
not betray may show when the models are registered.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from landmark_scenes import Scene
from pairing_by_landmarks import MISTAKES, wilson
from rich.console import Console
from rich.progress import track

from screwpose.benchmark import get_set
from screwpose.benchmark.sets_base import case_seed
from screwpose.files.case import Case, read_case
from screwpose.files.truth import read_truth
from screwpose.report.tables import Column, Table
from screwpose.simulation.detector import Detector
from screwpose.solve import solve

_NOISE_PX = 1.5  # of a screw that is marked once more


def made(name: str, seed: int, index: int) -> tuple[Case, Scene]:
    """A case of a set, with its X-rays, and who is marked under which name."""
    with TemporaryDirectory(prefix="mistakes-") as scratch:
        path = get_set(name).make(seed, index, Path(scratch) / "case")
        case, truth = read_case(path), read_truth(path.parent / "truth.json")
    labels = tuple(screw.labels for screw in truth.screws)
    cameras = {view: one.camera for view, one in case.views.items()}
    return case, Scene(name, case_seed(name, seed, index), (), cameras, Detector(), labels, {}, _NOISE_PX)


def main() -> None:
    """Print a row for each set and mistake."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--set", default="pairs,hard", help="sets, with commas between")
    arguments.add_argument("--count", type=int, default=20, help="cases of each set")
    arguments.add_argument("--seed", type=int, default=1, help="of the cases")
    given = arguments.parse_args()
    columns = [Column("set", "Set", is_number=False), Column("mistake", "Mistake", is_number=False)]
    columns += [
        Column(word, f"{word}, %", is_number=False)
        for word in ("named", "confident", "pairing confident and wrong", "result confident and wrong")
    ]
    rows = []
    for name in given.set.split(","):
        seen: dict[str, list[tuple[bool, bool, bool, bool]]] = {what: [] for what in MISTAKES}
        for index in track(range(given.count), name, console=Console(stderr=True)):
            right_case, scene = made(name, given.seed, index)
            for what, make in MISTAKES.items():
                case, names = make(right_case, scene, np.random.default_rng([scene.seed, 7]))
                answer = solve(case).answer
                words = " ".join(answer.warnings)
                is_right = {frozenset(pair.items()) for pair in answer.pairing.pairs} == scene.truth
                is_sure = answer.pairing.status == "confident"
                is_named = any(one in words for one in names) if names else answer.status != "confident"
                seen[what].append(
                    (is_named, is_sure, is_sure and not is_right, answer.status == "confident" and not is_right)
                )
        for what, found in seen.items():
            counts = np.array(found).sum(axis=0)
            rows.append((name, what, *(wilson(int(one), len(found)) for one in counts)))
    title = (
        f"{given.count} cases of each set, seed {given.seed}; without a mistake, 'named' counts what is not confident"
    )
    Console().print(Table(title, tuple(columns), tuple(rows)).to_markdown(), markup=False, soft_wrap=True)


if __name__ == "__main__":
    main()
