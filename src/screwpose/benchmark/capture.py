"""From how far off does a registration find home? Starts that are displaced from the truth by known amounts."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from screwpose._types import FloatArray
from screwpose.benchmark.bootstrap import wilson_interval
from screwpose.benchmark.measures_blocks import SUCCESS_AXIS_DEG, SUCCESS_TIP_MM
from screwpose.benchmark.scoring import pose_error
from screwpose.benchmark.sets_base import BenchmarkSet, case_seed
from screwpose.files.case import Case, read_case
from screwpose.files.schema import TruthFile
from screwpose.files.truth import read_truth
from screwpose.geometry import rigid
from screwpose.implants.model import Implant
from screwpose.registration import Progress, SearchOptions, register

Registration = Callable[[Case, Sequence[str], Sequence[FloatArray], SearchOptions], Sequence[FloatArray]]
"""``registration(case, models, starts, options) -> poses``: world_from_cad (4, 4) of each screw, start and end."""

# A search whose bounds do not hold the truth cannot find it; the paper gives none.
_REACH = 1.25
_FACES = 1000


@dataclass(frozen=True)
class CaptureTrial:
    """One screw of one case, started off by `shift_mm` and `turn_deg`; where it ended."""

    set_name: str
    index: int
    shift_mm: float
    turn_deg: float
    tip_mm: float
    axis_deg: float

    @property
    def is_success(self) -> bool:
        """Whether it ended within the benchmark's bounds of success."""
        return self.tip_mm <= SUCCESS_TIP_MM and self.axis_deg <= SUCCESS_AXIS_DEG


@dataclass(frozen=True)
class CaptureRate:
    """How many screws came home from one displacement; the interval (Wilson, 95 %) counts cases."""

    set_name: str
    shift_mm: float
    turn_deg: float
    cases: int
    screws: int
    successes: int
    rate: float
    low: float
    high: float
    median_tip_mm: float
    median_axis_deg: float


def by_evolution(
    case: Case, models: Sequence[str], starts: Sequence[FloatArray], options: SearchOptions
) -> Sequence[FloatArray]:
    """The paper's registration: differential evolution of all screws together, by the silhouettes' gradient loss."""
    from screwpose.implants.mesh import reduced
    from screwpose.similarity import SceneEngine, make_target

    cameras = {name: view.camera for name, view in case.views.items()}
    targets = {
        name: make_target(view.radiograph.pixels, view.mask, np.zeros_like(view.mask))
        for name, view in case.views.items()
    }
    meshes = [reduced(case.implants[model].mesh, _FACES) for model in models]
    engine = SceneEngine(cameras, targets, meshes)

    def losses(world_from_cad: FloatArray) -> FloatArray:
        return np.asarray(engine.scores(world_from_cad).loss.mean(axis=1))

    return register([case.implants[model] for model in models], starts, losses, options).world_from_cad


def by_thickness(
    case: Case, models: Sequence[str], starts: Sequence[FloatArray], options: SearchOptions
) -> Sequence[FloatArray]:
    """This program's registration: Gauss-Newton on thickness, coarse to fine, here without marks to hold it.

    Its grids and steps are its own: `options` has nothing to say.
    """
    from screwpose.pairing.thickness import prepare_thickness
    from screwpose.registration.recipe import fit_by_thickness
    from screwpose.registration.thickness_fit import Body

    del options
    centers = [rigid.transform(pose, case.implants[one].center_mm) for one, pose in zip(models, starts, strict=True)]
    thickness = prepare_thickness(case, np.mean(centers, axis=0))
    bodies = [Body(case.implants[one], thickness.meshes[one], None) for one in models]
    return fit_by_thickness(bodies, starts, thickness.targets, thickness.stages).world_from_cad


REGISTRATIONS: dict[str, Registration] = {"evolution": by_evolution, "thickness": by_thickness}


def displaced(
    implant: Implant, world_from_cad: FloatArray, shift_mm: float, turn_deg: float, rng: np.random.Generator
) -> FloatArray:
    """A pose (4, 4) off by exactly a shift of the centre and a turn about it, both in directions drawn evenly."""
    shift, axis = (direction / np.linalg.norm(direction) for direction in rng.normal(size=(2, 3)))
    center = rigid.transform(world_from_cad, implant.center_mm)
    turn = rigid.from_rotation_about(rigid.exp_rotation(np.radians(turn_deg) * axis), center)
    moved = turn @ world_from_cad
    moved[:3, 3] += shift_mm * shift
    return np.asarray(moved)


def bounds_for(options: SearchOptions, shift_mm: float, turn_deg: float) -> SearchOptions:
    """The search's options with bounds wide enough that the truth lies within them."""
    return replace(
        options,
        max_shift_mm=max(options.max_shift_mm, _REACH * shift_mm),
        max_tilt_deg=max(options.max_tilt_deg, _REACH * turn_deg),
        max_roll_deg=max(options.max_roll_deg, _REACH * turn_deg),
    )


def capture_trials(
    cases: BenchmarkSet,
    shifts_mm: Sequence[float],
    turns_deg: Sequence[float],
    count: int,
    seed: int,
    options: SearchOptions | None = None,
    registration: Registration = by_evolution,
    progress: Progress | None = None,
) -> list[CaptureTrial]:
    """Register the first `count` cases of a set from every displacement of a grid.

    All screws of a case that two views or more show are displaced, each in directions of its own, and registered
    together. The directions of a case are the same whatever else is on the grid.
    """
    trials: list[CaptureTrial] = []
    grid = list(product(shifts_mm, turns_deg))
    count = count if cases.size is None else min(count, cases.size)
    for index in range(count):
        with TemporaryDirectory(prefix="screwpose-capture-") as scratch:
            path = cases.make(seed, index, Path(scratch) / "case")
            case, truth = read_case(path), read_truth(path.parent)
        for number, (shift_mm, turn_deg) in enumerate(grid):
            if progress is not None:
                done = (index + number / len(grid)) / count
                progress(done, f"{cases.name} {index + 1} of {count}: {shift_mm:g} mm, {turn_deg:g} deg")
            own_seed = case_seed(f"{cases.name}-capture", seed, index)
            ends = _registered(case, truth, shift_mm, turn_deg, own_seed, options or SearchOptions(), registration)
            trials += [CaptureTrial(cases.name, index, shift_mm, turn_deg, *end) for end in ends]
    return trials


def _registered(
    case: Case,
    truth: TruthFile,
    shift_mm: float,
    turn_deg: float,
    seed: int,
    options: SearchOptions,
    registration: Registration,
) -> Iterator[tuple[float, float]]:
    """Tip error, mm, and axis error, degrees, of each screw at the end."""
    screws = [one for one in truth.screws if len(one.labels) > 1 and one.model in case.implants]
    rng = np.random.default_rng(seed)
    implants = [case.implants[one.model] for one in screws]
    poses = [np.array(one.world_from_cad) for one in screws]
    starts = [displaced(implant, pose, shift_mm, turn_deg, rng) for implant, pose in zip(implants, poses, strict=True)]
    search = replace(bounds_for(options, shift_mm, turn_deg), seed=seed)
    ends = registration(case, [one.model for one in screws], starts, search) if screws else []
    for implant, end, pose in zip(implants, ends, poses, strict=True):
        error = pose_error(implant, np.asarray(end), pose)
        yield error.tip_mm, error.axis_deg


def capture_rates(trials: Sequence[CaptureTrial]) -> list[CaptureRate]:
    """The trials of each set and displacement, summed up in the order of their first."""
    groups: dict[tuple[str, float, float], list[CaptureTrial]] = {}
    for one in trials:
        groups.setdefault((one.set_name, one.shift_mm, one.turn_deg), []).append(one)
    rates = []
    for (set_name, shift_mm, turn_deg), some in groups.items():
        cases = len({one.index for one in some})
        successes = sum(one.is_success for one in some)
        # The screws of a case are registered together and share their luck.
        low, high = wilson_interval(cases * successes / len(some), cases)
        rates.append(
            CaptureRate(
                set_name,
                shift_mm,
                turn_deg,
                cases,
                len(some),
                successes,
                successes / len(some),
                low,
                high,
                float(np.median([one.tip_mm for one in some])),
                float(np.median([one.axis_deg for one in some])),
            )
        )
    return rates


def capture_plot(rates: Sequence[CaptureRate]) -> bytes:
    """Success against the shift, a line for each turn and set, with its intervals: a PNG."""
    import io

    from matplotlib.figure import Figure

    names = list(dict.fromkeys(one.set_name for one in rates))
    figure = Figure(figsize=(1.2 + 4.4 * len(names), 4.0))
    figure.set_layout_engine("constrained")
    grid = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for axes, name in zip(grid, names, strict=True):
        for turn_deg in dict.fromkeys(one.turn_deg for one in rates):
            some = sorted((one for one in rates if (one.set_name, one.turn_deg) == (name, turn_deg)), key=_shift_of)
            spread = [[one.rate - one.low for one in some], [one.high - one.rate for one in some]]
            x, y = [one.shift_mm for one in some], [one.rate for one in some]
            axes.errorbar(x, y, spread, marker="o", markersize=4, capsize=2, label=f"{turn_deg:g} degrees")
        cases = max(one.cases for one in rates if one.set_name == name)
        axes.set_title(f"{name}, {cases} cases", fontsize=10)
        axes.set_xlabel("start off by, mm")
        axes.set_ylim(-0.03, 1.05)
        axes.grid(alpha=0.3)
    grid[0].set_ylabel(f"screws that end within {SUCCESS_TIP_MM:g} mm and {SUCCESS_AXIS_DEG:g} degree")
    grid[0].legend(title="and turned by", fontsize=8, title_fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    return buffer.getvalue()


def _shift_of(one: CaptureRate) -> float:
    return one.shift_mm
