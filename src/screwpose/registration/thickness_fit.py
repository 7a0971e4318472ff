"""The fine registration: Gauss-Newton on the thickness model, coarse to fine, over all screws together.

The residuals are the image's derivatives minus those of the model, in all views, with robust weights; the marks are a
prior. A step is a rotation about each screw's centre and a shift, held down by Levenberg's damping and a limit that
shrinks with the scale.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.registration.landmark_prior import MarkedScrew, mark_residuals
from screwpose.similarity.assessment import Bodies, assess
from screwpose.similarity.thickness import GradientTarget

# Derivatives that were smoothed by 1.3 px share their noise with their neighbours: so many of them count as one.
_CORRELATED_PX = 8.0
_DAMPING = 1e-4
_FULL_STEP = (0.05, 1.0)  # rad and mm, at half resolution and finer


@dataclass(frozen=True, eq=False)
class Body:
    """One screw.

    Parameters
    ----------
    mesh : closed; it is drawn.
    marks : None where there is no prior.
    coarser : by scale, closed meshes of fewer triangles that are drawn at this scale and the coarser ones.
    """

    implant: Implant
    mesh: Mesh
    marks: MarkedScrew | None
    coarser: Mapping[int, Mesh] = field(default_factory=dict)

    def mesh_at(self, scale: int) -> Mesh:
        """What is drawn where so many px of the X-ray make one."""
        fitting = [least for least in self.coarser if least <= scale]
        return self.coarser[max(fitting)] if fitting else self.mesh


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


def packed(bodies: Sequence[Body], scale: int) -> Bodies:
    """The bodies as they are drawn together at a scale."""
    return Bodies([body.mesh_at(scale) for body in bodies], np.stack([body.implant.center_mm for body in bodies]))


def energies_of_each(
    targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray]
) -> FloatArray:
    """The explained share of the gradient energy near each body, (B, V): all bodies explain, one is looked at."""
    together = packed(bodies, targets[0].scale)
    views = in_threads(lambda target: assess(target, together, poses, with_shares=True), targets)
    return np.stack([view.shares for view in views], axis=1)


def energies_of_candidates(
    targets: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    index: int,
    candidates: Sequence[FloatArray],
    is_quick: bool = False,
) -> list[float]:
    """The explained energy, mean of the views, with one body at each of several poses and the others as they stand.

    Parameters
    ----------
    is_quick : the views' responses are those of `poses`, which are about right, and not fitted to every candidate.
    """
    together = packed(bodies, targets[0].scale)
    scenes = [[*poses[:index], candidate, *poses[index + 1 :]] for candidate in candidates]
    held = [assess(target, together, poses).response if is_quick else None for target in targets]

    def energy(scene: Sequence[FloatArray]) -> float:
        views = zip(targets, held, strict=True)
        return float(np.mean([assess(target, together, scene, held_response=one).energy for target, one in views]))

    return in_threads(energy, scenes)


def linearised_views(
    targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray]
) -> list[Linearised]:
    """The normal equations of each view by itself, without the marks."""
    together = packed(bodies, targets[0].scale)
    views = in_threads(lambda target: assess(target, together, poses, with_normal_equations=True), targets)
    return [
        Linearised(view.information / _CORRELATED_PX, view.gradient / _CORRELATED_PX, (view.energy,)) for view in views
    ]


def linearised(
    targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray], mark_sigma_px: float
) -> Linearised:
    """The normal equations of all views and marks at some poses."""
    views = linearised_views(targets, bodies, poses)
    information = np.sum([view.information for view in views], axis=0)
    gradient = np.sum([view.gradient for view in views], axis=0)
    for index, (body, pose) in enumerate(zip(bodies, poses, strict=True)):
        if body.marks is not None:
            own = slice(6 * index, 6 * index + 6)
            residuals, slopes = mark_residuals(body.implant, pose, body.marks, mark_sigma_px)
            information[own, own] += slopes.T @ slopes
            gradient[own] += slopes.T @ residuals
    return Linearised(information, gradient, tuple(view.energies[0] for view in views))


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
