"""Numba kernels for what fills bodies and the space between them: grains of a texture, a CT volume's voxels.

Importing this module imports numba. numba's cache on disk knows a kernel's own file only: who edits this one clears
`__pycache__`, or the kernels of `rays_kernels` that call these stay as they were.
"""

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
# float64 or float32, int64 or int32: numba compiles a kernel for what it is given.
Floats: TypeAlias = NDArray[np.floating[Any]]
Ints: TypeAlias = NDArray[np.signedinteger[Any]]


def kernel(function: Kernel) -> Kernel:
    """`njit` with the options of all kernels here, its type kept. No fastmath: the fill rule needs exact equality."""
    return cast(Kernel, njit(nogil=True, cache=True)(function))


@kernel
def noise_along(noise: Floats, grain: Floats, px: float, py: float, begin: float, end: float) -> float:
    """The integral of a body's noise over depth, from begin to end, along the ray of a pixel; trilinear.

    Parameters
    ----------
    noise : (side + 1,) * 3, its last planes equal to its first ones: it repeats. The side is a power of two.
    grain : (3, 4), the body's row of `grains`: where on the ray lies what in the noise, see `rays_texture`.
    """
    side = noise.shape[0] - 1
    du = grain[0, 0] * px + grain[0, 1] * py + grain[0, 2]
    dv = grain[1, 0] * px + grain[1, 1] * py + grain[1, 2]
    dw = grain[2, 0] * px + grain[2, 1] * py + grain[2, 2]
    # Steps of a grid point and a half: grains are of two or more.
    steps = int((end - begin) * np.sqrt(du * du + dv * dv + dw * dw) / 1.5) + 1
    step = (end - begin) / steps
    first = begin + 0.5 * step
    # Shifted by whole periods to positive coordinates, so that cutting off the fraction rounds down.
    u, v, w = grain[0, 3] + first * du, grain[1, 3] + first * dv, grain[2, 3] + first * dw
    u += side * np.ceil(max(-min(u, u + steps * step * du), 0.0) / side)
    v += side * np.ceil(max(-min(v, v + steps * step * dv), 0.0) / side)
    w += side * np.ceil(max(-min(w, w + steps * step * dw), 0.0) / side)
    du, dv, dw = du * step, dv * step, dw * step
    total = np.float32(0.0)
    for _ in range(steps):
        i, j, k = int(u), int(v), int(w)
        fu, fv, fw = np.float32(u - i), np.float32(v - j), np.float32(w - k)
        i, j, k = i & (side - 1), j & (side - 1), k & (side - 1)
        c00 = noise[i, j, k] + fw * (noise[i, j, k + 1] - noise[i, j, k])
        c01 = noise[i, j + 1, k] + fw * (noise[i, j + 1, k + 1] - noise[i, j + 1, k])
        c10 = noise[i + 1, j, k] + fw * (noise[i + 1, j, k + 1] - noise[i + 1, j, k])
        c11 = noise[i + 1, j + 1, k] + fw * (noise[i + 1, j + 1, k + 1] - noise[i + 1, j + 1, k])
        c0 = c00 + fv * (c01 - c00)
        total += c0 + fu * (c10 + fv * (c11 - c10) - c0)
        u, v, w = u + du, v + dv, w + dw
    return float(total * step)


@kernel
def _volume_span(box: Floats, ray: Floats, reach: Floats) -> None:
    """Where a ray is within a box: depths into `reach` (2,); an empty span where it misses.

    Parameters
    ----------
    box : (3,), the box reaches from 0 to these voxel coordinates.
    ray : (3, 2), voxel coordinates are ``ray[:, 0] + depth * ray[:, 1]``.
    """
    near, far = 0.0, np.inf
    for axis in range(3):
        origin, slope = ray[axis, 0], ray[axis, 1]
        if slope == 0.0:
            if origin < 0.0 or origin > box[axis]:
                far = -1.0
            continue
        one, two = -origin / slope, (box[axis] - origin) / slope
        near, far = max(near, min(one, two)), min(far, max(one, two))
    reach[0], reach[1] = near, max(near, far)


@kernel
def march(volume: Floats, world_step: Floats, px: float, py: float, cumulative: Floats, reach: Floats) -> int:
    """Integrate the volume's two channels over depth along the ray of a pixel.

    Parameters
    ----------
    volume : (I, J, K, 2), between its grid points trilinear, nothing outside them.
    world_step : (3, 4), voxel coordinates are ``world_step[:, 3] + depth * world_step[:, :3] @ [px, py, 1]``.
    cumulative : (S, 2), receives the integral from the volume's border to each step's end.
    reach : (2,), receives the depths between which the ray is in the volume.

    Returns
    -------
    The number of steps, of one voxel or less each; 0 where the ray misses the volume.
    """
    ray = np.empty((3, 2))
    box = np.empty(3)
    speed = 0.0
    for axis in range(3):
        ray[axis, 0] = world_step[axis, 3]
        ray[axis, 1] = world_step[axis, 0] * px + world_step[axis, 1] * py + world_step[axis, 2]
        box[axis] = volume.shape[axis] - 1
        speed += ray[axis, 1] ** 2
    _volume_span(box, ray, reach)
    steps = min(int(np.ceil((reach[1] - reach[0]) * np.sqrt(speed))), len(cumulative) - 1)
    if steps < 1:
        return 0
    step = (reach[1] - reach[0]) / steps
    cumulative[0, 0], cumulative[0, 1] = 0.0, 0.0
    flat = volume.ravel()
    along_j = 2 * volume.shape[2]
    along_i = along_j * volume.shape[1]
    most_i, most_j, most_k = volume.shape[0] - 2, volume.shape[1] - 2, volume.shape[2] - 2
    for s in range(steps):
        at = reach[0] + (s + 0.5) * step
        u = min(max(ray[0, 0] + at * ray[0, 1], 0.0), box[0])
        v = min(max(ray[1, 0] + at * ray[1, 1], 0.0), box[1])
        w = min(max(ray[2, 0] + at * ray[2, 1], 0.0), box[2])
        i, j, k = min(int(u), most_i), min(int(v), most_j), min(int(w), most_k)
        du, dv, dw = u - i, v - j, w - k
        # Unsigned: numba then does without a check for negative indices.
        here = np.uint64(i * along_i + j * along_j + 2 * k)
        for channel in range(2):
            c00 = flat[here] * (1.0 - dw) + flat[here + np.uint64(2)] * dw
            beside = here + np.uint64(along_j)
            c01 = flat[beside] * (1.0 - dw) + flat[beside + np.uint64(2)] * dw
            behind = here + np.uint64(along_i)
            c10 = flat[behind] * (1.0 - dw) + flat[behind + np.uint64(2)] * dw
            behind += np.uint64(along_j)
            c11 = flat[behind] * (1.0 - dw) + flat[behind + np.uint64(2)] * dw
            c0, c1 = c00 * (1.0 - dv) + c01 * dv, c10 * (1.0 - dv) + c11 * dv
            cumulative[s + 1, channel] = cumulative[s, channel] + (c0 * (1.0 - du) + c1 * du) * step
            here += np.uint64(1)
    return steps


@kernel
def up_to(cumulative: Floats, channel: int, steps: int, reach: Floats, depth: float) -> float:
    """The volume's integral from its border to a depth."""
    if depth <= reach[0]:
        return 0.0
    if depth >= reach[1]:
        return float(cumulative[steps, channel])
    at = (depth - reach[0]) / (reach[1] - reach[0]) * steps
    s = min(int(at), steps - 1)
    return float(cumulative[s, channel] + (at - s) * (cumulative[s + 1, channel] - cumulative[s, channel]))
