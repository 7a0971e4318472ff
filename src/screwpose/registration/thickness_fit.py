"""The fine registration: Gauss-Newton on the thickness model, coarse to fine, over all screws together.

The residuals are the image's derivatives minus those of the model, in all views, with robust weights; the marks are a
prior. A step is a rotation about each screw's centre and a shift, held down by Levenberg's damping and a limit that
shrinks with the scale.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.projection.thickness import MotionFrame, Window, path_lengths
from screwpose.registration.landmark_prior import MarkedScrew, mark_residuals
from screwpose.similarity.thickness import (
    Explanation,
    GradientTarget,
    derivatives,
    explain,
    near_metal,
    response_slope,
)

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


@dataclass(frozen=True, eq=False)
class Patch:
    """One body in one view: its path lengths in the part of the image where it is, and how they change.

    Parameters
    ----------
    by_motion : (rows, columns, 6), by a rotation vector in world about its centre, then by a shift in world.
    """

    window: Window
    lengths_mm: FloatArray
    by_motion: NDArray[np.float32] | None


def rendered(target: GradientTarget, body: Body, pose: FloatArray, with_motion: bool) -> Patch:
    """Draw one body at a pose."""
    camera_from_cad = target.camera_from_world @ pose
    window = _window(target, rigid.transform(camera_from_cad, body.mesh.vertices_mm))
    frame = None
    if with_motion:
        center = rigid.transform(camera_from_cad, body.implant.center_mm)
        frame = MotionFrame(center, target.camera_from_world[:3, :3].T)
    found = path_lengths(target.intrinsics, camera_from_cad, body.mesh.vertices_mm, body.mesh.faces, window, frame)
    return Patch(window, found.lengths_mm, found.by_motion)


def _window(target: GradientTarget, points_mm: FloatArray) -> Window:
    """Where points in the camera's frame are in the image, and as much around them as derivatives reach."""
    homogeneous = points_mm @ target.intrinsics.T
    pixels = homogeneous[:, :2] / np.maximum(homogeneous[:, 2:], 1e-6)
    rows, columns = target.shape
    first = np.clip(np.floor(pixels.min(axis=0)) - _MARGIN_PX, 0, [columns - 1, rows - 1]).astype(int)
    last = np.clip(np.ceil(pixels.max(axis=0)) + _MARGIN_PX + 1, first + 1, [columns, rows]).astype(int)
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))


def together(patches: Sequence[Patch]) -> tuple[Window, FloatArray]:
    """The window that holds all bodies, and the path lengths of all of them in it."""
    window = tuple(
        slice(min(patch.window[axis].start for patch in patches), max(patch.window[axis].stop for patch in patches))
        for axis in range(2)
    )
    lengths: FloatArray = np.zeros([part.stop - part.start for part in window])
    for patch in patches:
        lengths[_inside(patch.window, window)] += patch.lengths_mm
    return (window[0], window[1]), lengths


def _inside(part: Window, whole: Sequence[slice]) -> Window:
    """A window of the image as a part of a larger one."""
    rows, columns = (
        slice(own.start - all_.start, own.stop - all_.start) for own, all_ in zip(part, whole, strict=True)
    )
    return rows, columns


def energies_of_each(
    targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray]
) -> FloatArray:
    """The explained share of the gradient energy near each body, (B, V): all bodies explain, one is looked at.

    One screw that went astray among many would hardly show in the energy of the whole.
    """
    shares = np.zeros((len(bodies), len(targets)))
    for column, target in enumerate(targets):
        patches = [rendered(target, body, pose, with_motion=False) for body, pose in zip(bodies, poses, strict=True)]
        window, lengths = together(patches)
        explanation = explain(target, lengths, window)
        left = explanation.image_of(explanation.residuals)
        for row, patch in enumerate(patches):
            place = _inside(patch.window, window)
            near = near_metal(target, patch.lengths_mm) & explanation.near[place]
            seen = np.stack([target.along_u[patch.window][near], target.along_v[patch.window][near]])
            total = float(np.sum(seen.astype(np.float64) ** 2))
            shares[row, column] = 1.0 - float(np.sum(left[:, *place][:, near] ** 2)) / max(total, 1e-300)
    return shares


def energies_of_candidates(
    targets: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    index: int,
    candidates: Sequence[FloatArray],
) -> list[float]:
    """The explained energy, mean of the views, with one body at each of several poses and the others as they stand."""
    shares = np.zeros((len(candidates), len(targets)))
    for column, target in enumerate(targets):
        others = [
            rendered(target, body, pose, with_motion=False)
            for number, (body, pose) in enumerate(zip(bodies, poses, strict=True))
            if number != index
        ]
        for row, candidate in enumerate(candidates):
            window, lengths = together([*others, rendered(target, bodies[index], candidate, with_motion=False)])
            shares[row, column] = explain(target, lengths, window).energy
    return [float(share) for share in shares.mean(axis=1)]


def linearised(
    targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray], mark_sigma_px: float
) -> Linearised:
    """The normal equations of all views and marks at some poses."""
    size = 6 * len(bodies)
    information, gradient = np.zeros((size, size)), np.zeros(size)
    energies = []
    for target in targets:
        patches = [rendered(target, body, pose, with_motion=True) for body, pose in zip(bodies, poses, strict=True)]
        window, lengths = together(patches)
        explanation = explain(target, lengths, window)
        energies.append(explanation.energy)
        if explanation.near.any():
            _add_view(target, patches, window, lengths, explanation, information, gradient)
    for index, (body, pose) in enumerate(zip(bodies, poses, strict=True)):
        if body.marks is not None:
            own = slice(6 * index, 6 * index + 6)
            residuals, slopes = mark_residuals(body.implant, pose, body.marks, mark_sigma_px)
            information[own, own] += slopes.T @ slopes
            gradient[own] += slopes.T @ residuals
    return Linearised(information, gradient, tuple(energies))


def _add_view(
    target: GradientTarget,
    patches: Sequence[Patch],
    window: Window,
    lengths_mm: FloatArray,
    explanation: Explanation,
    information: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add one view's part to the normal equations; bodies whose windows do not meet have none in common."""
    from screwpose.similarity.kernels import add_block, add_gradient

    weights = explanation.image_of(explanation.weights / (explanation.spread**2 * _CORRELATED_PX))
    residuals = explanation.image_of(explanation.residuals)
    slope = response_slope(explanation.response, lengths_mm)
    places = [_inside(patch.window, window) for patch in patches]
    corners = [np.array([place[0].start, place[1].start]) for place in places]
    moved = []
    for patch, place in zip(patches, places, strict=True):
        assert patch.by_motion is not None
        moved.append(derivatives(target, slope[place], patch.by_motion))
    for i, (first, corner) in enumerate(zip(moved, corners, strict=True)):
        own = slice(6 * i, 6 * i + 6)
        add_gradient(first, corner, weights, residuals, gradient[own])
        for j in range(i, len(moved)):
            block = np.zeros((6, 6))
            add_block(first, moved[j], np.concatenate([corner, corners[j]]), weights, block)
            other = slice(6 * j, 6 * j + 6)
            information[own, other] += block
            if i != j:
                information[other, own] += block.T


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
