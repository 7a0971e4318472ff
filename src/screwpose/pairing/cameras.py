"""Cameras that are not exact: what a case says of them, what landmarks make of it, and the fit of poses and cameras.

Cameras are left alone unless the case, or who solves it, says how exact they are. With ``auto`` they are as exact as
one may expect of a C-arm, and still left alone where landmarks and X-rays agree with them: a pose in the reported
cameras is a pose in the world that they were calibrated in, which refined cameras can only keep approximately.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from screwpose._types import FloatArray
from screwpose.files.case import Case
from screwpose.geometry import Camera
from screwpose.geometry.correction import CameraCorrection, CameraSigma
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
from screwpose.registration.camera_recipe import fit_with_cameras, with_exact_cameras
from screwpose.registration.recipe import Stage, Targets
from screwpose.registration.thickness_fit import Body
from screwpose.similarity.blurred import Blur
from screwpose.similarity.thickness import GradientTarget

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
_LEAST_LEARNED = 0.35
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
    energies : by view, the share of the gradient energy that is explained.
    chi_square : of the corrections, in sigmas.
    words : what a reader should know.
    """

    world_from_cad: Poses
    views: Mapping[str, CalibratedView]
    corrections: Mapping[str, CameraCorrection]
    pivot_mm: FloatArray
    energies: tuple[float, ...]
    chi_square: float
    words: tuple[str, ...]

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


def fit_cameras(
    case: Case,
    combination: Combination,
    bodies: Sequence[Body],
    poses: Poses,
    targets: Targets,
    stages: Sequence[tuple[int, Stage]],
    noise: LandmarkNoise,
    progress: Progress | None = None,
) -> CamerasFit:
    """Register the screws of a combination with the cameras as far as they are free.

    Parameters
    ----------
    poses : where to begin: registered in the reported cameras.
    """
    reported = [view.camera for view in case.views.values()]
    sigmas = [AUTO if view.sigma == "auto" else view.sigma or _EXACT for view in case.views.values()]
    views = [CalibratedView(camera, sigma) for camera, sigma in zip(reported, sigmas, strict=True)]
    pivot_mm = np.mean([hypothesis.fit.center_mm for hypothesis in combination.hypotheses], axis=0)
    as_reported = CameraState(poses, (CameraCorrection(),) * len(views), (Blur(),) * len(views))
    scale, last = stages[-1]
    held = fit_cameras_at_scale(
        targets[scale], with_exact_cameras(views), bodies, as_reported, pivot_mm, last.mark_sigma_px, _ITERATIONS,
        _ENOUGH_MM,
    )  # fmt: skip
    if any(view.sigma == "auto" for view in case.views.values()):
        # Landmarks agree with the matrices: what is left to refine is small, and begins where the poses are.
        free = fit_cameras_at_scale(
            targets[scale], views, bodies, held.state, pivot_mm, last.mark_sigma_px, _ITERATIONS, _ENOUGH_MM
        )
        gain = _unexplained(held) - _unexplained(free)
        if gain < max(_WORTH, _WORTH_SHARE * _unexplained(held)):
            return _left(case, views, pivot_mm, held, ())
    else:
        bundle = adjust(
            reported,
            sigmas,
            [_segment(case, hypothesis) for hypothesis in combination.hypotheses],
            pivot_mm,
            noise.sigma_px,
            noise.length_sigma_mm,
        )
        laid = [align(body.implant, *ends) for body, ends in zip(bodies, bundle.ends_mm, strict=True)]
        starts = [CameraState(tuple(laid), bundle.corrections, as_reported.blurs), as_reported]
        free = fit_with_cameras(bodies, starts, targets, stages, views, pivot_mm, progress)
    return _judged(case, views, pivot_mm, held, free)


def _judged(
    case: Case, views: Sequence[CalibratedView], pivot_mm: FloatArray, held: CameraFit, free: CameraFit
) -> CamerasFit:
    """The refined cameras, unless the screws hold too little of them."""
    uncertain = np.array([view.sigma.by_parameter[:6] > 0.0 for view in views])
    learned = float(np.mean(1.0 - free.system.left[:, :6][uncertain] ** 2)) if uncertain.any() else 1.0
    several = len(held.state.world_from_cad) > 1
    if not several or learned < _LEAST_LEARNED * _shared(views):
        why = "one screw" if not several else "screws that show so little"
        return _left(case, views, pivot_mm, held, (f"the cameras were left as they are: {why} cannot carry them",))
    return CamerasFit(
        free.state.world_from_cad,
        dict(zip(case.views, views, strict=True)),
        dict(zip(case.views, free.state.corrections, strict=True)),
        pivot_mm,
        free.system.energies,
        float(np.sum(free.state.in_sigmas(views) ** 2)),
        (_REFINED,),
    )


def _left(
    case: Case, views: Sequence[CalibratedView], pivot_mm: FloatArray, held: CameraFit, words: tuple[str, ...]
) -> CamerasFit:
    """The cameras as they were reported."""
    of_case = dict(zip(case.views, views, strict=True))
    return CamerasFit(held.state.world_from_cad, of_case, {}, pivot_mm, held.system.energies, 0.0, words)


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
