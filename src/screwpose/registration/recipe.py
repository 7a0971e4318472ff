"""From placed screws to their poses: grids for what a gradient cannot see, then Gauss-Newton from coarse to fine."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from screwpose._progress import Progress
from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.registration.alternatives import Rival, better_ways, is_at_rest, thread_lead_mm
from screwpose.registration.checks import preference
from screwpose.registration.initial import turned
from screwpose.registration.thickness_fit import Body, ScaleFit, energies_of_candidates, energies_of_each, fit_at_scale
from screwpose.similarity.thickness import GradientTarget

Targets = Mapping[int, Sequence[GradientTarget]]
"""By scale, the X-rays of all views."""


@dataclass(frozen=True)
class Stage:
    """What is done at one resolution.

    Parameters
    ----------
    pixel_mm : of the reduced images, at the screws, about.
    iterations : of Gauss-Newton, at most.
    enough_mm : a smaller step ends them.
    mark_sigma_px : of the prior, in px of the X-ray: the marks hold the coarse stages and hardly the fine ones.
    tilts_deg : the axis is tilted by each of these about both axes across, before the iterations.
    rolls_deg : and the screw turned about it by each of these.
    doubtful_below : screws that explain less of the energy near them in some view begin once more after this stage.
    other_ways : `settled` tries other turns along each screw's thread at this resolution.
    """

    pixel_mm: float
    iterations: int
    enough_mm: float
    mark_sigma_px: float
    tilts_deg: tuple[float, ...] = ()
    rolls_deg: tuple[float, ...] = ()
    doubtful_below: float = 0.0
    other_ways: bool = False


_DOUBTFUL = 0.5
_MORE = 3  # times the iterations of a stage
# Marks of 4 px leave the axis of a short screw 7 degrees off.
_WIDE_DEG = (-7.0, -3.5, 0.0, 3.5, 7.0)
_WIDE_ROLLS_DEG = tuple(np.arange(0.0, 360.0, 30.0).tolist())
# At 1024 px on 300 mm, magnified by 1.5, a pixel is 0.2 mm: these are an eighth of the resolution up to all of it.
STAGES = (
    Stage(1.6, 6, 0.1, 2.0, tilts_deg=(-3.0, 0.0, 3.0), rolls_deg=tuple(np.arange(0.0, 360.0, 15.0).tolist())),
    Stage(0.8, 6, 0.05, 2.0, rolls_deg=(0.0, 180.0, -12.0, -8.0, -4.0, 4.0, 8.0, 12.0), doubtful_below=_DOUBTFUL),
    Stage(0.4, 6, 0.02, 3.0, rolls_deg=(0.0, 180.0), other_ways=True),
    Stage(0.2, 5, 0.005, 3.0),
)


def scaled_stages(mm_per_px: float, stages: Sequence[Stage] = STAGES) -> list[tuple[int, Stage]]:
    """The stages with the factors by which X-rays of a pixel size (mm, at the screws) are reduced for them.

    Coarse X-rays have fewer stages: those that would have the same factor become one, with the first one's grids and
    the last one's iterations.
    """
    scaled: list[tuple[int, Stage]] = []
    for stage in stages:
        scale = max(1, round(stage.pixel_mm / mm_per_px))
        if scaled and scaled[-1][0] == scale:
            first = scaled.pop()[1]
            stage = replace(
                stage,
                tilts_deg=first.tilts_deg,
                rolls_deg=first.rolls_deg,
                doubtful_below=max(first.doubtful_below, stage.doubtful_below),
                other_ways=first.other_ways or stage.other_ways,
            )
        scaled.append((scale, stage))
    return scaled


@dataclass(frozen=True, eq=False)
class RecipeFit(ScaleFit):
    """Where the screws came to rest, and what other poses of each were tried."""

    rivals: tuple[Rival, ...] = ()


def fit_by_thickness(
    bodies: Sequence[Body],
    start_world_from_cad: Sequence[FloatArray],
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    progress: Progress | None = None,
    known: Collection[int] = (),
) -> ScaleFit:
    """Register all screws together on the thickness model.

    A grid of directions and rolls before the first iterations repairs starts that would lock onto a wrong edge, a pale
    tower in bright air beside a dark one; a screw that explains little all the same begins once more without it. Rolls
    before the finer scales find the half-turn.

    Parameters
    ----------
    start_world_from_cad : (4, 4) each, good to a few mm and degrees; the roll may be anything.
    stages : with their scales, as `scaled_stages` has them.
    progress : told after every stage; what it raises stops the work.
    known : indices of screws that start where they were registered in other company: no other poses are tried of them.
    """
    fresh = [index for index in range(len(bodies)) if index not in known]
    start = [np.asarray(pose, dtype=np.float64) for pose in start_world_from_cad]
    poses = start
    fit: ScaleFit | None = None
    for index, (scale, stage) in enumerate(stages):
        views = targets[scale]
        if progress is not None:
            progress(index / len(stages), f"fitting at 1/{scale} of the resolution")
        fit = _through(views, bodies, poses, stage, fresh)
        poses = list(fit.world_from_cad)
        if stage.doubtful_below > 0.0:
            poses = _begun_again(bodies, start, poses, targets, stages[: index + 1], fresh)
    assert fit is not None, "at least one stage"
    return fit


def settled(
    bodies: Sequence[Body],
    fit: ScaleFit,
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    leads_mm: Sequence[float] | None = None,
    progress: Progress | None = None,
) -> RecipeFit:
    """Try other turns along each screw's thread, fitted before they are judged, and go on from what is preferred.

    Parameters
    ----------
    fit : of all the stages.
    leads_mm : of each body's thread; None: as `thread_lead_mm` finds them.
    progress : told before; what it raises stops the work.
    """
    unchanged = RecipeFit(fit.world_from_cad, fit.iterations, fit.last_step_mm)
    places = [index for index, (_, stage) in enumerate(stages) if stage.other_ways]
    if not places:
        return unchanged
    if leads_mm is None:
        leads_mm = [thread_lead_mm(body.implant, body.mesh) for body in bodies]
    if progress is not None:
        progress(0.0, "trying other turns")
    scale, stage = stages[places[-1]]
    poses, rivals = better_ways(
        targets[scale], bodies, fit.world_from_cad, leads_mm, stage.mark_sigma_px, stage.enough_mm
    )
    unchanged = replace(unchanged, rivals=tuple(rivals))
    if all(is_at_rest(*two) for two in zip(bodies, fit.world_from_cad, poses, strict=True)):
        return unchanged
    again = fit
    for scale, stage in stages[places[-1] :]:
        again = fit_at_scale(targets[scale], bodies, poses, stage.mark_sigma_px, stage.iterations, stage.enough_mm)
        poses = list(again.world_from_cad)
    if preference(targets[scale], bodies, again.world_from_cad, fit.world_from_cad) <= 0.0:
        return unchanged
    return RecipeFit(again.world_from_cad, again.iterations, again.last_step_mm, tuple(rivals))


def once_more(
    bodies: Sequence[Body], poses: Sequence[FloatArray], targets: Targets, stages: Sequence[tuple[int, Stage]]
) -> list[FloatArray]:
    """Poses that went once more through all scales where a screw explains little in some view, if that is better.

    Where two edges lie close beside each other the way home is long and flat, and the iterations of a stage do not
    see its end; the coarsest images show it best.

    Parameters
    ----------
    poses : (4, 4) each, registered through the same stages.
    """
    finest = targets[stages[-1][0]]
    if float(energies_of_each(finest, bodies, poses).min()) >= _DOUBTFUL:
        return list(poses)
    again = list(poses)
    for scale, stage in stages:
        iterations = _MORE * stage.iterations
        fit = fit_at_scale(targets[scale], bodies, again, stage.mark_sigma_px, iterations, stage.enough_mm)
        again = list(fit.world_from_cad)
    return again if preference(finest, bodies, again, poses) > 0.0 else list(poses)


def _through(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    stage: Stage,
    which: Sequence[int],
) -> ScaleFit:
    """One stage: its grids for some of the bodies, then its iterations for all."""
    if stage.tilts_deg:
        poses = _best_of_each(views, bodies, poses, partial(_tilted, stage.tilts_deg), which)
    if stage.rolls_deg:
        poses = _best_of_each(views, bodies, poses, partial(_rolled, stage.rolls_deg), which, is_quick=True)
    return fit_at_scale(views, bodies, poses, stage.mark_sigma_px, stage.iterations, stage.enough_mm)


def _begun_again(
    bodies: Sequence[Body],
    start: Sequence[FloatArray],
    poses: Sequence[FloatArray],
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    fresh: Sequence[int],
) -> list[FloatArray]:
    """Let screws that explain little in some view begin once more from their start, in two other ways.

    The grid of directions turns a screw where it stands, at the roll it has. Started a mm off, the direction that looks
    best may be wrong: so first without it. Started many degrees off, as careless marks do, no direction of the grid
    is right: so then with a wider one, every direction at many rolls.
    """
    best = list(poses)
    scale, stage = stages[-1]
    for directions in (_as_they_stand, _all_around):
        lowest = energies_of_each(targets[scale], bodies, best).min(axis=1)
        doubtful = [index for index in fresh if lowest[index] < stage.doubtful_below]
        if not doubtful:
            break
        again = [start[number] if number in doubtful else pose for number, pose in enumerate(best)]
        again = _best_of_each(targets[stages[0][0]], bodies, again, directions, doubtful)
        for one, (its_scale, its) in enumerate(stages):
            without = replace(
                its, tilts_deg=(), rolls_deg=() if one == 0 and directions is _all_around else its.rolls_deg
            )
            again = list(_through(targets[its_scale], bodies, again, without, doubtful).world_from_cad)
        if preference(targets[scale], bodies, again, best) > 0.0:
            best = again
    return best


def _as_they_stand(_body: Body, pose: FloatArray) -> list[FloatArray]:
    return [pose]


def _all_around(body: Body, pose: FloatArray) -> list[FloatArray]:
    return [rolled for tilted in _tilted(_WIDE_DEG, body, pose) for rolled in _rolled(_WIDE_ROLLS_DEG, body, tilted)]


def _best_of_each(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    candidates: Callable[[Body, FloatArray], list[FloatArray]],
    which: Sequence[int],
    is_quick: bool = False,
) -> list[FloatArray]:
    """One screw after the other takes the candidate that explains most, the others as they stand."""
    best = list(poses)
    for index in which:
        trials = candidates(bodies[index], best[index])
        best[index] = trials[int(np.argmax(energies_of_candidates(views, bodies, best, index, trials, is_quick)))]
    return best


def _rolled(rolls_deg: Sequence[float], body: Body, pose: FloatArray) -> list[FloatArray]:
    return [turned(body.implant, pose, float(np.radians(roll))) for roll in rolls_deg]


def _tilted(tilts_deg: Sequence[float], body: Body, pose: FloatArray) -> list[FloatArray]:
    axis = pose[:3, :3] @ body.implant.axis
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    second = np.cross(axis, across)
    center = rigid.transform(pose, body.implant.center_mm)
    return [
        rigid.from_rotation_about(rigid.exp_rotation(np.radians(a) * across + np.radians(b) * second), center) @ pose
        for a, b in product(tilts_deg, tilts_deg)
    ]
