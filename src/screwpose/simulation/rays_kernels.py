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

from typing import TypeAlias

import numpy as np

from screwpose.simulation.rays_crossings import GAP, Faces, all_crossings, most, resolve, sort_crossings
from screwpose.simulation.rays_fields import Floats, Ints, kernel, march, noise_along, up_to

# For each body (bodies,) its texture or -1; where that lies in the noise (T, 3, 4), its relative standard deviation
# (T,), and the noise: see `rays_texture`.
Textures: TypeAlias = tuple[Ints, Floats, Floats, Floats]

_MARCH, _SKIP = -1, -2


@kernel
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
        if rank != GAP:
            length = (piece_depth[p + 1] - piece_depth[p]) * density[rank]
            lengths[material_of[rank]] += length * mm_per_depth
    if steps == 0:
        return
    for channel in range(2):
        total = cumulative[steps, channel]
        for p in range(pieces):
            if piece_rank[p] != GAP:
                total -= up_to(cumulative, channel, steps, reach, piece_depth[p + 1])
                total += up_to(cumulative, channel, steps, reach, piece_depth[p])
        lengths[volume_materials[channel]] += max(total, 0.0) * mm_per_depth


@kernel
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
        if piece_rank[p] != GAP and grain_of[piece_rank[p]] >= 0:
            sums[grain_of[piece_rank[p]], :] = 0.0
    for p in range(pieces):
        if piece_rank[p] != GAP:
            t = grain_of[piece_rank[p]]
            if t >= 0 and how[t] == _MARCH:
                sums[t, 0] += noise_along(noise, grains[t], px, py, piece_depth[p], piece_depth[p + 1])
                sums[t, 1] += piece_depth[p + 1] - piece_depth[p]
    for p in range(pieces):
        rank = piece_rank[p]
        t = grain_of[rank] if rank != GAP else GAP
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


@kernel
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
    place, depth, code = all_crossings(faces, leaving_sign, 0, rows, columns)
    piece_depth, piece_rank = np.empty(most(place) + 1), np.empty(most(place) + 1, dtype=np.int32)
    for row in range(rows):
        for column in range(columns):
            begin, end = place[row * columns + column], place[row * columns + column + 1]
            sort_crossings(depth, code, begin, end)
            pieces = resolve(depth, code, begin, end, depth, code, 0, 0, winding, active, piece_depth, piece_rank)
            px, py = float(column * map_step), float(row * map_step)
            _set_densities(pieces, piece_depth, piece_rank, textures, here, maps, map_step, px, py, density, sums)
            for p in range(pieces):
                t = grain_of[piece_rank[p]] if piece_rank[p] != GAP else GAP
                if t >= 0 and how[t] >= 0:
                    maps[how[t], row, column] = density[piece_rank[p]]


@kernel
def _mm_per_depth(metric: Floats, px: float, py: float) -> float:
    """How long the ray of a pixel is for each mm of depth; `metric` (3, 3) is ``M^-T M^-1``."""
    squared = (metric[0, 0] * px + 2.0 * metric[0, 2]) * px + (metric[1, 1] * py + 2.0 * metric[1, 2]) * py
    return float(np.sqrt(squared + 2.0 * metric[0, 1] * px * py + metric[2, 2]))


@kernel
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


@kernel
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
        place_a, depth_a, code_a = all_crossings(coarse, leaving_sign, row0, row1, columns)
        place_b, depth_b, code_b = all_crossings(fine, leaving_sign, row0 * s, row1 * s, wide)
        most_a, most_b = most(place_a), most(place_b)
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
                    steps = march(volume, volume_step, px, py, cumulative, reach)
                sort_crossings(depth_a, code_a, begin, end)
                pieces = resolve(
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
                        sort_crossings(depth_b, code_b, place_b[ray], place_b[ray + 1])
                        pieces = resolve(
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
