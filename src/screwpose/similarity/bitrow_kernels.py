"""Compiled loops that score bit rows: what `target.Target` and `reference.dice` say of a mask, without the mask."""

import numpy as np
from numba import njit

from screwpose.projection.contour_kernels import draw_scene, room_for
from screwpose.projection.kernels import count_bits, lowest_bit


@njit(cache=True, nogil=True, error_model="numpy")
def measure_rows(bits, extents, top, bottom, region, beside, below, metal, sums):
    """What the loss and the Dice score need of a mask.

    Parameters
    ----------
    bits : (rows, words), the mask.
    extents : (rows, 2), first and last word (not included) of each row that may hold a bit; first >= last: none.
    top, bottom : the first and last row (not included) that may hold a bit.
    region, metal : (rows, words), the pixels that count, and the segmented implants among them.
    beside, below : (rows, words), where a pixel and its left neighbour, or the one below, both count.
    sums : (rows, columns + 1), the adjoint summed along each row: ``sums[r, c]`` is that of the columns before c.

    Returns
    -------
    The sum of the adjoint under the mask, how many differences are not zero, the mask's area, and that of its metal.
    """
    rows, words = bits.shape
    columns = sums.shape[1] - 1
    one, zero = np.uint64(1), np.uint64(0)
    correlation, transitions, area, common = 0.0, zero, zero, zero
    for row in range(max(top - 1, 0), bottom):
        first, last = extents[row, 0], extents[row, 1]
        has_next = row + 1 < rows
        if has_next:
            first, last = min(first, extents[row + 1, 0]), max(last, extents[row + 1, 1])
        last = min(last + 1, words)  # a run that ends with a word has its edge in the next
        carry, is_inside = zero, False
        for word in range(first, last):
            mask = bits[row, word]
            under = bits[row + 1, word] if has_next else zero
            if mask | under | carry == zero:
                continue
            mask &= region[row, word]
            if has_next:
                under &= region[row + 1, word]
            transitions += count_bits((mask ^ under) & below[row, word])
            edges = mask ^ ((mask << one) | carry)
            carry = mask >> np.uint64(63)
            transitions += count_bits(edges & beside[row, word])
            area += count_bits(mask)
            common += count_bits(mask & metal[row, word])
            while edges != zero:
                column = 64 * word + np.int64(lowest_bit(edges))
                edges &= edges - one
                correlation += sums[row, column] if is_inside else -sums[row, column]
                is_inside = not is_inside
        if is_inside:  # up to the image's border
            correlation += sums[row, columns]
    return correlation, np.int64(transitions), np.int64(area), np.int64(common)


@njit(cache=True, nogil=True, error_model="numpy")
def measure(bits, first_row, last_row, first_word, last_word, region, beside, below, metal, sums):
    """As `measure_rows`, of a mask that is empty outside the given rows and words (the last ones not included)."""
    extents = np.zeros((bits.shape[0], 2), dtype=np.int64)
    for row in range(first_row, last_row):
        extents[row, 0], extents[row, 1] = first_word, last_word
    return measure_rows(bits, extents, first_row, last_row, region, beside, below, metal, sums)


@njit(cache=True, nogil=True, error_model="numpy")
def measure_scenes(pixels_from_world, world_from_cad, bodies, region, beside, below, metal, sums, correlation, counts):
    """Draw and measure many scenes in one view.

    Parameters
    ----------
    pixels_from_world : (3, 4).
    world_from_cad : (K, B, 4, 4), K scenes of B bodies.
    bodies : `contour.Bodies`.
    region, beside, below, metal, sums : see `measure_rows`.
    correlation : (K,), filled: the sum of the adjoint under each mask.
    counts : (K, 3), filled: transitions, area, common.

    Returns
    -------
    The smallest depth of any vertex, mm, or, where all are in front of the source, of their boxes.
    """
    rows, words = region.shape
    bits = np.zeros((rows, words), dtype=np.uint64)
    extents = np.empty((rows, 2), dtype=np.int64)
    extents[:, 0], extents[:, 1] = words, 0
    room, crossings = room_for(bodies, rows, words), np.empty(8 * rows, dtype=np.int32)
    nearest = np.inf
    for scene in range(world_from_cad.shape[0]):
        crossings, top, bottom, depth = draw_scene(
            pixels_from_world, world_from_cad[scene], bodies, sums.shape[1] - 1, room, crossings, bits, extents
        )
        nearest = min(nearest, depth)
        if not nearest > 0.0:
            break
        correlation[scene], counts[scene, 0], counts[scene, 1], counts[scene, 2] = measure_rows(
            bits, extents, top, bottom, region, beside, below, metal, sums
        )
        for row in range(top, bottom):
            for word in range(extents[row, 0], extents[row, 1]):
                bits[row, word] = 0
            extents[row, 0], extents[row, 1] = words, 0
    return nearest


@njit(cache=True, nogil=True)
def adjoint_of(pixels, region):
    """``D^T D I`` of an X-ray I within its region (rows, columns), and ``|D I|^2`` summed along each row (rows,).

    D are the differences to the right and downwards, zero where either pixel lies outside the region; its transpose
    takes what leaves a pixel to the right into its right neighbour.
    """
    rows, columns = pixels.shape
    adjoint, energies = np.zeros((rows, columns)), np.zeros(rows)
    for row in range(rows):
        energy = 0.0
        for column in range(columns):
            if not region[row, column]:
                continue
            here = pixels[row, column]
            if column + 1 < columns and region[row, column + 1]:
                step = pixels[row, column + 1] - here
                adjoint[row, column] -= step
                adjoint[row, column + 1] += step
                energy += step * step
            if row + 1 < rows and region[row + 1, column]:
                step = pixels[row + 1, column] - here
                adjoint[row, column] -= step
                adjoint[row + 1, column] += step
                energy += step * step
        energies[row] = energy
    return adjoint, energies
