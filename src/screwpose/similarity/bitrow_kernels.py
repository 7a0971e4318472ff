"""Compiled loops that score masks of bits: what `target.Target` and `reference.dice` say of a mask, without the mask.

Arrays are in blocks of 64 columns: a mask is (words, rows) words, bit k of word w is column ``64 w + k``. So the loops
go down the rows of a block, and along the memory.
"""

import numpy as np
from numba import njit

from screwpose.projection.contour_kernels import clear, draw_scene
from screwpose.projection.kernels import count_bits, lowest_bit


@njit(cache=True, nogil=True, error_model="numpy")
def measure(bits, ranges, region, beside, below, metal, sums):
    """What the loss and the Dice score need of a mask.

    Parameters
    ----------
    bits : (words, rows or more), the mask.
    ranges : (words, 2), the first row and the last (not included) of each block that may hold a bit.
    region, metal : (words, rows), the pixels that count, and the segmented implants among them.
    beside, below : (words, rows), where a pixel and its left neighbour, or the one below, both count.
    sums : (words + 1, rows, 64), the adjoint summed along each row: that of the columns before ``64 w + k``.

    Returns
    -------
    The sum of the adjoint under the mask, how many differences are not zero, the mask's area, and that of its metal.
    """
    words, rows = region.shape
    one, zero, last_bit = np.uint64(1), np.uint64(0), np.uint64(63)
    correlation, transitions, area, common = 0.0, zero, zero, zero
    nothing = np.zeros(rows, dtype=np.uint64)
    first_carry, last_carry = rows, 0  # the rows in which the block before reaches this one
    for word in range(words):
        first, last = min(ranges[word, 0], first_carry), min(max(ranges[word, 1], last_carry), rows)
        first_carry, last_carry = rows, 0
        own, counting, left, is_left = bits[word], region[word], nothing, nothing
        if word > 0:
            left, is_left = bits[word - 1], region[word - 1]
        own_metal, own_beside, own_below, own_sums = metal[word], beside[word], below[word], sums[word]
        above = zero
        for row in range(np.uint64(first), np.uint64(last)):  # unsigned: an index that cannot be negative is cheaper
            mask = own[row] & counting[row]
            carry = (left[row] & is_left[row]) >> last_bit
            if mask | above | carry == zero:
                continue
            if row > 0:
                transitions += count_bits((mask ^ above) & own_below[row - one])
            above = mask
            shifted = (mask << one) | carry
            transitions += count_bits((mask ^ shifted) & own_beside[row])
            area += count_bits(mask)
            common += count_bits(mask & own_metal[row])
            begins, ends = mask & ~shifted, shifted & ~mask
            while begins != zero:
                correlation -= own_sums[row, lowest_bit(begins)]
                begins &= begins - one
            while ends != zero:
                correlation += own_sums[row, lowest_bit(ends)]
                ends &= ends - one
            if mask >> last_bit != zero:
                first_carry, last_carry = min(first_carry, np.int64(row)), np.int64(row) + 1
        if first < last and last < rows:
            transitions += count_bits(above & own_below[last - 1])
    for row in range(first_carry, last_carry):  # up to the image's border, which is the end of a word here
        if (bits[words - 1, row] & region[words - 1, row]) >> last_bit != zero:
            correlation += sums[words, row, 0]
    return correlation, np.int64(transitions), np.int64(area), np.int64(common)


@njit(cache=True, nogil=True, error_model="numpy")
def measure_scenes(
    pixels_from_world, world_from_cad, bodies, room, columns, region, beside, below, metal, sums, correlation, counts
):
    """Draw and measure many scenes in one view.

    Parameters
    ----------
    pixels_from_world : (3, 4).
    world_from_cad : (K, B, 4, 4), K scenes of B bodies.
    bodies : `contour.Bodies`.
    room : of `room_for`, clear; left so, but where a scene is not in front of the source.
    columns : of the image.
    region, beside, below, metal, sums : see `measure`.
    correlation : (K,), filled: the sum of the adjoint under each mask.
    counts : (K, 3), filled: transitions, area, common.

    Returns
    -------
    The smallest depth of any vertex, mm, or, where all are in front of the source, of their boxes.
    """
    nearest = np.inf
    for scene in range(world_from_cad.shape[0]):
        nearest = min(nearest, draw_scene(pixels_from_world, world_from_cad[scene], bodies, columns, room))
        if not nearest > 0.0:
            break
        correlation[scene], counts[scene, 0], counts[scene, 1], counts[scene, 2] = measure(
            room.bits, room.ranges, region, beside, below, metal, sums
        )
        clear(room)
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
