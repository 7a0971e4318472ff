"""Registration from far off: silhouettes into the basin, thickness to the bottom, and two starts that must agree.

The thickness model comes home from a few mm and degrees; from further off it locks onto whatever edge is near. The
gradient correlation of a silhouette with the log image, at a quarter of the resolution, is blunt and wide, and costs
microseconds: differential evolution finds its valley. How well a pose explains the images tells a wrong valley. It
does not tell an unfinished fit, or a neighbouring valley that is nearly as good; that two different starts end at the
same pose does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose._progress import Progress
from screwpose._types import BoolArray, FloatArray, ImageArray
from screwpose.geometry import Camera, rigid
from screwpose.implants.model import Mesh
from screwpose.registration.alternatives import Rival, thread_lead_mm
from screwpose.registration.recipe import STAGES, RecipeFit, Stage, Targets, fit_by_thickness, scaled_stages, settled
from screwpose.registration.search import SearchOptions, register
from screwpose.registration.thickness_fit import Body, energies_of_each, energies_of_views, fit_at_scale
from screwpose.similarity.engine import SceneEngine
from screwpose.similarity.target import Target

AGREE_MM, AGREE_DEG = 0.1, 0.15
# Below that in some view a body is not where it was put; see `screwpose.pairing.answer`.
_CHECK_ENERGY = 0.5
# Real biplane images: from 3 mm and 3 degrees all of 16 fits by thickness alone came home, from 10 and 10 24 of 25.
_NEAR_MM, _NEAR_DEG = 5.0, 5.0
_QUARTER = 4
_BLUR_PX = 2.0
_MARGIN = 1.1  # the search's bounds, over what the start is said to be off
_POPULATION = 10
_GENERATIONS = 100
_PATIENCE = (10, 0.003)  # iterations at the finest stage, and the step, mm, that ends them
_POLISH = (12, 0.0005)  # and for the pose that is given back


@dataclass(frozen=True, eq=False)
class Xray:
    """One view: log image, metal bright (rows, columns); the pixels that count; its camera."""

    log_pixels: ImageArray
    region: BoolArray
    camera: Camera


@dataclass(frozen=True, eq=False)
class FarXrays:
    """X-rays made ready for `register_from`; see `prepare_far`.

    Parameters
    ----------
    cameras, silhouettes : by view name, at a quarter of the resolution.
    targets, stages : for the thickness model.
    """

    cameras: Mapping[str, Camera]
    silhouettes: Mapping[str, Target]
    targets: Targets
    stages: Sequence[tuple[int, Stage]]


def prepare_far(xrays: Mapping[str, Xray], center_mm: FloatArray, stages: Sequence[Stage] = STAGES) -> FarXrays:
    """Reduce X-rays to what a far start needs.

    Parameters
    ----------
    center_mm : (3,), in world, about where the bodies are.
    """
    from screwpose.similarity.thickness import make_gradient_target

    scaled = scaled_stages(float(np.mean([one.camera.mm_per_px_at(center_mm) for one in xrays.values()])), stages)
    targets = {
        scale: [make_gradient_target(one.log_pixels, one.region, one.camera, scale) for one in xrays.values()]
        for scale, _ in scaled
    }
    quarter = {name: _reduced(one) for name, one in xrays.items()}
    cameras = {name: camera for name, (camera, _) in quarter.items()}
    return FarXrays(cameras, {name: target for name, (_, target) in quarter.items()}, targets, scaled)


def _reduced(xray: Xray) -> tuple[Camera, Target]:
    """Camera and blurred log image at a quarter of the resolution."""
    import cv2

    from screwpose.images.preparation import smoothed
    from screwpose.similarity.target import make_target

    rows, columns = (side // _QUARTER for side in xray.region.shape)
    used = (slice(0, rows * _QUARTER), slice(0, columns * _QUARTER))
    size = (columns, rows)
    image = cv2.resize(np.ascontiguousarray(xray.log_pixels[used], np.float32), size, interpolation=cv2.INTER_AREA)
    inside = cv2.resize(np.ascontiguousarray(xray.region[used], np.float32), size, interpolation=cv2.INTER_AREA)
    # Integer pixels are centres, so borders, not centres, coincide.
    middle = 0.5 / _QUARTER - 0.5
    smaller = np.array([[1.0 / _QUARTER, 0.0, middle], [0.0, 1.0 / _QUARTER, middle], [0.0, 0.0, 1.0]])
    region: BoolArray = np.asarray(inside > 0.999)
    target = make_target(smoothed(np.asarray(image, np.float32), _BLUR_PX), region, np.zeros_like(region))
    return Camera(smaller @ xray.camera.projection), target


@dataclass(frozen=True, eq=False)
class FarFit:
    """Where far starts ended.

    Parameters
    ----------
    world_from_cad : of each body, (4, 4), from the start whose end explains most.
    energies : (B, V), the share of the gradient energy near each body that is explained, by view.
    starts : how many were made.
    apart_mm, apart_deg : of any body, to the nearest end of another start; infinite where there was only one.
    doubts : what speaks against the poses; none where they explain the images and two starts agree.
    rivals : other poses that were tried and lost.
    """

    world_from_cad: tuple[FloatArray, ...]
    energies: FloatArray
    starts: int
    apart_mm: float
    apart_deg: float
    doubts: tuple[str, ...]
    rivals: tuple[Rival, ...]

    @property
    def is_sure(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.doubts


def register_from(
    bodies: Sequence[Body],
    start_world_from_cad: Sequence[FloatArray],
    xrays: FarXrays,
    reach_mm: float,
    reach_deg: float,
    *,
    roll_deg: float | None = None,
    silhouette_meshes: Sequence[Mesh] | None = None,
    seed: int = 0,
    most_starts: int = 4,
    progress: Progress | None = None,
) -> FarFit:
    """Register bodies whose start may be far off.

    A start that is near goes to the thickness model as it is; else, and for every further start, the silhouettes are
    searched, each time by another random generator. Starts are made until the end that explains most is reached twice.

    Parameters
    ----------
    bodies : with or without marks; their meshes closed.
    start_world_from_cad : (4, 4) each.
    reach_mm, reach_deg : how far each may be off, along any axis and about any.
    roll_deg : about the implant's own axis, if more.
    silhouette_meshes : reduced, one for each body, some 1,000 triangles; None: the bodies' own.
    seed : the same seed gives the same answer.
    most_starts : at least two.
    progress : told the fraction done; what it raises stops the work.

    Raises
    ------
    BehindSourceError
        The reach goes behind an X-ray source.
    """
    start = [np.asarray(pose, dtype=np.float64) for pose in start_world_from_cad]
    meshes = [body.mesh for body in bodies] if silhouette_meshes is None else silhouette_meshes
    bounds = SearchOptions(
        max_shift_mm=_MARGIN * reach_mm,
        max_tilt_deg=_MARGIN * reach_deg,
        max_roll_deg=_MARGIN * max(reach_deg, roll_deg or 0.0),
        generations=_GENERATIONS,
        population=_POPULATION,
        seed=seed,
    )
    leads_mm = [thread_lead_mm(body.implant, body.mesh) for body in bodies]
    is_near = reach_mm <= _NEAR_MM and max(reach_deg, roll_deg or 0.0) <= _NEAR_DEG
    engine = SceneEngine(xrays.cameras, xrays.silhouettes, meshes)
    tell = progress or _tell_nobody
    ends: list[tuple[float, RecipeFit]] = []
    scale, last = xrays.stages[-1]
    views = xrays.targets[scale]
    apart = (np.inf, np.inf)
    for number in range(most_starts):
        entry: Sequence[FloatArray] = start
        if number or not is_near:
            options = replace(bounds, seed=seed + number)
            entry = _searched(bodies, start, engine, options, _part(tell, number, number + 0.3, most_starts))
        end = _finished(bodies, entry, xrays, leads_mm, _part(tell, number + 0.3, number + 1.0, most_starts))
        ends.append((float(np.mean(energies_of_views(views, bodies, end.world_from_cad))), end))
        _, best = max(ends, key=lambda one: one[0])
        apart = _nearest(bodies, best, [other for _, other in ends if other is not best])
        if apart[0] <= AGREE_MM and apart[1] <= AGREE_DEG:
            break
    poses = fit_at_scale(views, bodies, best.world_from_cad, last.mark_sigma_px, *_POLISH).world_from_cad
    energies = energies_of_each(views, bodies, poses)
    return FarFit(poses, energies, len(ends), *apart, _doubts(energies, len(ends), *apart), best.rivals)


def _searched(
    bodies: Sequence[Body],
    start: Sequence[FloatArray],
    engine: SceneEngine,
    options: SearchOptions,
    progress: Progress,
) -> Sequence[FloatArray]:
    """Poses in the valley of the silhouettes."""

    def losses(scenes: FloatArray) -> FloatArray:
        return np.asarray(engine.scores(scenes).loss.mean(axis=1))

    return register([body.implant for body in bodies], start, losses, options, progress).world_from_cad


def _finished(
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    xrays: FarXrays,
    leads_mm: Sequence[float],
    progress: Progress,
) -> RecipeFit:
    """The thickness model's stages, without the grids for starts from landmarks, and with more patience at the end."""
    iterations, enough_mm = _PATIENCE
    stages = [
        (
            scale,
            replace(
                stage,
                tilts_deg=(),
                rolls_deg=(),
                doubtful_below=0.0,
                other_ways=stage.other_ways and any(leads_mm),  # without a thread there is nothing to be screwed along
            ),
        )
        for scale, stage in xrays.stages
    ]
    scale, last = stages[-1]
    stages[-1] = (scale, replace(last, iterations=iterations, enough_mm=enough_mm))
    fit = fit_by_thickness(bodies, poses, xrays.targets, stages, progress)
    return settled(bodies, fit, xrays.targets, stages, leads_mm)


def _nearest(bodies: Sequence[Body], best: RecipeFit, others: Sequence[RecipeFit]) -> tuple[float, float]:
    """How far the nearest of other ends is: the largest distance of any body's centre, mm, and turn, degrees."""
    apart = [(np.inf, np.inf)]
    for other in others:
        pairs = zip(bodies, best.world_from_cad, other.world_from_cad, strict=True)
        mm, deg = zip(*(_distance(body, one, two) for body, one, two in pairs), strict=True)
        apart.append((max(mm), max(deg)))
    return min(apart, key=lambda one: max(one[0] / AGREE_MM, one[1] / AGREE_DEG))


def _distance(body: Body, one: FloatArray, two: FloatArray) -> tuple[float, float]:
    center_mm = body.implant.center_mm
    shift_mm = np.linalg.norm(rigid.transform(one, center_mm) - rigid.transform(two, center_mm))
    turn_rad = np.linalg.norm(rigid.log_rotation(one[:3, :3] @ two[:3, :3].T))
    return float(shift_mm), float(np.degrees(turn_rad))


def _doubts(energies: FloatArray, starts: int, apart_mm: float, apart_deg: float) -> tuple[str, ...]:
    doubts = []
    if energies.min() < _CHECK_ENERGY:
        doubts.append(f"the models explain little of the edges in some view (energy {energies.min():.2f})")
    if apart_mm > AGREE_MM or apart_deg > AGREE_DEG:
        far = (
            "no other came near"
            if np.isinf(apart_mm)
            else f"the nearest is {apart_mm:.2f} mm and {apart_deg:.2f} deg off"
        )
        doubts.append(f"of {starts} starts no two ended at the best pose: {far}")
    return tuple(doubts)


def _part(progress: Progress, first: float, last: float, count: int) -> Progress:
    """A progress that fills a part of another, from start `first` to `last` of `count`."""
    return lambda fraction, what: progress(
        (first + (last - first) * fraction) / count, f"start {int(first) + 1}: {what}"
    )


def _tell_nobody(_fraction: float, _what: str) -> None:
    pass
