"""From marks to poses and cameras: both together on the thickness model, coarse to fine, from several starts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry.correction import CameraSigma
from screwpose.registration.camera_fit import (
    CalibratedView,
    CameraFit,
    CameraState,
    corrected_marks,
    corrected_target,
    fit_cameras_at_scale,
)
from screwpose.registration.recipe import Stage, Targets, fit_by_thickness, settled
from screwpose.registration.search import Progress
from screwpose.registration.thickness_fit import Body

# Which start is the right one shows at an eighth and a quarter of the resolution.
_TRIED = 2
# At coarser pixels a screw is three wide: its direction and the camera's cannot be told apart.
_FREE_BELOW_MM = 1.2
# Depth and focal length are far weaker than what lies across the rays, and take more steps.
_LAST_ITERATIONS = 12


def fit_with_cameras(
    bodies: Sequence[Body],
    starts: Sequence[CameraState],
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    views: Sequence[CalibratedView],
    pivot_mm: FloatArray,
    progress: Progress | None = None,
) -> CameraFit:
    """Register all screws and refine all cameras together."""
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
    last_scale, last = stages[-1]
    finer = [*stages[tried:-1], (last_scale, replace(last, iterations=max(last.iterations, _LAST_ITERATIONS)))]
    return _through(bodies, state, targets, finer, views, pivot_mm, progress)


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
        free = views if stage.pixel_mm < _FREE_BELOW_MM else with_exact_cameras(views)
        fit = fit_cameras_at_scale(
            targets[scale], free, bodies, state, pivot_mm, stage.mark_sigma_px, stage.iterations, stage.enough_mm
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
    held = [
        corrected_target(target, view.camera, one, pivot_mm)
        for target, view, one in zip(targets[scale], views, state.corrections, strict=True)
    ]
    cameras = state.corrected(views, pivot_mm)
    seen = [
        body if body.marks is None else replace(body, marks=corrected_marks(body.marks, views, cameras)[0])
        for body in bodies
    ]
    alone = replace(stage, doubtful_below=0.0)  # what explains little may be for want of a camera
    stages = [(scale, alone)]
    fit = fit_by_thickness(seen, state.world_from_cad, {scale: held}, stages)
    return settled(seen, fit, {scale: held}, stages).world_from_cad


def with_exact_cameras(views: Sequence[CalibratedView]) -> list[CalibratedView]:
    """The same views with nothing to refine."""
    return [replace(view, sigma=CameraSigma(0.0, 0.0, 0.0, 0.0)) for view in views]
