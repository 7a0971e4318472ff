"""How much metal lies along each ray, and how that changes when the body moves: path lengths of posed meshes.

Along a ray, the distances at which it leaves a closed surface minus those at which it enters are the length inside,
whatever the nesting. Each face adds its own distance, with its sign, to the pixels that it covers; the derivative by
the pose comes from the same pass, since a face's depth along a fixed ray follows from its plane.

The simulator has its own path lengths, by other code: what judges must not share a fault with what is judged.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from screwpose._types import FloatArray, IntArray
from screwpose.errors import BehindSourceError, GeometryError

# Faces that a ray grazes change its length without bound; below this cosine their share is held down. The lengths near
# a body's rim are blurred over more than that wherever they are used.
_LEAST_COSINE = 0.03

Window = tuple[slice, slice]
"""Rows and columns of a part of the image."""


@dataclass(frozen=True, eq=False)
class PathLengths:
    """Path lengths in a part of an image.

    Parameters
    ----------
    lengths_mm : (rows, columns), along the ray through each pixel's centre.
    by_motion : (rows, columns, 6), float32, their derivative by a motion of the body: a rotation vector (mm per rad),
        then a shift (mm per mm). None where it was not asked for.
    """

    lengths_mm: FloatArray
    by_motion: NDArray[np.float32] | None


@dataclass(frozen=True, eq=False)
class MotionFrame:
    """In which motions are meant: about `pivot_mm` (3,), in the camera's frame, along the axes of `world_from_camera`
    (3, 3). By default about the source and along the camera's own axes."""

    pivot_mm: FloatArray = field(default_factory=lambda: np.zeros(3))
    world_from_camera: FloatArray = field(default_factory=lambda: np.eye(3))


def path_lengths(
    intrinsics: FloatArray,
    camera_from_cad: FloatArray,
    vertices_mm: FloatArray,
    faces: IntArray,
    window: Window,
    motion: MotionFrame | None = None,
) -> PathLengths:
    """Path lengths through a closed mesh.

    Parameters
    ----------
    intrinsics : K (3, 3), upper triangular, px.
    camera_from_cad : (4, 4), mm; the camera looks along +z.
    vertices_mm, faces : (N, 3) and (F, 3), counter-clockwise seen from outside, closed. Where it is open the sums do
        not cancel, and rays through a hole get lengths of hundreds of mm.
    window : the part of the image that is computed.
    motion : whose derivatives are wanted; none by default.

    Raises
    ------
    BehindSourceError
        A vertex is not in front of the source.
    GeometryError
        The camera's frame is left-handed: lengths would come out negative.
    """
    from screwpose.projection import kernels

    if np.linalg.det(camera_from_cad[:3, :3]) < 0:
        raise GeometryError("a camera frame that is left-handed: mirror the image, and its matrix, first")
    rows, columns = (part.stop - part.start for part in window)
    first_row, first_column = window[0].start, window[1].start
    points, u, v = np.empty((len(vertices_mm), 3)), np.empty(len(vertices_mm)), np.empty(len(vertices_mm))
    nearest_mm = kernels.to_camera(camera_from_cad, intrinsics, vertices_mm, points, u, v)
    if len(vertices_mm) and not nearest_mm > 0.0:
        raise BehindSourceError(f"a vertex at a depth of {nearest_mm:.4g} mm is not in front of the X-ray source")
    depths = np.zeros((rows, columns))
    with_motion = motion is not None
    slopes, moments = (np.zeros((rows, columns, 3) if with_motion else (0, 0, 3)) for _ in range(2))
    by_motion = np.zeros((rows, columns, 6) if with_motion else (0, 0, 6), dtype=np.float32)
    inverse: FloatArray = np.asarray(np.linalg.inv(intrinsics), dtype=np.float64)
    frame = motion or MotionFrame()
    kernels.add_depths(points, u, v, faces, inverse, first_row, first_column, depths, slopes, moments, _LEAST_COSINE)
    kernels.finish_lengths(
        depths, slopes, moments, inverse, first_row, first_column, np.ascontiguousarray(frame.pivot_mm),
        np.ascontiguousarray(frame.world_from_camera), by_motion,
    )  # fmt: skip
    return PathLengths(depths, by_motion if with_motion else None)


def rays_of_depth_one(detector_from_ray: FloatArray, window: Window) -> FloatArray:
    """``K^-1 [u v 1]`` of every pixel of a window, (rows, columns, 3), from K^-1 (3, 3)."""
    u, v = np.meshgrid(
        np.arange(window[1].start, window[1].stop), np.arange(window[0].start, window[0].stop), indexing="xy"
    )
    return np.asarray(np.stack([u, v, np.ones_like(u)], axis=2) @ detector_from_ray.T, dtype=np.float64)
