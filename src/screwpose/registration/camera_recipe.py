"""From marks to poses and cameras: both together on the thickness model, coarse to fine, from several starts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from screwpose._progress import Progress
from screwpose._types import FloatArray
from screwpose.geometry.correction import CameraCorrection, CameraSigma
from screwpose.registration.camera_fit import (
    CalibratedView,
    CameraFit,
    CameraState,
    corrected_marks,
    corrected_target,
    fit_cameras_at_scale,
)
from screwpose.registration.recipe import RecipeFit, Stage, Targets, fit_by_thickness, settled
from screwpose.registration.thickness_fit import Body, ScaleFit
from screwpose.similarity.blurred import Blur
from screwpose.similarity.thickness import GradientTarget

# Which start is the right one shows at an eighth and a quarter of the resolution.
_TRIED = 2
# At coarser pixels a screw is three wide: its direction and the camera's cannot be told apart.
_FREE_BELOW_MM = 1.2
# Depth and focal length are far weaker than what lies across the rays, and take more steps.
_FREE_ITERATIONS, _BETWEEN_ITERATIONS, _LAST_ITERATIONS = 14, 3, 16


def fit_with_cameras(
    bodies: Sequence[Body],
    starts: Sequence[CameraState],
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    views: Sequence[CalibratedView],
    pivot_mm: FloatArray,
    progress: Progress | None = None,
) -> CameraFit:
    """Register all screws and refine all cameras together, at all the stages."""
    tried = min(_TRIED, len(stages) - 1) if len(starts) > 1 else 0
    best: CameraFit | None = None
    state = starts[0]
    if tried:
        for start in starts:
            fit = _through(bodies, start, targets, stages[:tried], views, pivot_mm, progress)
            if best is None or np.mean(fit.system.energies) > np.mean(best.system.energies):
                best = fit
        assert best is not None
        state = best.state
    return _through(bodies, state, targets, stages[tried:], views, pivot_mm, progress)


def turned_in_cameras(
    bodies: Sequence[Body],
    state: CameraState,
    leads_mm: Sequence[float],
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    views: Sequence[CalibratedView],
    pivot_mm: FloatArray,
) -> tuple[CameraState, RecipeFit]:
    """Try other turns of each screw along its thread in the cameras as they stand; see `recipe.settled`."""
    coarse = [(scale, stage) for scale, stage in stages if stage.other_ways] or list(stages[-1:])
    scale, stage = coarse[-1]
    seen, held = _seen(bodies, state, targets[scale], views, pivot_mm)
    fit = ScaleFit(state.world_from_cad, 0, 0.0)
    at_rest = settled(seen, fit, {scale: held}, [(scale, stage)], leads_mm)
    return replace(state, world_from_cad=at_rest.world_from_cad), at_rest


def end_with_cameras(
    bodies: Sequence[Body],
    state: CameraState,
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    sharp: Sequence[GradientTarget],
    views: Sequence[CalibratedView],
    pivot_mm: FloatArray,
) -> CameraFit:
    """At the finest stage, and from there on the sharp images."""
    scale, last = stages[-1]
    for images, iterations in ((targets[scale], _BETWEEN_ITERATIONS), (sharp, _LAST_ITERATIONS)):
        fit = fit_cameras_at_scale(
            images, views, bodies, state, pivot_mm, last.mark_sigma_px, iterations, last.enough_mm
        )
        state = fit.state
    return fit


def as_calibrated(poses: Sequence[FloatArray], views: Sequence[CalibratedView]) -> CameraState:
    """Poses in the cameras as they were reported."""
    return CameraState(tuple(poses), (CameraCorrection(),) * len(views), (Blur(),) * len(views))


def _through(
    bodies: Sequence[Body],
    state: CameraState,
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    views: Sequence[CalibratedView],
    pivot_mm: FloatArray,
    progress: Progress | None,
) -> CameraFit:
    fit: CameraFit | None = None
    for index, (scale, stage) in enumerate(stages):
        if progress is not None:
            progress(index / len(stages), f"fitting poses and cameras at 1/{scale} of the resolution")
        if stage.tilts_deg or stage.rolls_deg:
            state = replace(state, world_from_cad=_posed(bodies, state, targets, scale, stage, views, pivot_mm))
        is_free = stage.pixel_mm < _FREE_BELOW_MM
        fit = fit_cameras_at_scale(
            targets[scale],
            views if is_free else with_exact_cameras(views),
            bodies,
            state,
            pivot_mm,
            stage.mark_sigma_px,
            max(stage.iterations, _FREE_ITERATIONS) if is_free else stage.iterations,
            stage.enough_mm,
        )
        state = fit.state
    assert fit is not None, "at least one stage"
    return fit


def _posed(
    bodies: Sequence[Body],
    state: CameraState,
    targets: Targets,
    scale: int,
    stage: Stage,
    views: Sequence[CalibratedView],
    pivot_mm: FloatArray,
) -> tuple[FloatArray, ...]:
    """The poses in cameras that are held as they stand: grids of tilts and rolls, and what follows."""
    seen, held = _seen(bodies, state, targets[scale], views, pivot_mm)
    alone = replace(stage, doubtful_below=0.0)  # what explains little may be for want of a camera
    return fit_by_thickness(seen, state.world_from_cad, {scale: held}, [(scale, alone)]).world_from_cad


def _seen(
    bodies: Sequence[Body],
    state: CameraState,
    targets: Sequence[GradientTarget],
    views: Sequence[CalibratedView],
    pivot_mm: FloatArray,
) -> tuple[list[Body], list[GradientTarget]]:
    """The bodies' marks and the X-rays in the cameras as they stand."""
    held = [
        corrected_target(target, view.camera, one, pivot_mm)
        for target, view, one in zip(targets, views, state.corrections, strict=True)
    ]
    cameras = state.corrected(views, pivot_mm)
    seen = [
        body if body.marks is None else replace(body, marks=corrected_marks(body.marks, views, cameras)[0])
        for body in bodies
    ]
    return seen, held


def with_exact_cameras(views: Sequence[CalibratedView]) -> list[CalibratedView]:
    """The same views with nothing to refine."""
    return [replace(view, sigma=CameraSigma(0.0, 0.0, 0.0, 0.0)) for view in views]
