"""Compiled loops over triangles. Only `deviation` loads this module."""

import numpy as np
from numba import njit

_LEAF = 4  # triangles that a box holds at most, without boxes of its own


@njit(cache=True, nogil=True)
def boxes_of(triangles):
    """A tree of boxes round triangles (F, 3, 3).

    Returns
    -------
    order (F,) of the triangles; for each of B boxes its corners (B, 6), low and high; and (B, 2): the first of its two
    boxes and -1, or, where it holds triangles itself, the first of them in the order and the first beyond.
    """
    count = len(triangles)
    order = np.arange(count)
    corners, holds = np.empty((2 * count + 1, 6)), np.empty((2 * count + 1, 2), dtype=np.int64)
    first_of, last_of = np.empty(2 * count + 1, dtype=np.int64), np.empty(2 * count + 1, dtype=np.int64)
    first_of[0], last_of[0] = 0, count
    made, looked = 1, 0
    while looked < made:
        first, last = first_of[looked], last_of[looked]
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for index in range(first, last):
            for corner in range(3):
                for axis in range(3):
                    value = triangles[order[index], corner, axis]
                    low[axis], high[axis] = min(low[axis], value), max(high[axis], value)
        corners[looked, :3], corners[looked, 3:] = low, high
        if last - first <= _LEAF:
            holds[looked, 0], holds[looked, 1] = first, last
        else:
            axis = np.argmax(high - low)
            middles = np.empty(last - first)
            for index in range(first, last):
                one = triangles[order[index], :, axis]
                middles[index - first] = one[0] + one[1] + one[2]
            order[first:last] = order[first:last][np.argsort(middles, kind="mergesort")]
            half = (first + last) // 2
            holds[looked, 0], holds[looked, 1] = made, -1
            first_of[made], last_of[made] = first, half
            first_of[made + 1], last_of[made + 1] = half, last
            made += 2
        looked += 1
    return order, corners[:made], holds[:made]


@njit(cache=True, nogil=True)
def farthest(points, triangles, order, corners, holds, enough):
    """The largest distance of any point (N, 3) from its nearest triangle: infinite, and soon, if more than `enough`.

    Parameters
    ----------
    order, corners, holds : as `boxes_of` gives them.
    """
    worst = 0.0
    stack = np.empty(128, dtype=np.int64)
    for index in range(len(points)):
        x, y, z = points[index, 0], points[index, 1], points[index, 2]
        best = enough * enough
        is_found = False
        stack[0], height = 0, 1
        while height > 0:
            height -= 1
            box = stack[height]
            if _square_from_box(x, y, z, corners[box]) > best:
                continue
            if holds[box, 1] < 0:
                near, far = holds[box, 0], holds[box, 0] + 1
                if _square_from_box(x, y, z, corners[near]) > _square_from_box(x, y, z, corners[far]):
                    near, far = far, near
                stack[height], stack[height + 1] = far, near
                height += 2
                continue
            for place in range(holds[box, 0], holds[box, 1]):
                square = _square_from_triangle(x, y, z, triangles[order[place]])
                if square <= best:
                    best, is_found = square, True
        if not is_found:
            return np.inf
        worst = max(worst, best)
    return np.sqrt(worst)


@njit(cache=True, nogil=True)
def _square_from_box(x, y, z, box):
    dx, dy, dz = max(box[0] - x, 0.0, x - box[3]), max(box[1] - y, 0.0, y - box[4]), max(box[2] - z, 0.0, z - box[5])
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def _square_from_triangle(x, y, z, triangle):
    """Squared distance of a point from a triangle (3, 3): from its plane where the foot lies inside, else its edges."""
    ax, ay, az = triangle[1] - triangle[0]
    bx, by, bz = triangle[2] - triangle[0]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    size = nx * nx + ny * ny + nz * nz
    is_inside = size > 0.0
    best = np.inf
    for first in range(3):
        p, q = triangle[first], triangle[(first + 1) % 3]
        ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        dx, dy, dz = x - p[0], y - p[1], z - p[2]
        length = ex * ex + ey * ey + ez * ez
        along = min(max((dx * ex + dy * ey + dz * ez) / length, 0.0), 1.0) if length > 0.0 else 0.0
        fx, fy, fz = dx - along * ex, dy - along * ey, dz - along * ez
        best = min(best, fx * fx + fy * fy + fz * fz)
        # Left of every edge, seen from the normal's side: the foot is inside.
        side = (ny * ez - nz * ey) * dx + (nz * ex - nx * ez) * dy + (nx * ey - ny * ex) * dz
        is_inside = is_inside and side >= 0.0
    if is_inside:
        above = nx * (x - triangle[0, 0]) + ny * (y - triangle[0, 1]) + nz * (z - triangle[0, 2])
        best = min(best, above * above / size)
    return best
