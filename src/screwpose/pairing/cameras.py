"""Cameras that are not exact: what a case says of them, what landmarks make of it, and the fit of poses and cameras.

Cameras are left alone unless the case, or who solves it, says how exact they are. With ``auto`` they are as exact as
one may expect of a C-arm, and still left alone where landmarks and X-rays agree with them: a pose in the reported
cameras is a pose in the world that they were calibrated in, which refined cameras can only keep approximately.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import FloatArray
from screwpose.files.case import Case, View
from screwpose.geometry import Camera
from screwpose.geometry.correction import CameraCorrection, CameraSigma
from screwpose.images import log_image
from screwpose.pairing.confidence import p_value
from screwpose.pairing.evidence import Poses
from screwpose.pairing.hypotheses import Combination, Hypothesis, combinations
from screwpose.pairing.segment import LandmarkNoise
from screwpose.registration import Progress, align
from screwpose.registration.bundle import MarkedSegment, adjust
from screwpose.registration.camera_fit import (
    CalibratedView,
    CameraFit,
    CameraState,
    corrected_marks,
    corrected_target,
    fit_cameras_at_scale,
)
from screwpose.registration.camera_recipe import (
    as_calibrated,
    end_with_cameras,
    fit_with_cameras,
    turned_in_cameras,
    with_exact_cameras,
)
from screwpose.registration.recipe import RecipeFit, Stage, Targets
from screwpose.registration.thickness_fit import Body
from screwpose.similarity.blurred import Blur
from screwpose.similarity.thickness import GradientTarget, make_gradient_target

CameraMode = Literal["off", "given", "auto"]
"""Whether cameras are refined: never, as the case's sigmas say, or also, as one may expect of a C-arm, without them."""

AUTO = CameraSigma(rotation_deg=2.0, translation_mm=5.0, focal_percent=1.0, principal_point_px=10.0)
_EXACT = CameraSigma(0.0, 0.0, 0.0, 0.0)
# Landmarks that are likelier than this do not contradict the matrices.
_AGREES = 1e-3
# By so much refined cameras must explain more of the gradient energy, all views together, and of what the reported ones
# leave unexplained. On development cases with exact cameras it was at most 0.006 and 4 %; with LAT off by 0.2 degrees,
# 0.25 mm and 1 px it was 0.013 to 0.29 and 4 to 64 %.
_WORTH, _WORTH_SHARE = 0.01, 0.04
# The share of the poses' variance that is gone, mean over the views: half where the screws hold the difference of two
# views as exact as each other. Below, they hold too little of it.
_LEAST_LEARNED = 0.25
# Of the smoothings tried for the end on twelve development cases (0.7 and 1 px, less the mean over 0 to 31 px, of
# the greys and of their logarithms) this was among the best; greys do as well, with smaller worst errors.
_SHARP_PX, _MEAN_PX = 0.7, 21
_ITERATIONS = 8
_ENOUGH_MM = 0.005
_REFINED = (
    "the cameras were refined with the poses: distances and angles between the screws are more exact than their places "
    "in the world, which no image holds better than the calibration"
)


@dataclass(frozen=True, eq=False)
class CamerasFit:
    """Poses and cameras of a combination.

    Parameters
    ----------
    views : as reported, by name.
    corrections : by view; empty where the cameras were left alone.
    pivot_mm : (3,), in world, about which corrections turn.
    chi_square : of the corrections, in sigmas.
    words : what a reader should know.
    blurs : of the detectors, in the order of the views.
    held : the poses in the cameras as reported.
    """

    world_from_cad: Poses
    views: Mapping[str, CalibratedView]
    corrections: Mapping[str, CameraCorrection]
    pivot_mm: FloatArray
    chi_square: float
    words: tuple[str, ...]
    blurs: tuple[Blur, ...]
    held: Poses

    @property
    def state(self) -> CameraState:
        """What an iteration starts from."""
        return CameraState(self.world_from_cad, tuple(self.corrections.values()), self.blurs)

    @property
    def cameras(self) -> dict[str, Camera]:
        """The cameras in which the poses are, by view."""
        return {
            name: self.corrections[name].applied(view.camera, self.pivot_mm) if self.corrections else view.camera
            for name, view in self.views.items()
        }

    def seen(self, targets: Sequence[GradientTarget]) -> list[GradientTarget]:
        """X-rays, one of each view, with their cameras corrected."""
        if not self.corrections:
            return list(targets)
        return [
            corrected_target(target, view.camera, self.corrections[name], self.pivot_mm)
            for target, (name, view) in zip(targets, self.views.items(), strict=True)
        ]

    def marked(self, body: Body) -> Body:
        """A body whose marks are in the corrected cameras."""
        if body.marks is None:
            return body
        marks, _ = corrected_marks(body.marks, list(self.views.values()), list(self.cameras.values()))
        return replace(body, marks=marks)


def with_sigmas(case: Case, mode: CameraMode, noise: LandmarkNoise) -> Case:
    """The case with the sigmas that it is to be solved with.

    A view whose sigma is "auto" gets `AUTO` where the landmarks contradict the matrices, and keeps "auto" where they do
    not: landmarks are then taken in the cameras as they are, and the X-rays decide.
    """
    if mode == "off":
        return _with(case, dict.fromkeys(case.views))
    if mode == "auto":
        case = _with(case, {name: view.sigma or "auto" for name, view in case.views.items()})
    if not any(view.sigma == "auto" for view in case.views.values()):
        return case
    ranked = combinations(case, noise, 1)
    pairs = min(len(marks) for marks in sorted(case.annotations.values(), key=len)[-2:])
    if ranked and len(ranked[0].hypotheses) >= pairs and p_value(ranked[0]) >= _AGREES:
        return case
    return _with(case, {name: AUTO if view.sigma == "auto" else view.sigma for name, view in case.views.items()})


def _with(case: Case, sigmas: Mapping[str, CameraSigma | Literal["auto"] | None]) -> Case:
    return replace(case, views={name: replace(view, sigma=sigmas[name]) for name, view in case.views.items()})


def are_free(case: Case) -> bool:
    """Whether any of the cameras may be refined."""
    return any(
        view.sigma == "auto" or (view.sigma is not None and view.sigma.by_parameter.any())
        for view in case.views.values()
    )


def in_cameras(case: Case, cameras: Mapping[str, Camera]) -> Case:
    """The case as other cameras see it."""
    return replace(case, views={name: replace(view, camera=cameras[name]) for name, view in case.views.items()})


def begin_cameras(
    case: Case,
    combination: Combination,
    bodies: Sequence[Body],
    poses: Poses,
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    noise: LandmarkNoise,
    progress: Progress | None = None,
) -> CamerasFit | None:
    """Register the screws of a combination with the cameras as far as their sigmas leave them free, coarsely.

    Two starts: the cameras as the marks put them right, and as they were reported. None where they are to be left
    alone: none is free, all are only "auto", or there is but one screw.

    Parameters
    ----------
    poses : registered in the reported cameras at the same stages.
    """
    if not begin_with_cameras(case, bodies):
        return None
    views, pivot_mm = _calibrated(case), _pivot_mm(combination)
    bundle = adjust(
        [view.camera for view in views],
        [view.sigma for view in views],
        [_segment(case, hypothesis) for hypothesis in combination.hypotheses],
        pivot_mm,
        noise.sigma_px,
        noise.length_sigma_mm,
    )
    laid = [align(body.implant, *ends) for body, ends in zip(bodies, bundle.ends_mm, strict=True)]
    as_reported = as_calibrated(poses, views)
    starts = [CameraState(tuple(laid), bundle.corrections, as_reported.blurs), as_reported]
    free = fit_with_cameras(bodies, starts, targets, stages, views, pivot_mm, progress)
    return _fitted(case, views, pivot_mm, free, poses, ())


def finish_cameras(
    case: Case,
    begun: CamerasFit,
    bodies: Sequence[Body],
    leads_mm: Sequence[float],
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
) -> tuple[CamerasFit, RecipeFit] | None:
    """Try other turns of the screws in the refined cameras, and end on the sharpest images: for the chosen combination.

    None where the screws hold too little of the cameras: they are to be left as they were reported.
    """
    views, state = list(begun.views.values()), begun.state
    state, at_rest = turned_in_cameras(bodies, state, leads_mm, targets, stages, views, begun.pivot_mm)
    free = end_with_cameras(bodies, state, targets, stages, sharp_targets(case, stages), views, begun.pivot_mm)
    if _learned(views, free) < _LEAST_LEARNED * _shared(views):
        return None
    return _fitted(case, views, begun.pivot_mm, free, begun.held, (_REFINED,)), at_rest


def free_if_worth(
    case: Case,
    combination: Combination,
    bodies: Sequence[Body],
    poses: Poses,
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
) -> CamerasFit | None:
    """Refine cameras that are "auto", from where the screws are in the reported ones; None where that explains little
    more, or they cannot be carried.

    Landmarks agree with the matrices then: what is left to refine is small.
    """
    if not _are_auto(case) or len(bodies) < 2:
        return None
    views, pivot_mm = _calibrated(case), _pivot_mm(combination)
    scale, last = stages[-1]
    fits: list[CameraFit] = []
    state = as_calibrated(poses, views)
    for one in (with_exact_cameras(views), views):
        fits.append(
            fit_cameras_at_scale(
                targets[scale], one, bodies, state, pivot_mm, last.mark_sigma_px, _ITERATIONS, _ENOUGH_MM
            )
        )
        state = fits[-1].state
    before, after = (_unexplained(fit) for fit in fits)
    if before - after < max(_WORTH, _WORTH_SHARE * before):
        return None
    free = end_with_cameras(bodies, state, targets, stages, sharp_targets(case, stages), views, pivot_mm)
    if _learned(views, free) < _LEAST_LEARNED * _shared(views):
        return None
    return _fitted(case, views, pivot_mm, free, poses, (_REFINED,))


def left_alone(case: Case, combination: Combination, poses: Poses) -> CamerasFit | None:
    """What to say where cameras were given sigmas and are left as they were reported; None where there is nothing to
    say."""
    if _are_auto(case) or not are_free(case):
        return None
    why = "one screw" if len(poses) < 2 else "screws that show so little"
    words = (f"the cameras were left as they are: {why} cannot carry them",)
    views = dict(zip(case.views, _calibrated(case), strict=True))
    return CamerasFit(poses, views, {}, _pivot_mm(combination), 0.0, words, (), poses)


def sharp_targets(case: Case, stages: Sequence[tuple[int, Stage]]) -> list[GradientTarget]:
    """The X-rays as cameras are refined with them at last: hardly smoothed, less what goes on evenly for some 4 mm."""

    def of_view(view: View) -> GradientTarget:
        log = log_image(view.radiograph.pixels)
        return make_gradient_target(log, view.mask, view.camera, stages[-1][0], _SHARP_PX, _MEAN_PX)

    return in_threads(of_view, list(case.views.values()))


def _are_auto(case: Case) -> bool:
    return any(view.sigma == "auto" for view in case.views.values())


def begin_with_cameras(case: Case, bodies: Sequence[Body]) -> bool:
    """Whether the cameras are free from the start: sigmas are given, and there is more than one screw."""
    return are_free(case) and not _are_auto(case) and len(bodies) > 1


def _calibrated(case: Case) -> list[CalibratedView]:
    return [
        CalibratedView(view.camera, AUTO if view.sigma == "auto" else view.sigma or _EXACT)
        for view in case.views.values()
    ]


def _pivot_mm(combination: Combination) -> FloatArray:
    return np.asarray(np.mean([hypothesis.fit.center_mm for hypothesis in combination.hypotheses], axis=0))


def _fitted(
    case: Case,
    views: Sequence[CalibratedView],
    pivot_mm: FloatArray,
    free: CameraFit,
    held: Poses,
    words: tuple[str, ...],
) -> CamerasFit:
    return CamerasFit(
        free.state.world_from_cad,
        dict(zip(case.views, views, strict=True)),
        dict(zip(case.views, free.state.corrections, strict=True)),
        pivot_mm,
        float(np.sum(free.state.in_sigmas(views) ** 2)),
        words,
        free.state.blurs,
        held,
    )


def _learned(views: Sequence[CalibratedView], free: CameraFit) -> float:
    """The share of the variance of the views' poses that is gone."""
    uncertain = np.array([view.sigma.by_parameter[:6] > 0.0 for view in views])
    return float(np.mean(1.0 - free.system.left[:, :6][uncertain] ** 2)) if uncertain.any() else 1.0


def _shared(views: Sequence[CalibratedView]) -> float:
    """How much of the variance of the views' poses there is to learn, over half of it: what holds the world's frame is
    a view that is exact."""
    return 2.0 if any(not view.sigma.by_parameter[:6].any() for view in views) else 1.0


def _unexplained(fit: CameraFit) -> float:
    return sum(1.0 - energy for energy in fit.system.energies)


def _segment(case: Case, hypothesis: Hypothesis) -> MarkedSegment:
    marks = {(view, mark.label): mark for view, of_view in case.annotations.items() for mark in of_view}
    own = [marks[key] for key in hypothesis.labels]
    names = list(case.views)
    return MarkedSegment(
        tuple(names.index(view) for view, _ in hypothesis.labels),
        np.stack([mark.tip_px for mark in own]),
        np.stack([mark.center_px for mark in own]),
        case.implants[hypothesis.model].length_mm,
    )
