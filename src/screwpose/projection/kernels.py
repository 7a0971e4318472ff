"""Compiled loops of the bit-row silhouette. numba is slow to import: only `silhouette` and its peers load this module.

A mask is a row of bits a row of pixels, 64 to a word: bit k of word w is column ``64 w + k``. Loops over words and
bits, not over pixels. One thread each, no shared state: callers may run them in several threads at once.
"""

import math

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


@intrinsic
def count_bits(_context, _word):
    """How many bits of a uint64 are set: one machine instruction."""
    return types.uint64(types.uint64), lambda _c, builder, _s, args: builder.ctpop(args[0])


@intrinsic
def lowest_bit(_context, _word):
    """The place of the lowest set bit of a uint64; 64 where none is."""
    no = ir.Constant(ir.IntType(1), 0)
    return types.uint64(types.uint64), lambda _c, builder, _s, args: builder.cttz(args[0], no)


@njit(cache=True, nogil=True, error_model="numpy")
def project(pixels_from_cad, vertices_mm, u, v):
    """Vertices (N, 3) by a projection (3, 4) into u and v (N,); returns the smallest depth."""
    P = pixels_from_cad
    nearest = np.inf
    for i in range(vertices_mm.shape[0]):
        x, y, z = vertices_mm[i, 0], vertices_mm[i, 1], vertices_mm[i, 2]
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        nearest = min(nearest, depth)
        u[i] = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth
        v[i] = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth
    return nearest


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def set_run(bits, row, left, right):
    """Set the bits of a row from column `left` to column `right`, both included."""
    first_word, last_word = left >> 6, right >> 6
    from_left, to_right = _ALL << np.uint64(left & 63), _ALL >> np.uint64(63 - (right & 63))
    if first_word == last_word:
        bits[row, first_word] |= from_left & to_right
    else:
        bits[row, first_word] |= from_left
        for word in range(first_word + 1, last_word):
            bits[row, word] = _ALL
        bits[row, last_word] |= to_right


@njit(cache=True, nogil=True, error_model="numpy")
def fill_within(u, v, faces, one_sided, bits, columns, extents):
    """Set the bits of every pixel whose centre lies in or on the edge of a triangle.

    Parameters
    ----------
    u, v : (N,) vertices, px.
    faces : (F, 3).
    one_sided : leave out the triangles that turn one way: those of a closed surface that face the other way cover
        the same pixels.
    bits : (rows, words), uint64; bits beyond `columns` stay as they are.
    extents : (rows, 2), widened: first and last word (not included) of each row that holds a bit.

    Returns
    -------
    The first row that a triangle covers, and the last (not included).
    """
    rows = bits.shape[0]
    top, bottom = rows, 0
    for face in range(faces.shape[0]):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        xa, ya, xb, yb, xc, yc = u[a], v[a], u[b], v[b], u[c], v[c]
        doubled_area = (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)
        if doubled_area == 0.0 or (one_sided and doubled_area < 0.0):
            continue
        if yb < ya:
            xa, ya, xb, yb = xb, yb, xa, ya
        if yc < ya:
            xa, ya, xc, yc = xc, yc, xa, ya
        if yc < yb:
            xb, yb, xc, yc = xc, yc, xb, yb
        first, last = max(math.ceil(ya), 0), min(math.floor(yc), rows - 1)
        if first > last:
            continue
        long_slope = (xc - xa) / (yc - ya)
        upper_slope = (xb - xa) / (yb - ya) if yb > ya else 0.0
        lower_slope = (xc - xb) / (yc - yb) if yc > yb else 0.0
        for row in range(first, last + 1):
            on_long = xa + (row - ya) * long_slope
            on_short = xa + (row - ya) * upper_slope if row < yb else xb + (row - yb) * lower_slope
            left = max(math.ceil(min(on_long, on_short)), 0)
            right = min(math.floor(max(on_long, on_short)), columns - 1)
            if left > right:
                continue
            set_run(bits, row, left, right)
            extents[row, 0] = min(extents[row, 0], left >> 6)
            extents[row, 1] = max(extents[row, 1], (right >> 6) + 1)
        top, bottom = min(top, first), max(bottom, last + 1)
    return top, bottom


@njit(cache=True, nogil=True, error_model="numpy")
def fill(u, v, faces, one_sided, bits, columns):
    """As `fill_within`, where nobody asks in which words the bits are."""
    fill_within(u, v, faces, one_sided, bits, columns, np.zeros((bits.shape[0], 2), dtype=np.int64))


@njit(cache=True, nogil=True, error_model="numpy")
def to_camera(camera_from_cad, intrinsics, vertices_mm, points_mm, u, v):
    """Vertices (N, 3) in the camera's frame (N, 3) and on the detector, u and v (N,); returns the smallest depth."""
    T, K = camera_from_cad, intrinsics
    nearest = np.inf
    for i in range(vertices_mm.shape[0]):
        x, y, z = vertices_mm[i, 0], vertices_mm[i, 1], vertices_mm[i, 2]
        for k in range(3):
            points_mm[i, k] = T[k, 0] * x + T[k, 1] * y + T[k, 2] * z + T[k, 3]
        depth = points_mm[i, 2]
        nearest = min(nearest, depth)
        u[i] = (K[0, 0] * points_mm[i, 0] + K[0, 1] * points_mm[i, 1]) / depth + K[0, 2]
        v[i] = K[1, 1] * points_mm[i, 1] / depth + K[1, 2]
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def add_depths(
    points_mm, u, v, faces, detector_from_ray, first_row, first_column, depths, slopes, moments, least_cosine
):
    """Add the signed depth of every face to the pixels it covers, and how it changes when the body moves.

    A pixel on a shared edge belongs to exactly one of the two faces (half-open rows and columns, and an edge's crossing
    is computed from its upper end whichever face asks), so that over a closed surface the depths add up to the length
    inside. Where a face with normal n and ``n . X = c`` is moved by w, its depth z along a fixed ray changes by
    ``(n . w) z / c``; signed as its depth is, that is ``z / |c| n . w``.

    Parameters
    ----------
    points_mm : (N, 3), in the camera's frame; u, v (N,) their pixels.
    detector_from_ray : (3, 3), the inverse of the intrinsics: ``r = K^-1 [u v 1]``, of depth 1.
    depths : (rows, columns), the sum of the signed depths, mm: minus where a ray enters, plus where it leaves.
    slopes : (rows, columns, 3), the sum of ``z / |c| n``; empty (0, 0, 3) where it is not wanted.
    moments : (rows, columns, 3), the sum of ``z^2 / |c| n``; the ray times it is the slope's moment.
    least_cosine : between ray and normal; below it a face is grazed, and its slopes are held down.
    """
    rows, columns = depths.shape
    with_slopes = slopes.shape[0] > 0
    Q = detector_from_ray
    for face in range(faces.shape[0]):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ux, uy, uz = (
            points_mm[b, 0] - points_mm[a, 0],
            points_mm[b, 1] - points_mm[a, 1],
            points_mm[b, 2] - points_mm[a, 2],
        )
        wx, wy, wz = (
            points_mm[c, 0] - points_mm[a, 0],
            points_mm[c, 1] - points_mm[a, 1],
            points_mm[c, 2] - points_mm[a, 2],
        )
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        offset = nx * points_mm[a, 0] + ny * points_mm[a, 1] + nz * points_mm[a, 2]
        if offset == 0.0:
            continue
        xa, ya, xb, yb, xc, yc = u[a], v[a], u[b], v[b], u[c], v[c]
        if yb < ya:
            xa, ya, xb, yb = xb, yb, xa, ya
        if yc < ya:
            xa, ya, xc, yc = xc, yc, xa, ya
        if yc < yb:
            xb, yb, xc, yc = xc, yc, xb, yb
        begin = max(math.ceil(ya) - first_row, 0)
        end = min(math.ceil(yc) - first_row, rows)
        if begin >= end:
            continue
        long_slope = (xc - xa) / (yc - ya)
        upper_slope = (xb - xa) / (yb - ya) if yb > ya else 0.0
        lower_slope = (xc - xb) / (yc - yb) if yc > yb else 0.0
        near = min(points_mm[a, 2], points_mm[b, 2], points_mm[c, 2])
        far = max(points_mm[a, 2], points_mm[b, 2], points_mm[c, 2])
        sign = 1.0 if offset > 0.0 else -1.0
        steepest = 1.0 / (least_cosine * math.sqrt(nx * nx + ny * ny + nz * nz))
        # The inverse depth is linear over the detector.
        per_column = nx * Q[0, 0] / offset
        per_row = (nx * Q[0, 1] + ny * Q[1, 1]) / offset
        at_origin = (nx * Q[0, 2] + ny * Q[1, 2] + nz) / offset
        for row in range(begin, end):
            y = row + first_row
            on_long = xa + (y - ya) * long_slope
            on_short = xa + (y - ya) * upper_slope if y < yb else xb + (y - yb) * lower_slope
            left = max(math.ceil(min(on_long, on_short)) - first_column, 0)
            right = min(math.ceil(max(on_long, on_short)) - first_column, columns)
            inverse = at_origin + per_row * y + per_column * (first_column + left)
            for column in range(left, right):
                # A pixel is inside the face, so its depth is between the corners': holds for slivers too.
                depth = min(max(1.0 / inverse, near), far) if inverse > 0.0 else far
                inverse += per_column
                depths[row, column] += sign * depth
                if with_slopes:
                    slope = min(depth / abs(offset), steepest)
                    slopes[row, column, 0] += slope * nx
                    slopes[row, column, 1] += slope * ny
                    slopes[row, column, 2] += slope * nz
                    moments[row, column, 0] += slope * depth * nx
                    moments[row, column, 1] += slope * depth * ny
                    moments[row, column, 2] += slope * depth * nz


@njit(cache=True, nogil=True, error_model="numpy")
def finish_lengths(
    depths, slopes, moments, detector_from_ray, first_row, first_column, pivot_mm, world_from_camera, by_motion
):
    """Turn sums of depths into lengths along the rays, in place, and their slopes into derivatives by a motion.

    Parameters
    ----------
    depths, slopes, moments : as `add_depths` left them.
    pivot_mm : (3,), in the camera's frame; rotations are about it.
    world_from_camera : (3, 3), in whose axes rotations and shifts are meant.
    by_motion : (rows, columns, 6), filled where the slopes are wanted.
    """
    rows, columns = depths.shape
    Q, R, p = detector_from_ray, world_from_camera, pivot_mm
    with_slopes = slopes.shape[0] > 0
    for row in range(rows):
        y = row + first_row
        for column in range(columns):
            if depths[row, column] == 0.0:
                continue
            x = column + first_column
            rx = Q[0, 0] * x + Q[0, 1] * y + Q[0, 2]
            ry = Q[1, 1] * y + Q[1, 2]
            length_per_depth = math.sqrt(rx * rx + ry * ry + 1.0)
            depths[row, column] *= length_per_depth
            if with_slopes:
                sx, sy, sz = slopes[row, column, 0], slopes[row, column, 1], slopes[row, column, 2]
                mx, my, mz = moments[row, column, 0], moments[row, column, 1], moments[row, column, 2]
                # The ray, of depth 1, times the moment, less the pivot times the slope.
                tx = ry * mz - my - (p[1] * sz - p[2] * sy)
                ty = mx - rx * mz - (p[2] * sx - p[0] * sz)
                tz = rx * my - ry * mx - (p[0] * sy - p[1] * sx)
                for k in range(3):
                    by_motion[row, column, k] = (R[k, 0] * tx + R[k, 1] * ty + R[k, 2] * tz) * length_per_depth
                    by_motion[row, column, 3 + k] = (R[k, 0] * sx + R[k, 1] * sy + R[k, 2] * sz) * length_per_depth
