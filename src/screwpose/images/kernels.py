"""Compiled loops over the connected pieces of an image cut at many levels. Only `pieces` loads this module.

Pieces of a higher cut lie in those of a lower one, so all cuts together are a tree, and one pass of union-find over the
pixels in the order of their levels visits all of them: no cut is labelled by itself.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _root(parent, pixel):
    """The representative of a pixel's set; the path to it is halved on the way."""
    while parent[pixel] != pixel:
        parent[pixel] = parent[parent[pixel]]
        pixel = parent[pixel]
    return pixel


@njit(cache=True, nogil=True)
def _ordered(steps, count):
    """The pixels (N,) in the order of their steps 0 to count, and where each step begins, (count + 2,)."""
    begin = np.zeros(count + 2, dtype=np.int64)
    for step in steps:
        begin[step + 1] += 1
    for step in range(count + 1):
        begin[step + 1] += begin[step]
    order, at = np.empty(len(steps), dtype=np.int32), begin.copy()
    for pixel in range(len(steps)):
        order[at[steps[pixel]]] = pixel
        at[steps[pixel]] += 1
    return order, begin


@njit(cache=True, nogil=True)
def fill_holes(steps, columns, count, largest):
    """Let the holes of every cut be filled: gaps of no more than `largest` pixels that do not touch the image's border.

    Parameters
    ----------
    steps : (N,) uint8, of the pixels row by row: cut k, 0 to count - 1, holds those with steps <= k.

    Returns
    -------
    (N,) uint8: the steps with the holes filled. Neighbours share a side.
    """
    total = len(steps)
    order, _ = _ordered(steps, count)
    # A tree of gaps: `above` leads from a pixel to one of a wider gap, or of the same gap.
    parent, above = np.full(total, -1, dtype=np.int32), np.empty(total, dtype=np.int32)
    area, at_border = np.zeros(total, dtype=np.int64), np.zeros(total, dtype=np.bool_)
    for index in range(total - 1, -1, -1):
        pixel = order[index]
        row, column = pixel // columns, pixel % columns
        parent[pixel] = above[pixel] = pixel
        area[pixel] = 1
        at_border[pixel] = row == 0 or column == 0 or column == columns - 1 or pixel + columns >= total
        for side in range(4):
            if (side == 0 and column == 0) or (side == 1 and column == columns - 1):
                continue
            other = pixel + (-1, 1, -columns, columns)[side]
            if other < 0 or other >= total or parent[other] < 0:
                continue
            root = _root(parent, other)
            if root != pixel:
                parent[root] = above[root] = pixel
                area[pixel] += area[root]
                at_border[pixel] |= at_border[root]
    filled = np.empty(total, dtype=np.uint8)
    for index in range(total):  # from the widest gap inwards; `above` of a pixel comes before it
        pixel = order[index]
        outer = above[pixel]
        if outer == pixel:
            filled[pixel] = steps[pixel]
        elif steps[outer] == steps[pixel]:
            # The same gap, whose area stands with the pixel that the whole gap hangs from.
            filled[pixel] = filled[outer]
            area[pixel], at_border[pixel] = area[outer], at_border[outer]
        elif filled[outer] < steps[outer]:
            filled[pixel] = filled[outer]
        else:
            is_hole = area[pixel] <= largest and not at_border[pixel]
            filled[pixel] = steps[outer] if is_hole else steps[pixel]
    return filled


@njit(cache=True, nogil=True)
def pieces_of_cuts(steps, leaves, columns, count, weights):
    """Every piece of every cut, with sums along its outline.

    Parameters
    ----------
    steps : (N,) uint8, as `fill_holes` gives them.
    leaves : (N,) uint8, the largest of the steps about a pixel: it is on its piece's outline in the cuts before that.
    weights : (W, N), summed along the outlines.

    Returns
    -------
    For each of R pieces, cut after cut: the cut, a pixel of it, its area, the length of its outline, (R,) each; the
    sums (R, W); and the place of the piece of the next cut that it lies in, (R,), -1 after the last.
    """
    total, kinds = len(steps), len(weights)
    order, begin = _ordered(steps, count)
    leaving, ends = _ordered(leaves, count)
    parent = np.full(total, -1, dtype=np.int32)
    area, length = np.zeros(total, dtype=np.int64), np.zeros(total, dtype=np.int64)
    sums = np.zeros((total, kinds))
    place = np.full(total, -1, dtype=np.int64)
    roots = np.empty(total, dtype=np.int32)
    alive = 0
    capacity, found = 1024, 0
    cuts, anchors = np.empty(capacity, dtype=np.int64), np.empty(capacity, dtype=np.int64)
    areas, lengths = np.empty(capacity, dtype=np.int64), np.empty(capacity, dtype=np.int64)
    all_sums, within = np.empty((capacity, kinds)), np.empty(capacity, dtype=np.int64)
    first_of_last = 0
    for cut in range(count):
        for index in range(begin[cut], begin[cut + 1]):
            pixel = order[index]
            column = pixel % columns
            parent[pixel] = pixel
            area[pixel] = 1
            if leaves[pixel] > cut:
                length[pixel] = 1
                for kind in range(kinds):
                    sums[pixel, kind] = weights[kind, pixel]
            roots[alive] = pixel
            alive += 1
            root = pixel
            for side in range(4):
                if (side == 0 and column == 0) or (side == 1 and column == columns - 1):
                    continue
                other = pixel + (-1, 1, -columns, columns)[side]
                if other < 0 or other >= total or parent[other] < 0:
                    continue
                other = _root(parent, other)
                if other == root:
                    continue
                if area[other] > area[root]:
                    root, other = other, root
                parent[other] = root
                area[root] += area[other]
                length[root] += length[other]
                for kind in range(kinds):
                    sums[root, kind] += sums[other, kind]
        for index in range(ends[cut], ends[cut + 1]):  # on no outline any more
            pixel = leaving[index]
            if steps[pixel] < cut:
                root = _root(parent, pixel)
                length[root] -= 1
                for kind in range(kinds):
                    sums[root, kind] -= weights[kind, pixel]
        kept = 0
        for index in range(alive):
            if parent[roots[index]] == roots[index]:
                roots[kept] = roots[index]
                kept += 1
        alive = kept
        if found + alive > capacity:
            capacity = max(2 * capacity, found + alive)
            cuts, anchors = _longer(cuts, capacity), _longer(anchors, capacity)
            areas, lengths, within = _longer(areas, capacity), _longer(lengths, capacity), _longer(within, capacity)
            more = np.empty((capacity, kinds))
            more[:found] = all_sums[:found]
            all_sums = more
        for index in range(alive):
            root = roots[index]
            cuts[found], anchors[found], areas[found], lengths[found] = cut, root, area[root], length[root]
            for kind in range(kinds):
                # What was added and taken away again need not leave zero.
                all_sums[found, kind] = sums[root, kind] if length[root] > 0 else 0.0
            within[found] = -1
            place[root] = found
            found += 1
        for last in range(first_of_last, found - alive):
            within[last] = place[_root(parent, anchors[last])]
        first_of_last = found - alive
    return cuts[:found], anchors[:found], areas[:found], lengths[:found], all_sums[:found], within[:found]


@njit(cache=True, nogil=True)
def _longer(values, size):
    longer = np.empty(size, dtype=values.dtype)
    longer[: len(values)] = values
    return longer


@njit(cache=True, nogil=True)
def choose_pieces(gains, lengths, within, least_gain, least_mean):
    """Of nested pieces those that are worth more than what lies in them; see `pieces.best_pieces`.

    Parameters
    ----------
    gains, lengths, within : (R,) each, of the pieces as `pieces_of_cuts` lists them.

    Returns
    -------
    (R,) bool.
    """
    count = len(gains)
    wins, is_covered = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    inner, inner_length = np.zeros(count), np.zeros(count)
    for piece in range(count):
        own, length = gains[piece], np.float64(lengths[piece])
        wins[piece] = (
            own > 0.0
            and own >= least_gain * inner[piece]
            and own * inner_length[piece] >= least_mean * inner[piece] * length
        )
        best, best_length = inner[piece], inner_length[piece]
        if wins[piece] and own > best:
            best, best_length = own, length
        if within[piece] >= 0:
            inner[within[piece]] += best
            inner_length[within[piece]] += best_length
    for piece in range(count - 1, -1, -1):
        outer = within[piece]
        is_covered[piece] = outer >= 0 and (wins[outer] or is_covered[outer])
    return wins & ~is_covered


@njit(cache=True, nogil=True)
def pixels_of_piece(steps, columns, cut, anchor, area):
    """The pixels (area,) of the piece of a cut that holds the pixel `anchor`."""
    total = len(steps)
    pixels, seen = np.empty(area, dtype=np.int64), np.zeros(total, dtype=np.bool_)
    pixels[0], seen[anchor] = anchor, True
    found, looked = 1, 0
    while looked < found:
        pixel = pixels[looked]
        looked += 1
        column = pixel % columns
        for side in range(4):
            if (side == 0 and column == 0) or (side == 1 and column == columns - 1):
                continue
            other = pixel + (-1, 1, -columns, columns)[side]
            if 0 <= other < total and not seen[other] and steps[other] <= cut:
                seen[other] = True
                pixels[found] = other
                found += 1
    return pixels
