"""Poses and cameras together: Gauss-Newton on the thickness model with every view's correction among the unknowns.

A camera that moves, moves every body that it sees as one: its columns of the Jacobian are the bodies' own, times a
matrix for each body. Focal length and principal point move the image itself. All corrections are in units of their
sigmas, so that the prior of each is 1; nothing else holds the world's frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import FloatArray
from screwpose.geometry import Camera, rigid
from screwpose.geometry.correction import PARAMETERS, CameraCorrection, CameraSigma, points_by_correction
from screwpose.registration.bundle import in_sigmas, prior_slopes
from screwpose.registration.camera_view import OF_IMAGE, OF_INTRINSICS, view_system
from screwpose.registration.landmark_prior import MarkedScrew, mark_residuals
from screwpose.registration.thickness_fit import Body, changed
from screwpose.similarity.blurred import PARAMETERS as OF_BLUR
from screwpose.similarity.blurred import Blur
from screwpose.similarity.thickness import GradientTarget

_OF_VIEW = PARAMETERS + OF_BLUR
_DAMPING = 1e-7  # priors hold what images do not; more would hold back focal length and depth, the weakest of all
_FULL_STEP = (0.05, 1.0)  # rad and mm, at half resolution and finer
_LARGEST_STEP = 1.0  # of what is in sigmas
# Of chi-square. Screws and cameras may move together by tenths of a mm for nothing: millimetres say little here.
_ENOUGH_GAIN = 0.03
# Robust weights let steps fall short where an edge is a pixel off, again and again in the same direction: after twenty
# iterations a third of a mm was left. What goes the same way again is doubled; the end is the same.
_AGREED, _LARGEST_FACTOR = 0.5, 4.0


@dataclass(frozen=True, eq=False)
class CalibratedView:
    """One view as it was reported: the camera of the whole X-ray, and how exactly it is known."""

    camera: Camera
    sigma: CameraSigma


@dataclass(frozen=True, eq=False)
class CameraState:
    """Poses (4, 4) of the bodies, and of each view its correction and its detector's blur."""

    world_from_cad: tuple[FloatArray, ...]
    corrections: tuple[CameraCorrection, ...]
    blurs: tuple[Blur, ...]

    def corrected(self, views: Sequence[CalibratedView], pivot_mm: FloatArray) -> list[Camera]:
        """The cameras as they are corrected."""
        return [one.applied(view.camera, pivot_mm) for one, view in zip(self.corrections, views, strict=True)]

    def in_sigmas(self, views: Sequence[CalibratedView]) -> FloatArray:
        """The corrections in sigmas, (V, 9)."""
        return np.stack([in_sigmas(one, view.sigma) for one, view in zip(self.corrections, views, strict=True)])


@dataclass(frozen=True, eq=False)
class CameraSystem:
    """The normal equations of poses (6 B), then of each view its standardised correction (9) and blur (4).

    Parameters
    ----------
    energies : by view, the share of the gradient energy that is explained.
    """

    information: FloatArray
    gradient: FloatArray
    energies: tuple[float, ...]

    @property
    def left(self) -> FloatArray:
        """What is left of the sigma of each correction, (V, 9), 0 to 1."""
        views = len(self.energies)
        own = np.sqrt(np.diag(np.linalg.inv(self.information)))[-_OF_VIEW * views :]
        return np.asarray(own.reshape(views, _OF_VIEW)[:, :PARAMETERS])


@dataclass(frozen=True, eq=False)
class CameraFit:
    """Where the iterations at one scale ended; `last_step_mm` is the largest shift of a screw in the last one."""

    state: CameraState
    system: CameraSystem
    iterations: int
    last_step_mm: float


def corrected_target(
    target: GradientTarget, camera: Camera, correction: CameraCorrection, pivot_mm: FloatArray
) -> GradientTarget:
    """The X-ray with its camera corrected; `camera` is the reported one, of the whole X-ray."""
    K = target.intrinsics.copy()
    K[:2, :2] *= np.exp(correction.log_focal)
    K[:2, 2] += correction.principal_point_px * [_handedness(camera), 1.0] / target.scale
    motion = correction.motion_about(pivot_mm)
    return replace(target, intrinsics=K, camera_from_world=target.camera_from_world @ motion)


def _handedness(camera: Camera) -> float:
    """A target of a mirrored view was mirrored back: u runs the other way."""
    return 1.0 if camera.is_right_handed else -1.0


def seen_by_body(center_mm: FloatArray, pivot_mm: FloatArray) -> FloatArray:
    """What a step of a camera, a turn about the pivot and a shift, is to a body: (6, 6), about its own centre."""
    matrix = np.eye(6)
    matrix[3:, :3] = -rigid.skew(center_mm - pivot_mm)
    return matrix


def corrected_marks(
    marks: MarkedScrew, views: Sequence[CalibratedView], corrected: Sequence[Camera]
) -> tuple[MarkedScrew, list[int]]:
    """The marks of a screw in the corrected cameras, and the indices of their views; the marks' own cameras are those
    of `views`."""
    cameras = [view.camera for view in views]
    own = [cameras.index(camera) for camera in marks.cameras]
    return replace(marks, cameras=[corrected[k] for k in own]), own


def camera_system(
    targets: Sequence[GradientTarget],
    views: Sequence[CalibratedView],
    bodies: Sequence[Body],
    state: CameraState,
    pivot_mm: FloatArray,
    mark_sigma_px: float,
) -> CameraSystem:
    """The normal equations of all views, marks and priors."""
    first = 6 * len(bodies)
    size = first + _OF_VIEW * len(views)
    information, gradient = np.zeros((size, size)), np.zeros(size)
    poses = state.world_from_cad
    centers = [rigid.transform(pose, body.implant.center_mm) for body, pose in zip(bodies, poses, strict=True)]
    corrected_targets = [
        corrected_target(target, view.camera, correction, pivot_mm)
        for target, view, correction in zip(targets, views, state.corrections, strict=True)
    ]
    seen = in_threads(
        lambda one: view_system(one[0], bodies, poses, one[1]), zip(corrected_targets, state.blurs, strict=True)
    )
    for k, (found, view, correction, blur) in enumerate(zip(seen, views, state.corrections, state.blurs, strict=True)):
        unknowns = _unknowns(view, centers, pivot_mm, first + _OF_VIEW * k, size)
        information += unknowns.T @ found.information @ unknowns
        gradient += unknowns.T @ found.gradient
        own = slice(first + _OF_VIEW * k, first + _OF_VIEW * k + PARAMETERS)
        slope = prior_slopes(correction, view.sigma)
        information[own, own] += slope.T @ slope
        gradient[own] -= slope.T @ in_sigmas(correction, view.sigma)
        rest = slice(own.stop, own.stop + OF_BLUR)
        information[rest, rest] += np.eye(OF_BLUR)
        gradient[rest] -= blur.parameters
    corrected = state.corrected(views, pivot_mm)
    for index, body in enumerate(bodies):
        if body.marks is not None:
            residuals, slopes = _mark_rows(bodies, index, views, state, corrected, pivot_mm, mark_sigma_px)
            information += slopes.T @ slopes
            gradient += slopes.T @ residuals
    return CameraSystem(information, gradient, tuple(found.energy for found in seen))


def _unknowns(
    view: CalibratedView, centers_mm: Sequence[FloatArray], pivot_mm: FloatArray, own: int, size: int
) -> FloatArray:
    """What all unknowns are to a view: (6 B + 7, size), from standardised ones to those of `view_system`."""
    first = 6 * len(centers_mm)
    matrix = np.zeros((first + OF_IMAGE, size))
    matrix[:first, :first] = np.eye(first)
    for index, center_mm in enumerate(centers_mm):
        matrix[6 * index : 6 * index + 6, own : own + 6] = seen_by_body(center_mm, pivot_mm)
    intrinsics = slice(first, first + OF_INTRINSICS)
    matrix[intrinsics, own + 6 : own + PARAMETERS] = np.diag([1.0, _handedness(view.camera), 1.0])
    matrix[:, own : own + PARAMETERS] *= view.sigma.by_parameter
    matrix[intrinsics.stop :, own + PARAMETERS : own + _OF_VIEW] = np.eye(OF_BLUR)
    return matrix


def _mark_rows(
    bodies: Sequence[Body],
    index: int,
    views: Sequence[CalibratedView],
    state: CameraState,
    corrected: Sequence[Camera],
    pivot_mm: FloatArray,
    sigma_px: float,
) -> tuple[FloatArray, FloatArray]:
    """Residuals (4 V,) of the marks of a screw, in sigmas, and how they change with all unknowns."""
    body, pose = bodies[index], state.world_from_cad[index]
    assert body.marks is not None
    marks, of_view = corrected_marks(body.marks, views, corrected)
    residuals, by_pose = mark_residuals(body.implant, pose, marks, sigma_px)
    ends = rigid.transform(pose, np.stack([body.implant.tip_mm, body.implant.center_mm]))
    slopes = np.zeros((len(residuals), 6 * len(bodies) + _OF_VIEW * len(views)))
    slopes[:, 6 * index : 6 * index + 6] = by_pose
    for row, k in enumerate(of_view):
        by_camera = points_by_correction(corrected[k], ends, pivot_mm) * views[k].sigma.by_parameter
        own = 6 * len(bodies) + _OF_VIEW * k
        slopes[4 * row : 4 * row + 4, own : own + PARAMETERS] = by_camera.reshape(4, PARAMETERS) / sigma_px
    return residuals, slopes


def fit_cameras_at_scale(
    targets: Sequence[GradientTarget],
    views: Sequence[CalibratedView],
    bodies: Sequence[Body],
    start: CameraState,
    pivot_mm: FloatArray,
    mark_sigma_px: float,
    iterations: int,
    enough_mm: float,
) -> CameraFit:
    """Gauss-Newton at one scale, until a step would move no screw by more than `enough_mm`, or gain next to nothing.

    Parameters
    ----------
    targets : as reported, of the views in their order.
    pivot_mm : (3,), in world, near the screws: corrections turn about it.
    """
    first = 6 * len(bodies)
    reach = max(1.0, targets[0].scale / 2.0)
    limits = np.concatenate(
        [np.tile(np.repeat(_FULL_STEP, 3) * reach, len(bodies)), np.full(_OF_VIEW * len(views), _LARGEST_STEP)]
    )
    of_blur = first + np.flatnonzero(np.arange(_OF_VIEW * len(views)) % _OF_VIEW >= PARAMETERS)
    state, step_mm, done = start, np.inf, 0
    system = camera_system(targets, views, bodies, state, pivot_mm, mark_sigma_px)
    before, factor = np.zeros(len(system.gradient)), 1.0
    while done < iterations and step_mm > enough_mm:
        damped = system.information + _DAMPING * np.diag(np.diag(system.information) + 1e-12)
        step: FloatArray = np.asarray(np.linalg.solve(damped, system.gradient), dtype=np.float64)
        if float(step @ system.gradient) < _ENOUGH_GAIN:
            break
        cosine, again = _along(step, before, damped)
        factor = min(2.0 * factor, _LARGEST_FACTOR) if cosine > _AGREED else 1.0
        before, step = step, step + (factor - 1.0) * again
        step_mm = float(np.linalg.norm(step[:first].reshape(-1, 6)[:, 3:], axis=1).max())
        step[of_blur] = np.clip(step[of_blur], -_LARGEST_STEP, _LARGEST_STEP)
        step /= max(1.0, float(np.abs(step / limits).max()))  # as a whole: bodies and cameras move together
        state = _moved(state, bodies, views, step)
        done += 1
        system = camera_system(targets, views, bodies, state, pivot_mm, mark_sigma_px)
    return CameraFit(state, system, done, step_mm)


def _along(step: FloatArray, before: FloatArray, metric: FloatArray) -> tuple[float, FloatArray]:
    """How well a step agrees with the one before, the cosine, -1 to 1; and what of it goes the same way."""
    common, own = float(step @ metric @ before), float(before @ metric @ before)
    cosine = common / float(np.sqrt(max(own * float(step @ metric @ step), 1e-300)))
    return cosine, common / max(own, 1e-300) * before


def _moved(
    state: CameraState,
    bodies: Sequence[Body],
    views: Sequence[CalibratedView],
    step: FloatArray,
) -> CameraState:
    first = 6 * len(bodies)
    moves = zip(bodies, state.world_from_cad, step[:first].reshape(-1, 6), strict=True)
    of_views = step[first:].reshape(-1, _OF_VIEW)
    corrections = [
        one.then(move[:PARAMETERS] * view.sigma.by_parameter)
        for one, move, view in zip(state.corrections, of_views, views, strict=True)
    ]
    blurs = [one.then(move[PARAMETERS:]) for one, move in zip(state.blurs, of_views, strict=True)]
    poses = tuple(changed(body, pose, move) for body, pose, move in moves)
    return CameraState(poses, tuple(corrections), tuple(blurs))
