"""Numba kernels that find what a ray crosses, and which body it is in between two crossings.

Importing this module imports numba. Who edits it clears `__pycache__`; see `rays_fields`.
"""

from typing import TypeAlias

import numpy as np

from screwpose.simulation.rays_fields import Floats, Ints, kernel

# x, y, inverse depth (N,) of the vertices; faces (F, 3), their bodies' ranks (F,) and rows (F, 2).
Faces: TypeAlias = tuple[Floats, Floats, Floats, Ints, Ints, Ints]

GAP = -1  # the rank of no body


@kernel
def row_ranges(y: Floats, faces: Ints, rows: int) -> Ints:
    """(F, 2): the first row of samples that each face may cover, and the one after the last, within the image."""
    ranges = np.empty((len(faces), 2), dtype=np.int32)
    for f in range(len(faces)):
        a, b, c = y[faces[f, 0]], y[faces[f, 1]], y[faces[f, 2]]
        ranges[f, 0] = int(min(max(np.ceil(min(a, b, c)), 0.0), float(rows)))
        ranges[f, 1] = int(min(max(np.ceil(max(a, b, c)), 0.0), float(rows)))
    return ranges


@kernel
def scan(
    x: Floats,
    y: Floats,
    q: Floats,
    faces: Ints,
    ranks: Ints,
    ranges: Ints,
    leaving_sign: float,
    row0: int,
    row1: int,
    columns: int,
    place: Ints,
    depth: Floats,
    code: Ints,
    fill: bool,
) -> None:
    """Note the faces' crossings with the rays of rows row0 to row1; ray (r, c) lies at x = c, y = r.

    The fill rule is that of `screwpose.simulation.pathlength`: watertight, without tolerance.

    Parameters
    ----------
    x, y, q : (N,), the vertices in the image, and their inverse depth.
    place : (rays of the band + 1,); counting raises ``place[ray + 1]``; filling takes ``place[ray]`` and raises it.
    """
    for f in range(len(faces)):
        top, bottom = max(ranges[f, 0], row0), min(ranges[f, 1], row1)
        if top >= bottom:
            continue
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        turn = leaving_sign
        if y[b] < y[a]:
            a, b, turn = b, a, -turn
        if y[c] < y[b]:
            b, c, turn = c, b, -turn
            if y[b] < y[a]:
                a, b, turn = b, a, -turn
        long_slope = (x[c] - x[a]) / (y[c] - y[a])
        long_q_slope = (q[c] - q[a]) / (y[c] - y[a])
        middle = int(min(max(np.ceil(y[b]), float(top)), float(bottom)))
        for half in range(2):
            first, last = (top, middle) if half == 0 else (middle, bottom)
            if first >= last:
                continue
            upper, lower = (a, b) if half == 0 else (b, c)
            slope = (x[lower] - x[upper]) / (y[lower] - y[upper])
            q_slope = (q[lower] - q[upper]) / (y[lower] - y[upper])
            for row in range(first, last):
                x_long = x[a] + (row - y[a]) * long_slope
                x_short = x[upper] + (row - y[upper]) * slope
                ceil_long = min(max(np.ceil(x_long), 0.0), float(columns))
                ceil_short = min(max(np.ceil(x_short), 0.0), float(columns))
                if ceil_long == ceil_short:
                    continue
                begin, end = int(min(ceil_long, ceil_short)), int(max(ceil_long, ceil_short))
                ray = (row - row0) * columns + begin
                if not fill:
                    for _ in range(begin, end):
                        place[ray + 1] += 1
                        ray += 1
                    continue
                q_long = q[a] + (row - y[a]) * long_q_slope
                q_short = q[upper] + (row - y[upper]) * q_slope
                per_column = 1.0 / (x_short - x_long)
                leaves = 1 if turn * per_column > 0.0 else 0
                for column in range(begin, end):
                    # The sample is inside the face, so its depth is between the edges', whatever the rounding.
                    share = min(max((column - x_long) * per_column, 0.0), 1.0)
                    at = place[ray]
                    depth[at] = 1.0 / (q_long + share * (q_short - q_long))
                    code[at] = 2 * ranks[f] + leaves
                    place[ray] = at + 1
                    ray += 1


@kernel
def sort_crossings(depth: Floats, code: Ints, begin: int, end: int) -> None:
    """Sort a ray's crossings by depth; Shell's gaps keep hundreds of crossings (threads seen end-on) cheap."""
    count = end - begin
    for gap in (301, 132, 57, 23, 10, 4, 1):
        if gap >= count:
            continue
        for i in range(begin + gap, end):
            d, k = depth[i], code[i]
            j = i
            while j >= begin + gap and depth[j - gap] > d:
                depth[j], code[j] = depth[j - gap], code[j - gap]
                j -= gap
            depth[j], code[j] = d, k


@kernel
def resolve(
    depth_a: Floats,
    code_a: Ints,
    begin_a: int,
    end_a: int,
    depth_b: Floats,
    code_b: Ints,
    begin_b: int,
    end_b: int,
    winding: Ints,
    active: Ints,
    piece_depth: Floats,
    piece_rank: Ints,
) -> int:
    """Merge two sorted lists of crossings into the pieces of a ray that belong to one body each.

    Parameters
    ----------
    winding : (bodies,), all zero; is all zero afterwards, unless a body is open.
    active : (bodies,), working space: the ranks with a positive winding number, ascending.
    piece_depth, piece_rank : piece i reaches from ``piece_depth[i]`` to ``piece_depth[i + 1]`` and belongs to
        ``piece_rank[i]``, or to no body where that is -1.

    Returns
    -------
    The number of pieces, or -1 where a body was left less often than entered.
    """
    pieces, count, entered = 0, 0, 0
    i, j = begin_a, begin_b
    before = GAP
    while i < end_a or j < end_b:
        if j >= end_b or (i < end_a and depth_a[i] <= depth_b[j]):
            d, k = depth_a[i], code_a[i]
            i += 1
        else:
            d, k = depth_b[j], code_b[j]
            j += 1
        rank = k >> 1
        if k & 1:
            winding[rank] -= 1
            entered -= 1
            if winding[rank] != 0:
                continue
            at = count - 1
            while active[at] != rank:
                at -= 1
            for other in range(at, count - 1):
                active[other] = active[other + 1]
            count -= 1
        else:
            winding[rank] += 1
            entered += 1
            if winding[rank] != 1:
                continue
            at = count
            while at > 0 and active[at - 1] > rank:
                active[at] = active[at - 1]
                at -= 1
            active[at] = rank
            count += 1
        now = active[count - 1] if count else GAP
        if now != before:
            piece_depth[pieces], piece_rank[pieces] = d, now
            pieces += 1
            before = now
    if entered != 0 or count != 0:
        winding[:] = 0
        return -1
    return max(pieces - 1, 0)


@kernel
def all_crossings(faces: Faces, leaving_sign: float, row0: int, row1: int, columns: int) -> tuple[Ints, Floats, Ints]:
    """All crossings of the rays of a band of rows: those of ray i are from ``place[i]`` to ``place[i + 1]``."""
    x, y, q, corners, ranks, ranges = faces
    if len(corners) == 0:
        rays = (row1 - row0) * columns
        return np.zeros(rays + 1, dtype=np.int64), np.empty(0), np.empty(0, dtype=np.int32)
    place = np.zeros((row1 - row0) * columns + 2, dtype=np.int64)
    depth, code = np.empty(0), np.empty(0, dtype=np.int32)
    # Shifted by one: filling raises every start to the next ray's, which is then in its place.
    scan(x, y, q, corners, ranks, ranges, leaving_sign, row0, row1, columns, place[1:], depth, code, False)
    for i in range(1, len(place)):
        place[i] += place[i - 1]
    depth, code = np.empty(place[-1]), np.empty(place[-1], dtype=np.int32)
    scan(x, y, q, corners, ranks, ranges, leaving_sign, row0, row1, columns, place[1:], depth, code, True)
    return place[:-1], depth, code


@kernel
def most(place: Ints) -> int:
    most = 0
    for i in range(len(place) - 1):
        most = max(most, place[i + 1] - place[i])
    return most
