"""One view's part of the normal equations for poses and cameras; `view_system_in_numpy` is the reference."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray
from screwpose.geometry import rigid
from screwpose.projection.thickness import MotionFrame, path_lengths
from screwpose.registration.thickness_fit import Body, packed
from screwpose.similarity.blurred import FINE, Blur, derivatives_of_bodies, explain_blurred, without_response
from screwpose.similarity.blurred import PARAMETERS as OF_BLUR
from screwpose.similarity.blurred_assessment import assess_blurred
from screwpose.similarity.thickness import GradientTarget

OF_INTRINSICS = 3
OF_IMAGE = OF_INTRINSICS + OF_BLUR
"""Unknowns of a view that move the image, not what is seen: focal length, principal point, the detector's blur."""

# Derivatives that were smoothed by 1.3 px share their noise with their neighbours: so many of them count as one. What
# the model leaves out, bone beside the screw or a blur of another shape, goes on for longer: over so much of the screw.
# With noise alone distances were 5 sigma off, and focal length and depth wandered off together by several sigma.
_CORRELATED_PX = 8.0
_CORRELATED_MM2 = 5.0
_MARGIN_PX = 8

Window = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class ViewSystem:
    """The bodies' motions (6 B), then the logarithm of the focal length, the principal point in u and v, and the blur.

    Parameters
    ----------
    information, gradient : (6 B + 7, 6 B + 7) and (6 B + 7,).
    energy : the share of the image's gradient energy that is explained.
    """

    information: FloatArray
    gradient: FloatArray
    energy: float


def view_system(target: GradientTarget, bodies: Sequence[Body], poses: Sequence[FloatArray], blur: Blur) -> ViewSystem:
    """Linearise one view at some poses, world_from_cad (4, 4).

    A body's motion is a rotation vector in world about its centre, then a shift in world.
    """
    found = assess_blurred(target, packed(bodies, target.scale), poses, blur)
    alike = _pixels_that_count_as_one(target, bodies, poses)
    return ViewSystem(found.information / alike, found.gradient / alike, found.energy)


def view_system_in_numpy(
    target: GradientTarget, bodies: Sequence[Body], poses: Sequence[FloatArray], blur: Blur
) -> ViewSystem:
    """The same by NumPy and OpenCV, of the full meshes, within windows about the bodies."""
    first = 6 * len(bodies)
    size = first + OF_IMAGE
    windows = [_window(target, body, pose) for body, pose in zip(bodies, poses, strict=True)]
    window = (_spanned([one[0] for one in windows]), _spanned([one[1] for one in windows]))
    lengths: FloatArray = np.zeros((window[0].stop - window[0].start, window[1].stop - window[1].start))
    fine: FloatArray = np.zeros((FINE * lengths.shape[0], FINE * lengths.shape[1]))
    motions = []
    for body, pose, own in zip(bodies, poses, windows, strict=True):
        alone, by_motion = _rendered(target, body, pose, own)
        fine[_parts_of(_inside(own, window))] += alone
        lengths[_inside(own, window)] += _means(alone)
        motions.append(_means(by_motion))
    found = explain_blurred(target, lengths, window, blur, fine)
    if found is None:
        return ViewSystem(np.zeros((size, size)), np.zeros(size), 0.0)
    count = len(found.near)
    place: NDArray[np.int64] = np.full(lengths.shape, -1, dtype=np.int64)
    place.ravel()[found.near] = np.arange(count)
    columns = np.zeros((size + len(found.by_response), 2 * count))
    for index, (own, by_motion) in enumerate(zip(windows, motions, strict=True)):
        where = place[_inside(own, window)]
        slope = found.slope[_inside(own, window)]
        moved = derivatives_of_bodies(target, blur, slope, by_motion, where >= 0)
        used = where[where >= 0]
        columns[6 * index : 6 * index + 6, used] = moved[:, 0]
        columns[6 * index : 6 * index + 6, count + used] = moved[:, 1]
    columns[first : first + OF_INTRINSICS] = found.by_intrinsics
    columns[first + OF_INTRINSICS : size] = found.by_blur
    columns[size:] = found.by_response
    weighted = columns * (found.weights / (found.spread**2 * _pixels_that_count_as_one(target, bodies, poses)))
    return ViewSystem(*without_response(weighted @ columns.T, weighted @ found.residuals, size), found.energy)


def _pixels_that_count_as_one(target: GradientTarget, bodies: Sequence[Body], poses: Sequence[FloatArray]) -> float:
    centers = [rigid.transform(pose, body.implant.center_mm) for body, pose in zip(bodies, poses, strict=True)]
    depth_mm = float(np.mean(rigid.transform(target.camera_from_world, np.stack(centers))[:, 2]))
    return max(_CORRELATED_PX, _CORRELATED_MM2 * float(target.intrinsics[0, 0] / depth_mm) ** 2)


def _rendered(
    target: GradientTarget, body: Body, pose: FloatArray, window: Window
) -> tuple[FloatArray, NDArray[np.float32]]:
    """The path lengths of every pixel's parts, and how they change; the parts' middles are about the pixel's own."""
    K = target.intrinsics * [[FINE], [FINE], [1.0]]
    K[:2, 2] += 0.5 * (FINE - 1)
    camera_from_cad = target.camera_from_world @ pose
    center = rigid.transform(camera_from_cad, body.implant.center_mm)
    frame = MotionFrame(center, target.camera_from_world[:3, :3].T)
    found = path_lengths(K, camera_from_cad, body.mesh.vertices_mm, body.mesh.faces, _parts_of(window), frame)
    assert found.by_motion is not None
    return found.lengths_mm, found.by_motion


def _parts_of(window: Window) -> Window:
    rows, columns = (slice(FINE * part.start, FINE * part.stop) for part in window)
    return rows, columns


def _means(parts: NDArray[Any]) -> NDArray[Any]:
    """Of every pixel's parts."""
    rows, columns, *rest = parts.shape
    return np.asarray(parts.reshape(rows // FINE, FINE, columns // FINE, FINE, *rest).mean(axis=(1, 3)))


def _window(target: GradientTarget, body: Body, pose: FloatArray) -> Window:
    """Where a body is in the image, and as much around it as derivatives reach."""
    points_mm = rigid.transform(target.camera_from_world @ pose, body.mesh.vertices_mm)
    homogeneous = points_mm @ target.intrinsics.T
    pixels = homogeneous[:, :2] / np.maximum(homogeneous[:, 2:], 1e-6)
    rows, columns = target.shape
    first = np.clip(np.floor(pixels.min(axis=0)) - _MARGIN_PX, 0, [columns - 1, rows - 1]).astype(int)
    last = np.clip(np.ceil(pixels.max(axis=0)) + _MARGIN_PX + 1, first + 1, [columns, rows]).astype(int)
    return slice(int(first[1]), int(last[1])), slice(int(first[0]), int(last[0]))


def _spanned(parts: Sequence[slice]) -> slice:
    return slice(min(part.start for part in parts), max(part.stop for part in parts))


def _inside(part: Window, whole: Window) -> Window:
    """A window of the image as a part of a larger one."""
    rows, columns = (
        slice(own.start - all_.start, own.stop - all_.start) for own, all_ in zip(part, whole, strict=True)
    )
    return rows, columns
