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
CORRELATED_PX = 8.0
_DAMPING = 1e-4
_FULL_STEP = (0.05, 1.0)  # rad and mm, at half resolution and finer
_SMALL_STEP = 0.1  # of the full one: a quarter of a pixel at half resolution
_AT_ONCE = 16  # candidates that a thread takes
_BESIDE_PX, _BESIDE = 8.0, 0.15  # what a filter reaches, and, of a body's length, a tilt by 8 degrees


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


def energies_of_views(
    targets: Sequence[GradientTarget], bodies: Sequence[Body], poses: Sequence[FloatArray]
) -> list[float]:
    """The share of each view's gradient energy that all bodies together explain."""
    together = packed(bodies, targets[0].scale)
    return in_threads(lambda target: assess(target, together, poses).energy, targets)


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
    """What all bodies but one add to the path lengths, by view: drawn once while the one is tried at many poses.

    Bodies that are far from it in a view are left out there: it is not tried so far away.
    """

    def of_view(target: GradientTarget) -> ImageArray | None:
        near = _beside(target, bodies, poses, index)
        if not near:
            return None
        together = packed([bodies[number] for number in near], target.scale)
        return path_lengths_of(target, together, [poses[number] for number in near])

    return in_threads(of_view, targets)


def _beside(target: GradientTarget, bodies: Sequence[Body], poses: Sequence[FloatArray], index: int) -> list[int]:
    """The other bodies whose boxes in the image come near the one's."""
    if len(bodies) == 1:
        return []
    boxes = [_box_px(target, body, pose) for body, pose in zip(bodies, poses, strict=True)]
    low, high = boxes[index]
    # A body that is seen end-on is small there, and tilts out of its box all the same.
    vertices_mm = bodies[index].mesh.vertices_mm
    depth_mm = rigid.transform(target.camera_from_world @ poses[index], vertices_mm.mean(axis=0))[2]
    length_px = float(np.linalg.norm(np.ptp(vertices_mm, axis=0)) * target.intrinsics[0, 0] / max(depth_mm, 1.0))
    margin_px = _BESIDE_PX + _BESIDE * length_px
    return [
        number
        for number, (first, last) in enumerate(boxes)
        if number != index and bool((first <= high + margin_px).all() and (last >= low - margin_px).all())
    ]


def _box_px(target: GradientTarget, body: Body, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A box that holds a body in the image: (2,) its first and its last corner."""
    ends = np.stack([body.mesh.vertices_mm.min(axis=0), body.mesh.vertices_mm.max(axis=0)])
    corners = np.stack(np.meshgrid(*ends.T), axis=-1).reshape(8, 3)
    points = rigid.transform(target.camera_from_world @ pose, corners) @ target.intrinsics.T
    pixels = points[:, :2] / np.maximum(points[:, 2:], 1e-6)
    return pixels.min(axis=0), pixels.max(axis=0)


def energies_of_candidates(
    targets: Sequence[GradientTarget],
    bodies: Sequence[Body],
    poses: Sequence[FloatArray],
    index: int,
    candidates: Sequence[FloatArray],
    is_quick: bool = False,
    fixed: Fixed | None = None,
) -> list[float]:
    """The explained energy near one body, mean of the views, at each of several poses, the others as they stand.

    Parameters
    ----------
    fixed : the others, where they were drawn before.
    is_quick : the views' responses are those of `poses`, which are about right, and not fitted to every candidate.
    """
    own = packed([bodies[index]], targets[0].scale)
    fixed = fixed or standing(targets, bodies, poses, index)
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
        of_images = np.asarray(np.sum([view.information for view in views], axis=0) / CORRELATED_PX)
    information = of_images.copy()
    gradient = np.sum([view.gradient for view in views], axis=0) / CORRELATED_PX
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
    """Where the iterations at one scale ended; `last_step_mm` is the largest shift of a screw in the last one."""

    world_from_cad: tuple[FloatArray, ...]
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
    known: FloatArray | None = None
    done = 0
    while done < iterations and step_mm > enough_mm:
        system = linearised(targets, bodies, poses, mark_sigma_px, fixed, known)
        damped = system.information + _DAMPING * np.diag(np.diag(system.information) + 1e-12)
        steps = np.linalg.solve(damped, system.gradient).reshape(len(bodies), 6)
        in_limits = np.abs(steps / limit).max(axis=1, keepdims=True)
        steps /= np.maximum(in_limits, 1.0)
        moves = zip(bodies, poses, steps, strict=True)
        poses = [changed(body, pose, np.asarray(step)) for body, pose, step in moves]
        step_mm = float(np.linalg.norm(steps[:, 3:], axis=1).max())
        known = system.of_images if float(in_limits.max()) < _SMALL_STEP else None
        done += 1
    return ScaleFit(tuple(poses), done, step_mm)
