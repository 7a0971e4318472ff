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
LEAST_COSINE = 0.03

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
    from screwpose.projection.length_kernels import draw

    if np.linalg.det(camera_from_cad[:3, :3]) < 0:
        raise GeometryError("a camera frame that is left-handed: mirror the image, and its matrix, first")
    frame = motion or MotionFrame()
    camera_from_axes = np.eye(4)
    camera_from_axes[:3, :3] = frame.world_from_camera.T
    bounds = np.array([window[0].start, window[0].stop, window[1].start, window[1].stop])
    drawn = draw(
        np.ascontiguousarray(intrinsics, dtype=np.float64),
        camera_from_axes,
        np.ascontiguousarray(np.linalg.inv(camera_from_axes) @ camera_from_cad)[None],
        np.linalg.solve(camera_from_cad, np.append(frame.pivot_mm, 1.0))[None, :3].copy(),
        np.ascontiguousarray(vertices_mm, dtype=np.float64),
        np.array([0, len(vertices_mm)]),
        np.ascontiguousarray(faces, dtype=np.int64),
        np.array([0, len(faces)]),
        bounds,
        motion is not None,
        LEAST_COSINE,
    )
    if len(vertices_mm) and not drawn.nearest_mm > 0.0:
        raise BehindSourceError(f"a vertex at a depth of {drawn.nearest_mm:.4g} mm is not in front of the X-ray source")
    rows, columns = (part.stop - part.start for part in window)
    lengths_mm = np.zeros((rows, columns))
    by_motion = np.zeros((rows, columns, 6), dtype=np.float32)
    for row, (first, last, begin) in enumerate(
        zip(drawn.first_column, drawn.last_column, drawn.offset[:-1], strict=True), drawn.first_row[0] - bounds[0]
    ):
        own, values = slice(first - bounds[2], last - bounds[2]), slice(begin, begin + last - first)
        lengths_mm[row, own] = drawn.lengths_mm[values]
        if motion is not None:
            by_motion[row, own] = drawn.by_motion[:, values].T
    return PathLengths(lengths_mm, None if motion is None else by_motion)


def rays_of_depth_one(detector_from_ray: FloatArray, window: Window) -> FloatArray:
    """``K^-1 [u v 1]`` of every pixel of a window, (rows, columns, 3), from K^-1 (3, 3)."""
    u, v = np.meshgrid(
        np.arange(window[1].start, window[1].stop), np.arange(window[0].start, window[0].stop), indexing="xy"
    )
    return np.asarray(np.stack([u, v, np.ones_like(u)], axis=2) @ detector_from_ray.T, dtype=np.float64)
