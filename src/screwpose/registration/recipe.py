"""From placed screws to their poses: grids for what a gradient cannot see, then Gauss-Newton from coarse to fine."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.registration.initial import turned
from screwpose.registration.search import Progress
from screwpose.registration.thickness_fit import Body, ScaleFit, energies_of_candidates, fit_at_scale
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
    """

    pixel_mm: float
    iterations: int
    enough_mm: float
    mark_sigma_px: float
    tilts_deg: tuple[float, ...] = ()
    rolls_deg: tuple[float, ...] = ()


# At 1024 px on 300 mm, magnified by 1.5, a pixel is 0.2 mm: these are an eighth of the resolution up to all of it.
STAGES = (
    Stage(1.6, 6, 0.1, 2.0, tilts_deg=(-3.0, 0.0, 3.0), rolls_deg=tuple(np.arange(0.0, 360.0, 15.0).tolist())),
    Stage(0.8, 6, 0.05, 2.0, rolls_deg=(0.0, 180.0, -12.0, -8.0, -4.0, 4.0, 8.0, 12.0)),
    Stage(0.4, 6, 0.02, 3.0, rolls_deg=(0.0, 180.0)),
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
            stage = replace(stage, tilts_deg=first.tilts_deg, rolls_deg=first.rolls_deg)
        scaled.append((scale, stage))
    return scaled


def fit_by_thickness(
    bodies: Sequence[Body],
    start_world_from_cad: Sequence[FloatArray],
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    progress: Progress | None = None,
) -> ScaleFit:
    """Register all screws together on the thickness model.

    A grid of directions and rolls before the first iterations repairs starts that would lock onto a wrong edge, a pale
    tower in bright air beside a dark one; rolls before the finer scales find the half-turn and the thread's phase.

    Parameters
    ----------
    start_world_from_cad : (4, 4) each, good to a few mm and degrees; the roll may be anything.
    stages : with their scales, as `scaled_stages` has them.
    progress : told after every stage; what it raises stops the work.
    """
    poses = [np.asarray(pose, dtype=np.float64) for pose in start_world_from_cad]
    fit: ScaleFit | None = None
    for index, (scale, stage) in enumerate(stages):
        views = targets[scale]
        if progress is not None:
            progress(index / len(stages), f"fitting at 1/{scale} of the resolution")
        if stage.tilts_deg:
            poses = _best_of_each(views, bodies, poses, partial(_tilted, stage.tilts_deg))
        if stage.rolls_deg:
            poses = _best_of_each(views, bodies, poses, partial(_rolled, stage.rolls_deg))
        fit = fit_at_scale(views, bodies, poses, stage.mark_sigma_px, stage.iterations, stage.enough_mm)
        poses = list(fit.world_from_cad)
    assert fit is not None, "at least one stage"
    return fit


def _best_of_each(
    views: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    candidates: Callable[[Body, FloatArray], list[FloatArray]],
) -> list[FloatArray]:
    """One screw after the other takes the candidate that explains most, the others as they stand."""
    best = list(poses)
    for index, body in enumerate(bodies):
        trials = candidates(body, best[index])
        best[index] = trials[int(np.argmax(energies_of_candidates(views, bodies, best, index, trials)))]
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
