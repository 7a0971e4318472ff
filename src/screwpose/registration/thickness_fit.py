"""The fine registration: Gauss-Newton on the thickness model, coarse to fine, over all screws together.

The residuals are the image's derivatives minus those of the model, in all views, with robust weights; the marks are a
prior. A step is a rotation about each screw's centre and a shift, held down by Levenberg's damping and a limit that
shrinks with the scale.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from screwpose._threads import in_threads
from screwpose._types import FloatArray, ImageArray
from screwpose.geometry import rigid
from screwpose.implants.model import Implant, Mesh
from screwpose.registration.landmark_prior import MarkedScrew, mark_residuals
from screwpose.similarity.assessment import Bodies, assess, energies_of, path_lengths_of
from screwpose.similarity.thickness import GradientTarget

# Derivatives that were smoothed by 1.3 px share their noise with their neighbours: so many of them count as one.
_CORRELATED_PX = 8.0
_DAMPING = 1e-4
_FULL_STEP = (0.05, 1.0)  # rad and mm, at half resolution and finer
_SMALL_STEP = 0.1  # of the full one: a quarter of a pixel at half resolution
_AT_ONCE = 16  # candidates that a thread takes


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
    of_images : the part of it that images have.
    gradient : (6 B,).
    energies : by view, the share of the gradient energy that is explained.
    """

    information: FloatArray
    of_images: FloatArray
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


Fixed = Sequence[ImageArray | None]
"""For each view the path lengths through bodies that stand still: see `standing`."""


def standing(
    targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray], index: int
) -> list[ImageArray | None]:
    """What all bodies but one add to the path lengths, by view: drawn once while the one is tried at many poses."""
    others = [number for number in range(len(bodies)) if number != index]
    if not others:
        return [None] * len(targets)
    together = packed([bodies[number] for number in others], targets[0].scale)
    their_poses = [poses[number] for number in others]
    return [*in_threads(lambda target: path_lengths_of(target, together, their_poses), targets)]


def energies_of_candidates(
    targets: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    index: int,
    candidates: Sequence[FloatArray],
    is_quick: bool = False,
) -> list[float]:
    """The explained energy near one body, mean of the views, at each of several poses, the others as they stand.

    Parameters
    ----------
    is_quick : the views' responses are those of `poses`, which are about right, and not fitted to every candidate.
    """
    own = packed([bodies[index]], targets[0].scale)
    fixed = standing(targets, bodies, poses, index)
    of_views = list(zip(targets, fixed, strict=True))
    held = [
        assess(target, own, [poses[index]], fixed_mm=one).response if is_quick else None for target, one in of_views
    ]
    scenes = np.stack(candidates)
    parts = [slice(first, first + _AT_ONCE) for first in range(0, len(scenes), _AT_ONCE)]

    def energies(view: int, part: slice) -> FloatArray:
        return energies_of(targets[view], own, scenes[part], held[view], fixed[view])

    jobs = [(view, part) for view in range(len(targets)) for part in parts]
    found = in_threads(lambda job: energies(*job), jobs)
    by_view = [np.concatenate(found[len(parts) * view : len(parts) * (view + 1)]) for view in range(len(targets))]
    return [float(energy) for energy in np.mean(by_view, axis=0)]


def linearised(
    targets: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    mark_sigma_px: float,
    fixed: Fixed | None = None,
    of_images: FloatArray | None = None,
) -> Linearised:
    """The normal equations of all views and marks at some poses.

    Parameters
    ----------
    fixed : bodies that stand still beside these; None: there are none.
    of_images : the images' part of the information, from poses not far off: it is not computed again, which takes half
        the time. The gradient is exact all the same.
    """
    together = packed(bodies, targets[0].scale)
    is_known = of_images is not None
    views = in_threads(
        lambda one: assess(
            one[0], together, poses, with_normal_equations=not is_known, with_gradient=is_known, fixed_mm=one[1]
        ),
        list(zip(targets, fixed or [None] * len(targets), strict=True)),
    )
    if of_images is None:
        of_images = np.asarray(np.sum([view.information for view in views], axis=0) / _CORRELATED_PX)
    information = of_images.copy()
    gradient = np.sum([view.gradient for view in views], axis=0) / _CORRELATED_PX
    for index, (body, pose) in enumerate(zip(bodies, poses, strict=True)):
        if body.marks is not None:
            own = slice(6 * index, 6 * index + 6)
            residuals, slopes = mark_residuals(body.implant, pose, body.marks, mark_sigma_px)
            information[own, own] += slopes.T @ slopes
            gradient[own] += slopes.T @ residuals
    return Linearised(information, of_images, gradient, tuple(view.energy for view in views))


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
    fixed: Fixed | None = None,
) -> ScaleFit:
    """Gauss-Newton at one scale, until a step moves no screw by more than `enough_mm`.

    Where steps are small the information is not computed again: the gradient, which is exact, says where they end.

    Parameters
    ----------
    fixed : bodies that stand still beside these; None: there are none.
    """
    poses = [np.asarray(pose, dtype=np.float64) for pose in start_world_from_cad]
    limit = np.repeat(_FULL_STEP, 3) * max(1.0, targets[0].scale / 2.0)
    step_mm = np.inf
    done = 0
    system = linearised(targets, bodies, poses, mark_sigma_px, fixed)
    while done < iterations and step_mm > enough_mm:
        damped = system.information + _DAMPING * np.diag(np.diag(system.information) + 1e-12)
        steps = np.linalg.solve(damped, system.gradient).reshape(len(bodies), 6)
        in_limits = np.abs(steps / limit).max(axis=1, keepdims=True)
        steps /= np.maximum(in_limits, 1.0)
        moves = zip(bodies, poses, steps, strict=True)
        poses = [changed(body, pose, np.asarray(step)) for body, pose, step in moves]
        step_mm = float(np.linalg.norm(steps[:, 3:], axis=1).max())
        done += 1
        known = system.of_images if float(in_limits.max()) < _SMALL_STEP else None
        system = linearised(targets, bodies, poses, mark_sigma_px, fixed, known)
    return ScaleFit(tuple(poses), system, done, step_mm)
