"""The fine registration: Gauss-Newton on the thickness model, coarse to fine, over all screws together.

The residuals are the image's derivatives minus those of the model, in all views, with robust weights; the marks are a
prior. A step is a rotation about each screw's centre and a shift, held down by Levenberg's damping and a limit that
shrinks with the scale.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.projection.thickness import Window, path_lengths
from screwpose.registration.landmark_prior import MarkedScrew, mark_residuals
from screwpose.similarity.thickness import Explanation, GradientTarget, derivatives, explain

# Derivatives that were smoothed by 1.3 px share their noise with their neighbours: so many of them count as one.
_CORRELATED_PX = 8.0
_DAMPING = 1e-4
_FULL_STEP = (0.05, 1.0)  # rad and mm, at half resolution and finer
_MARGIN_PX = 8


@dataclass(frozen=True, eq=False)
class Body:
    """One screw: its landmarks, the closed mesh that is rendered, its marks (None: no prior) and where it begins."""

    implant: Implant
    mesh: Mesh
    marks: MarkedScrew | None


@dataclass(frozen=True, eq=False)
class Linearised:
    """The normal equations at some poses.

    Parameters
    ----------
    information : (6 B, 6 B), of all screws' changes (see `mark_residuals`), noise and prior in it.
    gradient : (6 B,).
    energies : by view, the share of the gradient energy that is explained.
    """

    information: FloatArray
    gradient: FloatArray
    energies: tuple[float, ...]


def rendered(
    target: GradientTarget, bodies: Sequence[Body], poses: Sequence[FloatArray], with_motion: bool
) -> tuple[Window, FloatArray, list[FloatArray]]:
    """The path lengths of all bodies together, in the part of the image where they are.

    Returns
    -------
    The window; the lengths (rows, columns), mm; and, if asked for, for each body their derivatives (rows, columns, 6)
    by a rotation vector in world about its centre, then by a shift in world.
    """
    window = _window(target, bodies, poses)
    total: FloatArray = np.zeros([part.stop - part.start for part in window])
    by_change = []
    world_to_camera = target.camera_from_world[:3, :3]
    for body, pose in zip(bodies, poses, strict=True):
        found = path_lengths(
            target.intrinsics, target.camera_from_world @ pose, body.mesh.vertices_mm, body.mesh.faces, window,
            with_motion,
        )  # fmt: skip
        total += found.lengths_mm
        if found.by_motion is not None:
            center = rigid.transform(target.camera_from_world @ pose, body.implant.center_mm)
            turn, shift = found.by_motion[:, :, :3], found.by_motion[:, :, 3:]
            about_center = turn - np.cross(center, shift)
            by_change.append(np.concatenate([about_center @ world_to_camera, shift @ world_to_camera], axis=2))
    return window, total, by_change


def _window(target: GradientTarget, bodies: Sequence[Body], poses: Sequence[FloatArray]) -> Window:
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for body, pose in zip(bodies, poses, strict=True):
        points = rigid.transform(target.camera_from_world @ pose, body.mesh.vertices_mm) @ target.intrinsics.T
        pixels = points[:, :2] / np.maximum(points[:, 2:], 1e-6)
        low, high = np.minimum(low, pixels.min(axis=0)), np.maximum(high, pixels.max(axis=0))
    rows, columns = target.shape
    first = np.clip(np.floor(low) - _MARGIN_PX, 0, [columns - 1, rows - 1]).astype(int)
    last = np.clip(np.ceil(high) + _MARGIN_PX + 1, first + 1, [columns, rows]).astype(int)
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))


def energy(targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray]) -> float:
    """The explained share of the gradient energy, mean of the views."""
    shares = []
    for target in targets:
        window, lengths, _ = rendered(target, bodies, poses, with_motion=False)
        shares.append(explain(target, lengths, window).energy)
    return float(np.mean(shares))


def linearised(
    targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray], mark_sigma_px: float
) -> Linearised:
    """The normal equations of all views and marks at some poses."""
    from screwpose.similarity.kernels import normal_equations

    size = 6 * len(bodies)
    information, gradient = np.zeros((size, size)), np.zeros(size)
    energies = []
    for target in targets:
        window, lengths, by_change = rendered(target, bodies, poses, with_motion=True)
        explanation = explain(target, lengths, window)
        energies.append(explanation.energy)
        if len(explanation.residuals):
            J = derivatives(target, explanation, lengths, [change[:, :, k] for change in by_change for k in range(6)])
            matrix, right = normal_equations(J, _information(explanation), explanation.residuals)
            information += matrix
            gradient += right
    for index, (body, pose) in enumerate(zip(bodies, poses, strict=True)):
        if body.marks is not None:
            own = slice(6 * index, 6 * index + 6)
            residuals, slopes = mark_residuals(body.implant, pose, body.marks, mark_sigma_px)
            information[own, own] += slopes.T @ slopes
            gradient[own] += slopes.T @ residuals
    return Linearised(information, gradient, tuple(energies))


def _information(explanation: Explanation) -> FloatArray:
    return np.asarray(explanation.weights / (explanation.spread**2 * _CORRELATED_PX))


def changed(body: Body, world_from_cad: FloatArray, change: FloatArray) -> FloatArray:
    """The pose after a rotation vector in world about the screw's centre, then a shift in world: (6,)."""
    center = rigid.transform(world_from_cad, body.implant.center_mm)
    pose = rigid.from_rotation_about(rigid.exp_rotation(change[:3]), center) @ world_from_cad
    pose[:3, 3] += change[3:]
    return pose


@dataclass(frozen=True, eq=False)
class ScaleFit:
    """Where the iterations at one scale ended; `last_step` is the largest shift of a screw in the last one, mm."""

    world_from_cad: tuple[FloatArray, ...]
    linearised: Linearised
    iterations: int
    last_step_mm: float


def fit_at_scale(
    targets: Sequence[GradientTarget],
    bodies: Sequence[Body],
    start_world_from_cad: Sequence[FloatArray],
    mark_sigma_px: float,
    iterations: int,
    enough_mm: float,
) -> ScaleFit:
    """Gauss-Newton at one scale, until a step moves no screw by more than `enough_mm`."""
    poses = [np.asarray(pose, dtype=np.float64) for pose in start_world_from_cad]
    limit = np.repeat(_FULL_STEP, 3) * max(1.0, targets[0].scale / 2.0)
    step_mm = np.inf
    done = 0
    system = linearised(targets, bodies, poses, mark_sigma_px)
    while done < iterations and step_mm > enough_mm:
        damped = system.information + _DAMPING * np.diag(np.diag(system.information) + 1e-12)
        steps = np.linalg.solve(damped, system.gradient).reshape(len(bodies), 6)
        steps /= np.maximum(np.abs(steps / limit).max(axis=1, keepdims=True), 1.0)
        moves = zip(bodies, poses, steps, strict=True)
        poses = [changed(body, pose, np.asarray(step)) for body, pose, step in moves]
        step_mm = float(np.linalg.norm(steps[:, 3:], axis=1).max())
        done += 1
        system = linearised(targets, bodies, poses, mark_sigma_px)
    return ScaleFit(tuple(poses), system, done, step_mm)
