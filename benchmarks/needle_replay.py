"""The paper's experiment in simulation: needles say which screw is which, and screwpose says it without them.

    python benchmarks/needle_replay.py --count 20 --seed 2026

As in the paper, a needle is laid along one tower after the other, and both X-rays are taken again. The pairing is then
known from the needles alone: what a needle adds to an X-ray is found as a line, and the screw whose marks lie along it,
no further away than a tower is thick, is the one that carries it. No truth file is read for that. Afterwards the cases
are solved from their X-rays without needles, by each method, and compared.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from rich.console import Console
from rich.progress import track

from screwpose._types import FloatArray
from screwpose.benchmark.sets_base import case_seed
from screwpose.files.case import Annotation, Case, read_case
from screwpose.files.truth import read_truth
from screwpose.images import read_radiograph
from screwpose.report.tables import Column, Table
from screwpose.simulation.imperfections import Imperfections
from screwpose.simulation.scenes import simulate_scene
from screwpose.simulation.scenes_options import SceneOptions
from screwpose.simulation.writing import write_case
from screwpose.solve import Method, SolveOptions, solve

_METHODS: tuple[Method, ...] = ("default", "epipolar", "paper")
_NOISE_SIGMAS, _SMOOTHED_PX = 6.0, 2.0
_SHORTEST_PX = 40.0
_REACH_MM, _OFF_MM = 9.0, 2.0  # half a tower and a needle; and by how much a line through two marks may miss
_DECIDED = 9.0  # by which the next best reading has to fit worse
_TURN_DEG = 1.0  # of a line through two marks, 200 px apart


@dataclass(frozen=True)
class Line:
    """What a needle adds to an X-ray: a point on it and its direction, px."""

    point: FloatArray
    along: FloatArray


def needle_in(with_needle: FloatArray, without: FloatArray) -> Line | None:
    """The line that a needle adds; None where nothing long and thin is new.

    Parameters
    ----------
    with_needle, without : (rows, columns), greys, metal bright.
    """
    added = cv2.GaussianBlur((with_needle - without).astype(np.float32), (0, 0), _SMOOTHED_PX)
    spread = 1.4826 * float(np.median(np.abs(added - np.median(added))))
    is_new = (added > np.median(added) + _NOISE_SIGMAS * spread).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(is_new, connectivity=8)
    best: tuple[float, Line] | None = None
    for part in range(1, count):
        if stats[part, cv2.CC_STAT_AREA] < _SHORTEST_PX:
            continue
        rows, columns = np.nonzero(labels == part)
        points = np.stack([columns, rows], axis=1).astype(np.float64)
        middle = points.mean(axis=0)
        _, sizes, directions = np.linalg.svd(points - middle, full_matrices=False)
        long, wide = np.sqrt(12.0 / len(points)) * sizes  # of a bar that is spread alike
        if long >= _SHORTEST_PX and long > 4.0 * wide and (best is None or long > best[0]):
            best = (long, Line(middle, directions[0]))
    return None if best is None else best[1]


def misfit(line: Line, mark: Annotation, mm_per_px: float) -> float:
    """How badly a screw, by its two marks, goes with a needle along its tower: squared deviations over variances."""
    shank = mark.center_px - mark.tip_px
    shank = shank / np.linalg.norm(shank)
    turn_deg = float(np.degrees(np.arcsin(np.clip(abs(shank[0] * line.along[1] - shank[1] * line.along[0]), 0.0, 1.0))))
    # From where the needle is, the screw's line passes at:
    away = line.point - mark.center_px
    distance_mm = mm_per_px * abs(float(shank[0] * away[1] - shank[1] * away[0]))
    return (turn_deg / _TURN_DEG) ** 2 + (max(distance_mm - _REACH_MM, 0.0) / _OFF_MM) ** 2


def paired_by_needles(case: Case) -> tuple[set[frozenset[tuple[str, str]]], float] | None:
    """The pairs that the needles show, and by how much the next best reading fits worse; None where one is not seen.

    Each X-ray with a needle is of one screw, and no two are of the same: so in each view the needles are dealt to the
    screws in the way that fits best.
    """
    folder = case.path.parent
    acquisitions = json.loads((folder / "needles.json").read_text(encoding="utf-8"))["acquisitions"]
    found: list[dict[str, str]] = [{} for _ in acquisitions]
    margin = np.inf
    for name, view in case.views.items():
        marks = case.annotations[name]
        polarity = "metal-bright" if view.radiograph.metal_bright_in_file else "metal-dark"
        lines = []
        for acquisition in acquisitions:
            image = read_radiograph(folder / acquisition["folder"] / f"{name.lower()}.png", polarity)
            lines.append(needle_in(image.pixels, view.radiograph.pixels))
        seen = [line for line in lines if line is not None]
        if len(seen) < len(lines):
            return None
        mm_per_px = view.camera.mm_per_px_at(np.zeros(3))
        costs = np.array([[misfit(line, mark, mm_per_px) for mark in marks] for line in seen])
        ways = sorted(permutations(range(len(marks)), len(seen)), key=lambda way: _sum(costs, way))
        for one, mark in zip(found, ways[0], strict=True):
            one[name] = marks[mark].label
        if len(ways) > 1:
            margin = min(margin, _sum(costs, ways[1]) - _sum(costs, ways[0]))
    return {frozenset(one.items()) for one in found}, float(margin)


def _sum(costs: FloatArray, way: Sequence[int]) -> float:
    return float(sum(costs[row, column] for row, column in enumerate(way)))


@dataclass(frozen=True)
class Replay:
    """One case: what the needles say, whether that is true, and what each method answered."""

    by_needles: set[frozenset[tuple[str, str]]] | None
    margin: float
    is_true: bool
    agrees: dict[str, bool]
    statuses: dict[str, str]


def replayed(seed: int, scratch: Path, methods: Sequence[Method]) -> Replay:
    """Make a case with needles, read them, and solve it without."""
    scene = simulate_scene(SceneOptions(needles=True), Imperfections(landmark_noise_px=1.5), seed)
    path = write_case(scene, scratch / "case")
    case = read_case(path)
    read = paired_by_needles(case)
    answers = {method: solve(case, SolveOptions(method=method)).answer for method in methods}
    found = None if read is None else read[0]
    paired = {method: {frozenset(pair.items()) for pair in one.pairing.pairs} for method, one in answers.items()}
    truth = read_truth(path.parent / "truth.json")
    true_pairs = {frozenset(screw.labels.items()) for screw in truth.screws if len(screw.labels) > 1}
    return Replay(
        found,
        np.nan if read is None else read[1],
        found == true_pairs,
        {method: paired[method] == (true_pairs if found is None else found) for method in methods},
        {method: one.pairing.status for method, one in answers.items()},
    )


def main() -> None:
    """Print a line a method."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--count", type=int, default=20, help="cases; the paper had 5")
    arguments.add_argument("--seed", type=int, default=1, help="of the cases")
    arguments.add_argument(
        "--methods", default="default,epipolar", help="with commas between; paper takes a minute a case"
    )
    given = arguments.parse_args()
    methods = [one for one in _METHODS if one in given.methods.split(",")]
    seen = []
    for index in track(range(given.count), console=Console(stderr=True)):
        with TemporaryDirectory(prefix="needles-") as scratch:
            seen.append(replayed(case_seed("needles", given.seed, index), Path(scratch), methods))
    read = [one for one in seen if one.margin >= _DECIDED]
    Console().print(
        f"The needles tell the pairing in {len(read)} of {len(seen)} cases, and it is the true one in "
        f"{sum(one.is_true for one in read)} of them. In {sum(np.isnan(one.margin) for one in seen)} a needle is not "
        f"seen; in {sum(one.margin < _DECIDED for one in seen)} it may be of either screw.",
        soft_wrap=True,
    )
    columns = [Column("method", "Method", is_number=False)]
    columns += [Column(word, word) for word in ("cases", "as the needles say", "confident", "confident and otherwise")]
    rows = []
    for method in methods:
        sure = [one for one in read if one.statuses[method] == "confident"]
        rows.append(
            (
                method,
                len(read),
                sum(one.agrees[method] for one in read),
                len(sure),
                sum(not one.agrees[method] for one in sure),
            )
        )
    title = f"Pairing without the needles, seed {given.seed}"
    Console().print(Table(title, tuple(columns), tuple(rows)).to_markdown(), markup=False, soft_wrap=True)


if __name__ == "__main__":
    main()
