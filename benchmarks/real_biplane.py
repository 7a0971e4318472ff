"""Far starts on real biplane X-rays: do they come home, do they agree, and does the outline lie on the edges?

    SCREWPOSE_DATA=../shared/data python benchmarks/real_biplane.py --seeds 1,2,3 -o real-biplane

Sixteen pairs of one knee implant, whose pose an expert has found. For every pair and seed it is started from landmarks
marked to 2 and to 5 px with the roll unknown within 30 degrees, from 10 mm and 10 degrees off, and from 35 and 35. No
true pose exists: what the starts are compared with is, for each pair, the end that explains most; whether that is
right, an edge finder that is no part of the solver says, and the expert. The paper's search on silhouettes runs beside
ours. Writes trials.csv, edges.csv, real_biplane.md and an overlay of every pair asked for.
"""

import argparse
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np
from outline_edges import edge_distances, outline
from rich.console import Console
from rich.progress import Progress

from screwpose._types import BoolArray, FloatArray, ImageArray
from screwpose.benchmark import get_set
from screwpose.benchmark.rows import to_csv
from screwpose.files import ensure_can_write_folder, read_case, write_bytes, write_text
from screwpose.files.truth import read_truth
from screwpose.geometry import Camera, rigid
from screwpose.geometry.triangulation import triangulate
from screwpose.images import log_image
from screwpose.implants import Implant, Mesh
from screwpose.implants.reduction import closed, reduced_to
from screwpose.registration import SearchOptions, align, register, turned
from screwpose.registration.basin import FarXrays, Xray, prepare_far, register_from
from screwpose.registration.thickness_fit import Body
from screwpose.report.meshes import make_folder
from screwpose.similarity import SceneEngine, Target, make_target

HOME_MM, HOME_DEG = 0.3, 0.5
_FACES, _FEW_FACES = 12_000, 1000


@dataclass(frozen=True)
class Start:
    """How a pair is started, and how far off that may be."""

    name: str
    reach_mm: float
    reach_deg: float
    roll_deg: float | None = None
    mark_px: float | None = None


STARTS = (
    Start("landmarks, 2 px", 4.0, 6.0, 33.0, 2.0),
    Start("landmarks, 5 px", 8.0, 12.0, 33.0, 5.0),
    Start("10 mm, 10 deg", 10.0, 10.0),
    Start("35 mm, 35 deg", 35.0, 35.0),
)


@dataclass(frozen=True, eq=False)
class Pair:
    """One pair, ready."""

    name: str
    cameras: dict[str, Camera]
    greys: dict[str, ImageArray]
    regions: dict[str, BoolArray]
    implant: Implant
    body: Body
    few: Mesh
    xrays: FarXrays
    paper: dict[str, Target]
    expert: FloatArray


@dataclass(frozen=True)
class Trial:
    """Where one start ended."""

    pair: str
    start: str
    seed: int
    method: str
    start_mm: float
    start_deg: float
    energy: float
    starts: int
    apart_mm: float
    apart_deg: float
    sure: bool
    seconds: float
    pose: tuple[float, ...]
    off_mm: float = float("nan")
    off_deg: float = float("nan")
    expert_mm: float = float("nan")
    expert_deg: float = float("nan")

    @property
    def world_from_cad(self) -> FloatArray:
        """(4, 4)."""
        return np.array(self.pose).reshape(4, 4)

    @property
    def is_home(self) -> bool:
        """Whether it ended where the pair's best end is."""
        return self.off_mm < HOME_MM and self.off_deg < HOME_DEG


@dataclass(frozen=True)
class EdgeRow:
    """Edge distances of one pose in one view, px."""

    pair: str
    pose: str
    view: str
    median_px: float
    p90_px: float
    shift_u_px: float
    shift_v_px: float


def load(index: int, folder: Path) -> Pair:
    """One pair of the set `real`."""
    made = get_set("real").make(1, index, folder)
    case = read_case(made)
    expert = np.array(read_truth(folder / "truth.json").screws[0].world_from_cad)
    (name,) = case.implants
    implant = case.implants[name]
    body = Body(implant, closed(reduced_to(implant.mesh, _FACES)), None)
    views = {view: Xray(log_image(one.radiograph.pixels), one.mask, one.camera) for view, one in case.views.items()}
    nothing = {view: np.zeros_like(one.mask) for view, one in case.views.items()}
    return Pair(
        case.id,
        {view: one.camera for view, one in case.views.items()},
        {view: one.radiograph.pixels for view, one in case.views.items()},
        {view: one.mask for view, one in case.views.items()},
        implant,
        body,
        reduced_to(implant.mesh, _FEW_FACES),
        prepare_far(views, rigid.transform(expert, implant.center_mm)),
        {view: make_target(one.radiograph.pixels, one.mask, nothing[view]) for view, one in case.views.items()},
        expert,
    )


def started(pair: Pair, start: Start, rng: np.random.Generator) -> FloatArray:
    """A starting pose: the expert's landmarks, marked with noise, or the expert's pose, moved by the reach."""
    implant = pair.implant
    if start.mark_px is not None and start.roll_deg is not None:
        ends = rigid.transform(pair.expert, np.stack([implant.tip_mm, implant.center_mm]))
        cameras = list(pair.cameras.values())
        marks = np.stack([camera.project(ends) for camera in cameras])
        marks = marks + rng.normal(0.0, start.mark_px, marks.shape)
        tip, center = (triangulate(cameras, marks[:, index]).point_in_world_mm for index in range(2))
        placed = align(implant, tip, center)
        return _rolled_near(implant, placed, pair.expert, np.radians(rng.uniform(-30.0, 30.0)))
    turn, shift = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    center = rigid.transform(pair.expert, implant.center_mm)
    rotation = rigid.exp_rotation(np.radians(start.reach_deg) * turn)
    pose = rigid.from_rotation_about(rotation, center) @ pair.expert
    pose[:3, 3] += start.reach_mm * shift
    return pose


def _rolled_near(implant: Implant, pose: FloatArray, expert: FloatArray, roll_rad: float) -> FloatArray:
    """The pose turned about its axis to the expert's roll, and by so much more."""
    axis, wanted = pose[:3, :3] @ implant.axis, expert[:3, :3] @ implant.axis
    level = rigid.rotation_between(wanted, axis) @ expert[:3, :3]
    own = float(rigid.log_rotation(level @ pose[:3, :3].T) @ axis)
    return turned(implant, pose, own + roll_rad)


def apart(implant: Implant, one: FloatArray, two: FloatArray) -> tuple[float, float]:
    """Distance of the centres, mm, and angle of the turn between them, degrees."""
    shift = rigid.transform(one, implant.center_mm) - rigid.transform(two, implant.center_mm)
    return float(np.linalg.norm(shift)), float(
        np.degrees(np.linalg.norm(rigid.log_rotation(one[:3, :3] @ two[:3, :3].T)))
    )


def ours(pair: Pair, start: Start, seed: int, pose: FloatArray) -> Trial:
    """Register by `register_from`."""
    began = perf_counter()
    fit = register_from(
        [pair.body], [pose], pair.xrays, start.reach_mm, start.reach_deg,
        roll_deg=start.roll_deg, silhouette_meshes=[pair.few], seed=seed,
    )  # fmt: skip
    seconds = perf_counter() - began
    end = tuple(fit.world_from_cad[0].ravel().tolist())
    energy = float(fit.energies.mean())
    off = apart(pair.implant, pose, pair.expert)
    return Trial(
        pair.name, start.name, seed, "ours", *off, energy, fit.starts, fit.apart_mm, fit.apart_deg, fit.is_sure,
        seconds, end,
    )  # fmt: skip


def papers(pair: Pair, start: Start, seed: int, pose: FloatArray) -> Trial:
    """Register by differential evolution on silhouettes and the grey image, as the paper does."""
    turn_deg = 1.1 * start.reach_deg
    roll_deg = 1.1 * max(start.reach_deg, start.roll_deg or 0.0)
    options = SearchOptions(1.1 * start.reach_mm, turn_deg, roll_deg, seed=seed)
    engine = SceneEngine(pair.cameras, pair.paper, [pair.few])
    began = perf_counter()
    found = register([pair.implant], [pose], lambda scenes: engine.scores(scenes).loss.mean(axis=1), options)
    seconds = perf_counter() - began
    end = tuple(found.world_from_cad[0].ravel().tolist())
    nothing = float("nan")
    off = apart(pair.implant, pose, pair.expert)
    return Trial(pair.name, start.name, seed, "paper", *off, nothing, 1, nothing, nothing, False, seconds, end)


def judged(pair: Pair, trials: Sequence[Trial]) -> tuple[list[Trial], FloatArray]:
    """The trials of a pair with their distances from its best end, which is given back too."""
    best = max((trial for trial in trials if trial.method == "ours"), key=lambda trial: trial.energy).world_from_cad
    told = []
    for trial in trials:
        off = apart(pair.implant, trial.world_from_cad, best)
        expert = apart(pair.implant, trial.world_from_cad, pair.expert)
        told.append(replace(trial, off_mm=off[0], off_deg=off[1], expert_mm=expert[0], expert_deg=expert[1]))
    return told, best


def edges(pair: Pair, name: str, pose: FloatArray) -> list[EdgeRow]:
    """Edge distances of the full mesh in every view."""
    rows = []
    for view, camera in pair.cameras.items():
        points, normals = outline(camera, pair.implant.mesh, pose, pair.greys[view].shape)
        found = edge_distances(pair.greys[view], pair.regions[view], points, normals)
        u, v = found.shift_px.tolist()
        rows.append(EdgeRow(pair.name, name, view, found.median_px, found.p90_px, u, v))
    return rows


def from_expert(pair: Pair, best: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Best end minus expert: (3,) mm along the views' axes (first, second, normal to both), (3,) deg about CAD axes."""
    first, second = (camera.viewing_axis_in_world for camera in pair.cameras.values())
    normal = np.cross(first, second)
    axes = np.stack([first, second, normal / np.linalg.norm(normal)])
    shift = rigid.transform(best, pair.implant.center_mm) - rigid.transform(pair.expert, pair.implant.center_mm)
    return axes @ shift, np.degrees(rigid.log_rotation(pair.expert[:3, :3].T @ best[:3, :3]))


def overlay(pair: Pair, best: FloatArray) -> bytes:
    """Both views, three times as large, with the outlines: ours green, the expert's magenta."""
    tiles = []
    for view, camera in pair.cameras.items():
        grey = np.clip(255.0 * (1.0 - pair.greys[view]), 0, 255).astype(np.uint8)
        points = {name: outline(camera, pair.implant.mesh, pose, grey.shape)[0] for name, pose in
                  (("expert", pair.expert), ("best", best))}  # fmt: skip
        low = np.floor(points["best"].min(axis=0) - 25).astype(int).clip(0)
        high = np.ceil(points["best"].max(axis=0) + 25).astype(int)
        part = cv2.resize(grey[low[1] : high[1], low[0] : high[0]], None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
        tile = cv2.cvtColor(part, cv2.COLOR_GRAY2BGR)
        for name, colour in (("expert", (255, 0, 255)), ("best", (0, 255, 0))):
            for u, v in (points[name] - low + 0.5) * 3 - 0.5:
                cv2.circle(tile, (round(u), round(v)), 1, colour, -1)
        cv2.putText(tile, f"{pair.name} {view}", (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 200, 255), 2)
        tiles.append(tile)
    height = max(tile.shape[0] for tile in tiles)
    padded = [cv2.copyMakeBorder(t, 0, height - t.shape[0], 0, 6, cv2.BORDER_CONSTANT) for t in tiles]
    return bytes(cv2.imencode(".jpg", np.hstack(padded), [cv2.IMWRITE_JPEG_QUALITY, 85])[1])


_STARTS_HEAD = (
    "| start | method | home | sure, not home | unsure, home | spread mm, median/p90/worst | deg | starts | s |",
    "|---|---|---|---|---|---|---|---|---|",
)
_EDGES_HEAD = (
    "| pose | view | median of pairs | worst pair | p90, median of pairs | mean shift u, v |",
    "|---|---|---|---|---|---|",
)
_EXPERT_HEAD = (
    "| | first view's axis | second view's axis | normal to both | largest of a pair |",
    "|---|---|---|---|---|",
)
_STUDY = (
    "The study, from starts of its own: 16 of 16 from landmarks, 25 of 25 from 10 mm, 13 to 15 of 16 from 35 mm;",
    "spread over starts 0.01/0.02/0.04 mm and 0.01/0.03/0.12 deg. The paper's spread is of all its ends.",
)
_STUDY_EDGES = "The study, with an edge finder of its own: 0.34 and 0.37 px, the expert's pose 0.87 and 0.61."


def page(trials: Sequence[Trial], rows: Sequence[EdgeRow], shifts: FloatArray, turns: FloatArray) -> str:
    """The report.

    Parameters
    ----------
    shifts, turns : (pairs, 3) each, as `from_expert` has them.
    """
    pairs = len({trial.pair for trial in trials})
    home = f"Home: within {HOME_MM} mm and {HOME_DEG} degrees of the pair's best end."
    lines = ["# Far starts on real biplane X-rays", "", f"{pairs} pairs. {home}", "", *_STARTS_HEAD]
    for name in dict.fromkeys(trial.start for trial in trials):
        of_start = [trial for trial in trials if trial.start == name]
        methods = dict.fromkeys(trial.method for trial in of_start)
        lines += [_starts_row([trial for trial in of_start if trial.method == method]) for method in methods]
    lines += ["", *_STUDY, "", "## Outline to edge, px", "", *_EDGES_HEAD]
    for pose in dict.fromkeys(row.pose for row in rows):
        of_pose = [row for row in rows if row.pose == pose]
        lines += [
            _edges_row([row for row in of_pose if row.view == view]) for view in dict.fromkeys(r.view for r in rows)
        ]
    lines += ["", _STUDY_EDGES, "", "## Best end minus expert", "", *_EXPERT_HEAD]
    for name, values in (("mm", shifts), ("deg, about the CAD's x, y, z", turns)):
        cells = [f"{m:+.2f} +- {s:.2f}" for m, s in zip(values.mean(axis=0), values.std(axis=0), strict=True)]
        lines.append(f"| {name} | {' | '.join(cells)} | {np.linalg.norm(values, axis=1).max():.2f} |")
    return "\n".join(lines) + "\n"


def _starts_row(some: Sequence[Trial]) -> str:
    """One kind of start, by one method; the spread of ours is of the ends that came home."""
    home = [trial for trial in some if trial.is_home]
    cells = [some[0].start, some[0].method, f"{len(home)} of {len(some)}"]
    if some[0].method == "ours":
        cells += [str(sum(one.sure and not one.is_home for one in some)), str(sum(not one.sure for one in home))]
    else:
        cells, home = [*cells, "-", "-"], list(some)
    cells += [_three([one.off_mm for one in home]), _three([one.off_deg for one in home])]
    cells += [f"{np.mean([one.starts for one in some]):.1f}", f"{np.median([one.seconds for one in some]):.2f}"]
    return f"| {' | '.join(cells)} |"


def _edges_row(some: Sequence[EdgeRow]) -> str:
    medians = [row.median_px for row in some]
    p90 = np.median([row.p90_px for row in some])
    u, v = (float(np.mean(shifts)) for shifts in ([row.shift_u_px for row in some], [row.shift_v_px for row in some]))
    numbers = f"{np.median(medians):.2f} | {max(medians):.2f} | {p90:.2f} | {u:+.2f}, {v:+.2f}"
    return f"| {some[0].pose} | {some[0].view} | {numbers} |"


def _three(values: Sequence[float]) -> str:
    if not values:
        return "-"
    return "/".join(f"{value:.3f}" for value in (*np.percentile(values, [50, 90]), max(values)))


def main(arguments: list[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="1", help="with commas between them")
    parser.add_argument("--pairs", type=int, default=16, help="the first so many")
    parser.add_argument("--overlays", default="0,9,14", help="pairs that are drawn")
    parser.add_argument("--no-paper", action="store_true", help="leave the paper's search out")
    parser.add_argument("-o", "--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    ensure_can_write_folder(given.out, marker="trials.csv")
    seeds = [int(seed) for seed in given.seeds.split(",")]
    drawn = {int(index) for index in given.overlays.split(",") if index}
    folder = make_folder(given.out)
    trials: list[Trial] = []
    rows: list[EdgeRow] = []
    differences = []
    with Progress(console=Console(stderr=True)) as bar, TemporaryDirectory() as scratch:
        task = bar.add_task("pairs", total=given.pairs)
        for index in range(given.pairs):
            pair = load(index, Path(scratch) / str(index))
            if index == 0:  # what is compiled for the first time is not timed
                ours(pair, STARTS[2], 0, pair.expert)
                papers(pair, STARTS[0], 0, pair.expert)
            found = []
            for start in STARTS:
                for seed in seeds:
                    rng = np.random.default_rng([seed, index, STARTS.index(start)])
                    pose = started(pair, start, rng)
                    found.append(ours(pair, start, seed, pose))
                    if not given.no_paper:
                        found.append(papers(pair, start, seed, pose))
            told, best = judged(pair, found)
            trials += told
            rows += edges(pair, "ours", best) + edges(pair, "expert", pair.expert)
            near = [one for one in told if one.method == "paper" and one.start == STARTS[0].name]
            rows += [row for trial in near[:1] for row in edges(pair, "paper", trial.world_from_cad)]
            differences.append(from_expert(pair, best))
            if index in drawn:
                write_bytes(folder / f"overlay-{index}.jpg", overlay(pair, best))
            shifts, turns = (np.array(part) for part in zip(*differences, strict=True))
            write_text(folder / "trials.csv", to_csv([_row(one) for one in trials]))
            write_text(folder / "edges.csv", to_csv([asdict(one) for one in rows]))
            write_text(folder / "real_biplane.md", page(trials, rows, shifts, turns))
            bar.advance(task)
    Console(soft_wrap=True).print(
        (folder / "real_biplane.md").read_text(encoding="utf-8"), highlight=False, markup=False
    )


def _row(trial: Trial) -> dict[str, str | int | float | bool]:
    row = {**asdict(trial), "home": trial.is_home}
    row["pose"] = f"[{', '.join(f'{value:.9g}' for value in trial.pose)}]"
    return row


if __name__ == "__main__":
    main()
