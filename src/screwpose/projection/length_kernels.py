"""Compiled loops of the path lengths. numba is slow to import: only `thickness` and the fit's own kernels load this.

What a body covers is kept row by row, as the span from its first column to its last: a tower that stands askew covers a
tenth of its bounding box. All loops run on one thread without the interpreter's lock, so that callers may run several.
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit

from screwpose.projection.kernels import upright

Drawn = namedtuple(
    "Drawn",
    ["first_row", "row_start", "first_column", "last_column", "offset", "lengths_mm", "by_motion", "nearest_mm"],
)
"""Several bodies in one view. Body b has the rows of the image from first_row[b] on; their spans stand in the tables
first_column, last_column (not included) and offset from row_start[b] to row_start[b + 1]. The values of a row stand in
lengths_mm (n,) and by_motion (6, n) from its offset on. nearest_mm is the smallest depth of a vertex."""


@njit(cache=True, nogil=True, error_model="numpy")
def _multiply(first, second, product):
    """The product of two matrices (4, 4)."""
    for i in range(4):
        for j in range(4):
            product[i, j] = 0.0
            for k in range(4):
                product[i, j] += first[i, k] * second[k, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse_intrinsics(intrinsics):
    """The inverse (3, 3) of an upper triangular K with 1 in its corner."""
    K, inverse = intrinsics, np.zeros((3, 3))
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = 1.0 / K[0, 0], 1.0 / K[1, 1], 1.0
    inverse[0, 1] = -K[0, 1] * inverse[0, 0] * inverse[1, 1]
    inverse[1, 2] = -K[1, 2] * inverse[1, 1]
    inverse[0, 2] = -(K[0, 2] + K[0, 1] * inverse[1, 2]) * inverse[0, 0]
    return inverse


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
def _find_spans(u, v, faces, bounds, first_column, last_column):
    """The columns that the faces cover in each row of `bounds` (first row, its end, first column, its end)."""
    for face in range(faces.shape[0]):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        top, bottom = min(v[a], v[b], v[c]), max(v[a], v[b], v[c])
        begin, end = max(math.ceil(top), bounds[0]), min(math.ceil(bottom), bounds[1])
        if begin >= end:
            continue
        xa, ya, xb, yb, _, long_slope, upper_slope, lower_slope = upright(u[a], v[a], u[b], v[b], u[c], v[c])
        for y in range(begin, end):
            on_long = xa + (y - ya) * long_slope
            on_short = xa + (y - ya) * upper_slope if y < yb else xb + (y - yb) * lower_slope
            left = max(math.ceil(min(on_long, on_short)), bounds[2])
            right = min(math.ceil(max(on_long, on_short)), bounds[3])
            if left < right:
                row = y - bounds[0]
                first_column[row] = min(first_column[row], left)
                last_column[row] = max(last_column[row], right)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_depths(
    points_mm, u, v, faces, detector_from_ray, bounds, first_row, first_column, offset, sums, with_motion, least_cosine
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
    sums : (n, 7) the sum of the signed depths, mm: minus where a ray enters, plus where it leaves; then the sum of
        ``z / |c| n`` (3) and of ``z^2 / |c| n`` (3), the ray times which is the moment of the former. (n, 1) without.
    least_cosine : between ray and normal; below it a face is grazed, and its slopes are held down.
    """
    Q = detector_from_ray
    for face in range(faces.shape[0]):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        top, bottom = min(v[a], v[b], v[c]), max(v[a], v[b], v[c])
        begin, end = max(math.ceil(top), bounds[0]), min(math.ceil(bottom), bounds[1])
        if begin >= end:
            continue
        ax, ay, az = points_mm[a, 0], points_mm[a, 1], points_mm[a, 2]
        ux, uy, uz = points_mm[b, 0] - ax, points_mm[b, 1] - ay, points_mm[b, 2] - az
        wx, wy, wz = points_mm[c, 0] - ax, points_mm[c, 1] - ay, points_mm[c, 2] - az
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        distance = nx * ax + ny * ay + nz * az
        if distance == 0.0:
            continue
        xa, ya, xb, yb, _, long_slope, upper_slope, lower_slope = upright(u[a], v[a], u[b], v[b], u[c], v[c])
        near = min(az, points_mm[b, 2], points_mm[c, 2])
        far = max(az, points_mm[b, 2], points_mm[c, 2])
        sign = 1.0 if distance > 0.0 else -1.0
        per_distance = 1.0 / abs(distance)
        steepest = 1.0 / (least_cosine * math.sqrt(nx * nx + ny * ny + nz * nz))
        # The inverse depth is linear over the detector.
        per_column = nx * Q[0, 0] / distance
        per_row = (nx * Q[0, 1] + ny * Q[1, 1]) / distance
        at_origin = (nx * Q[0, 2] + ny * Q[1, 2] + nz) / distance
        for y in range(begin, end):
            on_long = xa + (y - ya) * long_slope
            on_short = xa + (y - ya) * upper_slope if y < yb else xb + (y - yb) * lower_slope
            left = max(math.ceil(min(on_long, on_short)), bounds[2])
            right = min(math.ceil(max(on_long, on_short)), bounds[3])
            inverse = at_origin + per_row * y + per_column * left
            shift = offset[y - first_row] - first_column[y - first_row]
            for place in range(left + shift, right + shift):
                # A pixel is inside the face, so its depth is between the corners': holds for slivers too.
                depth = min(max(1.0 / inverse, near), far) if inverse > 0.0 else far
                inverse += per_column
                sums[place, 0] += sign * depth
                if with_motion:
                    slope = min(depth * per_distance, steepest)
                    sums[place, 1] += slope * nx
                    sums[place, 2] += slope * ny
                    sums[place, 3] += slope * nz
                    slope *= depth
                    sums[place, 4] += slope * nx
                    sums[place, 5] += slope * ny
                    sums[place, 6] += slope * nz


@njit(cache=True, nogil=True, error_model="numpy")
def _finish(
    sums, detector_from_ray, first_row, first_column, last_column, offset, pivot_mm, camera_from_world, with_motion,
    lengths_mm, by_motion,
):  # fmt: skip
    """Turn sums of depths into lengths along the rays, and their slopes into derivatives by a motion.

    Parameters
    ----------
    sums : as `_add_depths` left them.
    pivot_mm : (3,), in the camera's frame; rotations are about it.
    camera_from_world : (4, 4); rotations and shifts are meant along the world's axes.
    """
    Q, R, p = detector_from_ray, camera_from_world, pivot_mm
    for row in range(first_column.shape[0]):
        y = row + first_row
        for x in range(first_column[row], last_column[row]):
            place = offset[row] + x - first_column[row]
            if sums[place, 0] == 0.0:
                continue
            rx = Q[0, 0] * x + Q[0, 1] * y + Q[0, 2]
            ry = Q[1, 1] * y + Q[1, 2]
            length_per_depth = math.sqrt(rx * rx + ry * ry + 1.0)
            lengths_mm[place] = sums[place, 0] * length_per_depth
            if with_motion:
                sx, sy, sz = sums[place, 1], sums[place, 2], sums[place, 3]
                mx, my, mz = sums[place, 4], sums[place, 5], sums[place, 6]
                # The ray, of depth 1, times the moment, less the pivot times the slope.
                tx = ry * mz - my - (p[1] * sz - p[2] * sy)
                ty = mx - rx * mz - (p[2] * sx - p[0] * sz)
                tz = rx * my - ry * mx - (p[0] * sy - p[1] * sx)
                for k in range(3):
                    by_motion[k, place] = (R[0, k] * tx + R[1, k] * ty + R[2, k] * tz) * length_per_depth
                    by_motion[3 + k, place] = (R[0, k] * sx + R[1, k] * sy + R[2, k] * sz) * length_per_depth


@njit(cache=True, nogil=True, error_model="numpy")
def draw(
    intrinsics, camera_from_world, world_from_cad, pivots_mm, vertices_mm, vertex_start, faces, face_start, bounds,
    with_motion, least_cosine,
):  # fmt: skip
    """Draw bodies by their path lengths.

    Parameters
    ----------
    intrinsics : K (3, 3), upper triangular, px; of the image, whose integer pixels are centres.
    camera_from_world : (4, 4), right-handed; motions are meant along the world's axes.
    world_from_cad : (B, 4, 4); pivots_mm (B, 3), in the CAD frames, about which rotations are meant.
    vertices_mm, faces : of all bodies, one after the other; body b has those from start[b] to start[b + 1].
    bounds : (4,), first row, its end, first column and its end: what of the image is drawn.

    Returns
    -------
    `Drawn`. Nothing is drawn where a vertex is not in front of the source.
    """
    count = world_from_cad.shape[0]
    camera_from_cad = np.empty((count, 4, 4))
    for body in range(count):
        _multiply(camera_from_world, world_from_cad[body], camera_from_cad[body])
    points = np.empty((len(vertices_mm), 3))
    u, v = np.empty(len(vertices_mm)), np.empty(len(vertices_mm))
    first_row, row_start = np.zeros(count, np.int64), np.zeros(count + 1, np.int64)
    nearest = np.inf
    for body in range(count):
        part = slice(vertex_start[body], vertex_start[body + 1])
        nearest = min(
            nearest, to_camera(camera_from_cad[body], intrinsics, vertices_mm[part], points[part], u[part], v[part])
        )
        top, bottom = np.inf, -np.inf
        if nearest > 0.0:
            for i in range(vertex_start[body], vertex_start[body + 1]):
                top, bottom = min(top, v[i]), max(bottom, v[i])
        if not top <= bottom:
            top, bottom = bounds[0], bounds[0]
        # Clipped before they become integers: a body far outside must not overflow them.
        begin = np.int64(min(max(np.ceil(top), bounds[0]), bounds[1]))
        end = np.int64(min(max(np.ceil(bottom), begin), bounds[1]))
        first_row[body] = begin
        row_start[body + 1] = row_start[body] + end - begin
    rows = row_start[count]
    first_column, last_column = np.full(rows, bounds[3]), np.full(rows, bounds[2])
    for body in range(count):
        part, own = slice(vertex_start[body], vertex_start[body + 1]), slice(row_start[body], row_start[body + 1])
        within = bounds.copy()
        within[0], within[1] = first_row[body], first_row[body] + row_start[body + 1] - row_start[body]
        of_body = faces[face_start[body] : face_start[body + 1]]
        _find_spans(u[part], v[part], of_body, within, first_column[own], last_column[own])
    offset = np.zeros(rows + 1, np.int64)
    for row in range(rows):
        if last_column[row] <= first_column[row]:
            last_column[row] = first_column[row] = bounds[2]
        offset[row + 1] = offset[row] + last_column[row] - first_column[row]
    total = offset[rows]
    lengths, by_motion = np.zeros(total), np.zeros((6, total if with_motion else 0), np.float32)
    sums = np.zeros((total, 7 if with_motion else 1))
    detector_from_ray = _inverse_intrinsics(intrinsics)
    pivot = np.empty((1, 3))
    nowhere = np.empty(1)
    for body in range(count):
        part, own = slice(vertex_start[body], vertex_start[body + 1]), slice(row_start[body], row_start[body + 1])
        within = bounds.copy()
        within[0], within[1] = first_row[body], first_row[body] + row_start[body + 1] - row_start[body]
        of_body = faces[face_start[body] : face_start[body + 1]]
        _add_depths(
            points[part], u[part], v[part], of_body, detector_from_ray, within, first_row[body], first_column[own],
            offset[own], sums, with_motion, least_cosine,
        )  # fmt: skip
        to_camera(camera_from_cad[body], intrinsics, pivots_mm[body : body + 1], pivot, nowhere, nowhere)
        _finish(
            sums, detector_from_ray, first_row[body], first_column[own], last_column[own], offset[own],
            pivot[0], camera_from_world, with_motion, lengths, by_motion,
        )  # fmt: skip
    return Drawn(first_row, row_start, first_column, last_column, offset, lengths, by_motion, nearest)
