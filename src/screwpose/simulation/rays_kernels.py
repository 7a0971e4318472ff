"""Numba kernels of `screwpose.simulation.rays`. Importing this module imports numba: do it where it is needed.

Each call runs on one thread, sums in a fixed order and shares nothing: views may run side by side, and the same input
gives the same bits. The image is worked off in bands of rows:

- `_scan` goes through the faces and notes, for every ray of the band, each crossing as (depth, code): once to count
  them, once to write them one ray behind the other. A code is ``2 * rank + (1 where the ray leaves)``.
- `trace`, pixel by pixel: the crossings of the ray through the pixel's centre (bodies sampled once a pixel) are sorted;
  where sharp bodies touch the pixel, each of its sub-rays merges its own crossings into them.
- `_resolve` walks along a ray, keeps every body's winding number, and gives the length between two crossings to the
  highest body whose number is positive; `cumulative` integrals of a CT volume fill in where there is none.

Bodies are numbered by rank: a higher rank counts where bodies overlap.
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
# x, y, inverse depth (N,) of the vertices; faces (F, 3), their bodies' ranks (F,) and rows (F, 2).
Faces: TypeAlias = tuple[Floats, Floats, Floats, Ints, Ints, Ints]

# For each body (bodies,) its texture or -1; where that lies in the noise (T, 3, 4), its relative standard deviation
# (T,), and the noise: see `rays_texture`.
Textures: TypeAlias = tuple[Ints, Floats, Floats, Floats]

_GAP = -1  # the rank of no body
_MARCH, _SKIP = -1, -2


def _kernel(function: Kernel) -> Kernel:
    """`njit` with the options of all kernels here, its type kept. No fastmath: the fill rule needs exact equality."""
    return cast(Kernel, njit(nogil=True, cache=True)(function))


@_kernel
def row_ranges(y: Floats, faces: Ints, rows: int) -> Ints:
    """(F, 2): the first row of samples that each face may cover, and the one after the last, within the image."""
    ranges = np.empty((len(faces), 2), dtype=np.int32)
    for f in range(len(faces)):
        a, b, c = y[faces[f, 0]], y[faces[f, 1]], y[faces[f, 2]]
        ranges[f, 0] = int(min(max(np.ceil(min(a, b, c)), 0.0), float(rows)))
        ranges[f, 1] = int(min(max(np.ceil(max(a, b, c)), 0.0), float(rows)))
    return ranges


@_kernel
def _scan(
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


@_kernel
def _sort(depth: Floats, code: Ints, begin: int, end: int) -> None:
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


@_kernel
def _resolve(
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
    before = _GAP
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
        now = active[count - 1] if count else _GAP
        if now != before:
            piece_depth[pieces], piece_rank[pieces] = d, now
            pieces += 1
            before = now
    if entered != 0 or count != 0:
        winding[:] = 0
        return -1
    return max(pieces - 1, 0)


@_kernel
def _noise_along(noise: Floats, grain: Floats, px: float, py: float, begin: float, end: float) -> float:
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


@_kernel
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


@_kernel
def _march(volume: Floats, world_step: Floats, px: float, py: float, cumulative: Floats, reach: Floats) -> int:
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


@_kernel
def _up_to(cumulative: Floats, channel: int, steps: int, reach: Floats, depth: float) -> float:
    """The volume's integral from its border to a depth."""
    if depth <= reach[0]:
        return 0.0
    if depth >= reach[1]:
        return cumulative[steps, channel]
    at = (depth - reach[0]) / (reach[1] - reach[0]) * steps
    s = min(int(at), steps - 1)
    return cumulative[s, channel] + (at - s) * (cumulative[s + 1, channel] - cumulative[s, channel])


@_kernel
def _add_lengths(
    pieces: int,
    piece_depth: Floats,
    piece_rank: Ints,
    material_of: Ints,
    density: Floats,
    mm_per_depth: float,
    steps: int,
    cumulative: Floats,
    reach: Floats,
    volume_materials: Ints,
    lengths: Floats,
) -> None:
    """Set `lengths` (materials,) to what a ray passes of each, mm: pieces by their bodies, gaps by the volume."""
    lengths[:] = 0.0
    for p in range(pieces):
        rank = piece_rank[p]
        if rank != _GAP:
            length = (piece_depth[p + 1] - piece_depth[p]) * density[rank]
            lengths[material_of[rank]] += length * mm_per_depth
    if steps == 0:
        return
    for channel in range(2):
        total = cumulative[steps, channel]
        for p in range(pieces):
            if piece_rank[p] != _GAP:
                total -= _up_to(cumulative, channel, steps, reach, piece_depth[p + 1])
                total += _up_to(cumulative, channel, steps, reach, piece_depth[p])
        lengths[volume_materials[channel]] += max(total, 0.0) * mm_per_depth


@_kernel
def _set_densities(
    pieces: int,
    piece_depth: Floats,
    piece_rank: Ints,
    textures: Textures,
    how: Ints,
    maps: Floats,
    map_step: int,
    px: float,
    py: float,
    density: Floats,
    sums: Floats,
) -> None:
    """The mean relative density of each textured body along a ray, into `density` (bodies,); the others keep 1.

    Parameters
    ----------
    how : (T,), for each texture its map, or to `_MARCH` along the ray, or to `_SKIP` it.
    maps : densities on the rays of every `map_step`-th pixel, between which they are bilinear.
    sums : (T, 2), working space.
    """
    grain_of, grains, contrast, noise = textures
    for p in range(pieces):
        if piece_rank[p] != _GAP and grain_of[piece_rank[p]] >= 0:
            sums[grain_of[piece_rank[p]], :] = 0.0
    for p in range(pieces):
        if piece_rank[p] != _GAP:
            t = grain_of[piece_rank[p]]
            if t >= 0 and how[t] == _MARCH:
                sums[t, 0] += _noise_along(noise, grains[t], px, py, piece_depth[p], piece_depth[p + 1])
                sums[t, 1] += piece_depth[p + 1] - piece_depth[p]
    for p in range(pieces):
        rank = piece_rank[p]
        t = grain_of[rank] if rank != _GAP else _GAP
        if t < 0 or how[t] == _SKIP:
            continue
        if how[t] == _MARCH:
            mean = sums[t, 0] / sums[t, 1] if sums[t, 1] > 0.0 else 0.0
            density[rank] = max(1.0 + contrast[t] * mean, 0.0)
        else:
            x, y = px / map_step, py / map_step
            i, j = int(y), int(x)
            fy, fx = y - i, x - j
            upper = maps[how[t], i, j] * (1.0 - fx) + maps[how[t], i, j + 1] * fx
            lower = maps[how[t], i + 1, j] * (1.0 - fx) + maps[how[t], i + 1, j + 1] * fx
            density[rank] = upper * (1.0 - fy) + lower * fy


@_kernel
def map_densities(
    leaving_sign: float, map_step: int, faces: Faces, textures: Textures, how: Ints, maps: Floats
) -> None:
    """Fill the densities' maps (maps, rows, columns), whose nodes are every `map_step`-th pixel, for `trace`.

    Parameters
    ----------
    faces : those of `trace`'s coarse bodies, in nodes.
    how : as in `trace`. What it maps is marched along here, what it marches is skipped.
    """
    rows, columns = maps.shape[1:]
    grain_of = textures[0]
    bodies = len(grain_of)
    winding, active = np.zeros(bodies, dtype=np.int32), np.empty(bodies, dtype=np.int32)
    density, sums = np.ones(bodies), np.zeros((len(how), 2))
    here = np.where(how >= 0, _MARCH, _SKIP)
    place, depth, code = _crossings(faces, leaving_sign, 0, rows, columns)
    piece_depth, piece_rank = np.empty(_most(place) + 1), np.empty(_most(place) + 1, dtype=np.int32)
    for row in range(rows):
        for column in range(columns):
            begin, end = place[row * columns + column], place[row * columns + column + 1]
            _sort(depth, code, begin, end)
            pieces = _resolve(depth, code, begin, end, depth, code, 0, 0, winding, active, piece_depth, piece_rank)
            px, py = float(column * map_step), float(row * map_step)
            _set_densities(pieces, piece_depth, piece_rank, textures, here, maps, map_step, px, py, density, sums)
            for p in range(pieces):
                t = grain_of[piece_rank[p]] if piece_rank[p] != _GAP else _GAP
                if t >= 0 and how[t] >= 0:
                    maps[how[t], row, column] = density[piece_rank[p]]


@_kernel
def _mm_per_depth(metric: Floats, px: float, py: float) -> float:
    """How long the ray of a pixel is for each mm of depth; `metric` (3, 3) is ``M^-T M^-1``."""
    squared = (metric[0, 0] * px + 2.0 * metric[0, 2]) * px + (metric[1, 1] * py + 2.0 * metric[1, 2]) * py
    return float(np.sqrt(squared + 2.0 * metric[0, 1] * px * py + metric[2, 2]))


@_kernel
def _transmitted(lengths: Floats, attenuation: Floats, weights: Floats, integrals: Floats) -> float:
    """Beer and Lambert's law: ``sum_b weights_b exp(-sum_m attenuation_mb lengths_m)``; `integrals` (B,) is space."""
    integrals[:] = 0.0
    for m in range(len(lengths)):
        if lengths[m] > 0.0:
            for b in range(len(weights)):
                integrals[b] += lengths[m] * attenuation[m, b]
    total = 0.0
    for b in range(len(weights)):
        total += weights[b] * np.exp(-integrals[b])
    return total


@_kernel
def trace(
    rows: int,
    columns: int,
    supersample: int,
    band_rows: int,
    leaving_sign: float,
    metric: Floats,
    coarse: Faces,
    fine: Faces,
    material_of: Ints,
    attenuation: Floats,
    weights: Floats,
    textures: Textures,
    how: Ints,
    maps: Floats,
    map_step: int,
    volume: Floats,
    volume_step: Floats,
    volume_materials: Ints,
    transmitted: Floats,
    lengths_out: Floats,
) -> int:
    """Trace every ray of an image; see the head of this module.

    Parameters
    ----------
    coarse, fine : tuples (x, y, q, faces, ranks, ranges) of the bodies sampled once a pixel, in px, and of the sharp
        ones, in sub-samples.
    how, maps, map_step : see `_set_densities`.
    volume : (I, J, K, 2), or with no entries where there is none.
    transmitted : (rows, columns), receives the mean over each pixel's rays.
    lengths_out : (rows, columns, materials), receives the mean length of each material, mm; or with no entries.

    Returns
    -------
    The number of rays that leave a body less often than they enter it.
    """
    bodies, materials = len(material_of), attenuation.shape[0]
    s, wide = supersample, columns * supersample
    winding, active = np.zeros(bodies, dtype=np.int32), np.empty(bodies, dtype=np.int32)
    density, sums = np.ones(bodies), np.zeros((len(how), 2))
    lengths, mean_lengths = np.zeros(materials), np.zeros(materials)
    reach, integrals = np.zeros(2), np.zeros(len(weights))
    with_volume, with_lengths = volume.size > 0, lengths_out.size > 0
    longest = volume.shape[0] + volume.shape[1] + volume.shape[2] if with_volume else 0
    cumulative = np.zeros((longest + 2, 2))
    unbalanced = 0
    for row0 in range(0, rows, band_rows):
        row1 = min(row0 + band_rows, rows)
        place_a, depth_a, code_a = _crossings(coarse, leaving_sign, row0, row1, columns)
        place_b, depth_b, code_b = _crossings(fine, leaving_sign, row0 * s, row1 * s, wide)
        most_a, most_b = _most(place_a), _most(place_b)
        piece_depth = np.empty(most_a + most_b + 1)
        piece_rank = np.empty(most_a + most_b + 1, dtype=np.int32)
        for row in range(row0, row1):
            for column in range(columns):
                px, py = float(column), float(row)
                ray = (row - row0) * columns + column
                begin, end = place_a[ray], place_a[ray + 1]
                touched = False
                if len(depth_b):
                    for i in range(s):
                        first = ((row - row0) * s + i) * wide + column * s
                        touched = touched or place_b[first] != place_b[first + s]
                if begin == end and not touched and not with_volume:
                    transmitted[row, column] = 1.0
                    continue
                steps = 0
                if with_volume:
                    steps = _march(volume, volume_step, px, py, cumulative, reach)
                _sort(depth_a, code_a, begin, end)
                pieces = _resolve(
                    depth_a, code_a, begin, end, depth_b, code_b, 0, 0, winding, active, piece_depth, piece_rank
                )
                if pieces < 0:
                    unbalanced += 1
                    continue
                if len(how):
                    _set_densities(
                        pieces, piece_depth, piece_rank, textures, how, maps, map_step, px, py, density, sums
                    )
                if not touched:
                    _add_lengths(
                        pieces, piece_depth, piece_rank, material_of, density, _mm_per_depth(metric, px, py),
                        steps, cumulative, reach, volume_materials, lengths,
                    )  # fmt: skip
                    transmitted[row, column] = _transmitted(lengths, attenuation, weights, integrals)
                    if with_lengths:
                        lengths_out[row, column, :] = lengths
                    continue
                total = 0.0
                mean_lengths[:] = 0.0
                for i in range(s):
                    for j in range(s):
                        ray = ((row - row0) * s + i) * wide + column * s + j
                        _sort(depth_b, code_b, place_b[ray], place_b[ray + 1])
                        pieces = _resolve(
                            depth_a, code_a, begin, end, depth_b, code_b, place_b[ray], place_b[ray + 1],
                            winding, active, piece_depth, piece_rank,
                        )  # fmt: skip
                        if pieces < 0:
                            unbalanced += 1
                            continue
                        sub_x, sub_y = px + (j - 0.5 * (s - 1)) / s, py + (i - 0.5 * (s - 1)) / s
                        _add_lengths(
                            pieces, piece_depth, piece_rank, material_of, density, _mm_per_depth(metric, sub_x, sub_y),
                            steps, cumulative, reach, volume_materials, lengths,
                        )  # fmt: skip
                        total += _transmitted(lengths, attenuation, weights, integrals)
                        if with_lengths:
                            mean_lengths += lengths
                transmitted[row, column] = total / (s * s)
                if with_lengths:
                    lengths_out[row, column, :] = mean_lengths / (s * s)
    return unbalanced


@_kernel
def _crossings(faces: Faces, leaving_sign: float, row0: int, row1: int, columns: int) -> tuple[Ints, Floats, Ints]:
    """All crossings of the rays of a band of rows: those of ray i are from ``place[i]`` to ``place[i + 1]``."""
    x, y, q, corners, ranks, ranges = faces
    if len(corners) == 0:
        rays = (row1 - row0) * columns
        return np.zeros(rays + 1, dtype=np.int64), np.empty(0), np.empty(0, dtype=np.int32)
    place = np.zeros((row1 - row0) * columns + 2, dtype=np.int64)
    depth, code = np.empty(0), np.empty(0, dtype=np.int32)
    # Shifted by one: filling raises every start to the next ray's, which is then in its place.
    _scan(x, y, q, corners, ranks, ranges, leaving_sign, row0, row1, columns, place[1:], depth, code, False)
    for i in range(1, len(place)):
        place[i] += place[i - 1]
    depth, code = np.empty(place[-1]), np.empty(place[-1], dtype=np.int32)
    _scan(x, y, q, corners, ranks, ranges, leaving_sign, row0, row1, columns, place[1:], depth, code, True)
    return place[:-1], depth, code


@_kernel
def _most(place: Ints) -> int:
    most = 0
    for i in range(len(place) - 1):
        most = max(most, place[i + 1] - place[i])
    return most
