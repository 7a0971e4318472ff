"""Compiled loops that score masks of bits: what `target.Target` and `reference.dice` say of a mask, without the mask.

Arrays are in blocks of 64 columns: a mask is (words, rows) words, bit k of word w is column ``64 w + k``. So the loops
go down the rows of a block, and along the memory.
"""

import numpy as np
from numba import njit

from screwpose.projection.contour_kernels import clear, draw_scene
from screwpose.projection.kernels import count_bits, lowest_bit


@njit(cache=True, nogil=True, error_model="numpy")
def score_mask(bits, ranges, beside, below, metal, sums, gradient_norm, metal_area):
    """Loss and Dice score of a mask.

    Parameters
    ----------
    bits : (words, rows + 1), the mask, of pixels that count; the last row is 0.
    ranges : (words, 2), the first row and the last (not included) of each block that may hold a bit.
    beside, below : (words, rows), where a pixel and its left neighbour, or the one below, both count.
    metal : (words, rows), the segmented implants among the pixels that count.
    sums : (words, 65, rows), the adjoint summed along each row: of the columns ``64 w`` to ``64 w + k``, not included.
    gradient_norm, metal_area : ``sqrt(sum |D I|^2)``, and how many pixels are metal.
    """
    words, rows = beside.shape
    nothing = np.zeros(rows + 1, dtype=np.uint64)
    correlation = 0.0
    transitions, area, common = np.uint64(0), np.uint64(0), np.uint64(0)
    for word in range(words):
        first, last = ranges[word, 0], min(ranges[word, 1], rows)
        if first >= last:
            continue
        own, left, right, beside_right = bits[word], nothing, nothing, nothing
        if word > 0:
            left = bits[word - 1]
        if word + 1 < words:
            right, beside_right = bits[word + 1], beside[word + 1]
        if first > 0:
            transitions += count_bits(own[first] & below[word, first - 1])
        counts = _count(
            own[first:last], own[first + 1 : last + 1], left[first:last], right[first:last],
            beside[word][first:last], beside_right[first:last], below[word][first:last], metal[word][first:last],
        )  # fmt: skip
        transitions, area, common = transitions + counts[0], area + counts[1], common + counts[2]
        correlation += _correlation(own[first:last], sums[word], first)
    norm = np.sqrt(np.float64(transitions)) * gradient_norm
    covered = np.float64(area) + metal_area
    return -correlation / norm if norm > 0.0 else 0.0, 2.0 * common / covered if covered > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _count(own, next_row, left, right, beside, beside_right, below, metal):
    """How many differences of a block's mask are not zero, its area, and that of its metal; see `score_mask`.

    A difference between two blocks belongs to that of the two which has the bit. No branches: eight rows at once.
    """
    one, last_bit = np.uint64(1), np.uint64(63)
    transitions, area, common = np.uint64(0), np.uint64(0), np.uint64(0)
    for row in range(len(own)):
        mask = own[row]
        across = (mask ^ (mask << one)) & ~(left[row] >> last_bit) & beside[row]
        past_the_block = (mask >> last_bit) & ~right[row] & beside_right[row]
        transitions += count_bits(across) + past_the_block + count_bits((mask ^ next_row[row]) & below[row])
        area += count_bits(mask)
        common += count_bits(mask & metal[row])
    return transitions, area, common


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def _correlation(own, sums, first):
    """The adjoint under a block's mask, whose rows begin at `first`: over runs that all end with the block, at bit 64.

    No branch for the first run of a row (an empty one goes from 64 to 64), and sums in any order the compiler likes,
    always the same: several rows at once. Further runs are rare.
    """
    one = np.uint64(1)
    plane = np.uint64(sums.shape[1])
    flat = sums.reshape(-1)[first:]  # a plane a bit: the runs of neighbouring rows begin side by side in memory
    total = 0.0
    for row in range(np.uint64(len(own))):  # unsigned: an index that cannot be negative is cheaper
        mask = own[row]
        begin, end = lowest_bit(mask & ~(mask << one)), lowest_bit((mask << one) & ~mask)
        total += flat[end * plane + row] - flat[begin * plane + row]
    for row in range(np.uint64(len(own))):
        mask = own[row]
        begins, ends = mask & ~(mask << one), (mask << one) & ~mask
        begins &= begins - one
        while begins != 0:
            ends &= ends - one
            total += flat[lowest_bit(ends) * plane + row] - flat[lowest_bit(begins) * plane + row]
            begins &= begins - one
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def score_scenes(
    pixels_from_world,
    world_from_cad,
    bodies,
    room,
    columns,
    counting,
    beside,
    below,
    metal,
    sums,
    gradient_norm,
    metal_area,
    loss,
    dice,
):
    """Draw and score many scenes in one view.

    Parameters
    ----------
    pixels_from_world : (3, 4).
    world_from_cad : (K, B, 4, 4), K scenes of B bodies.
    bodies : `contour.Bodies`.
    room : of `room_for`, clear; left so, but where a scene is not in front of the source.
    columns : of the image.
    counting : (words, rows), the pixels that count.
    beside, below, metal, sums, gradient_norm, metal_area : see `score_mask`.
    loss, dice : (K,), filled.

    Returns
    -------
    The smallest depth of any vertex, mm, or, where all are in front of the source, of their boxes.
    """
    nearest = np.inf
    for scene in range(world_from_cad.shape[0]):
        nearest = min(nearest, draw_scene(pixels_from_world, world_from_cad[scene], bodies, columns, room))
        if not nearest > 0.0:
            break
        for word in range(counting.shape[0]):
            first, last = room.ranges[word, 0], min(room.ranges[word, 1], counting.shape[1])
            if first < last:
                _leave(room.bits[word][first:last], counting[word][first:last])
        loss[scene], dice[scene] = score_mask(
            room.bits, room.ranges, beside, below, metal, sums, gradient_norm, metal_area
        )
        clear(room)
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _leave(bits, counting):
    """Take away the bits of pixels that do not count."""
    for row in range(len(bits)):
        bits[row] &= counting[row]


@njit(cache=True, nogil=True)
def summed_along(adjoint):
    """The adjoint (rows, columns) as `score_mask` wants its sums; 64 x 64 pixels at a time, which a cache can hold."""
    rows, columns = adjoint.shape
    words = (columns + 63) >> 6
    sums = np.empty((words, 65, rows))
    for word in range(words):
        sums[word, 0] = 0.0
        for top in range(0, rows, 64):
            bottom = min(top + 64, rows)
            for bit in range(64):
                column = 64 * word + bit
                before, after = sums[word, bit, top:bottom], sums[word, bit + 1, top:bottom]
                for row in range(bottom - top):
                    after[row] = before[row] + (adjoint[top + row, column] if column < columns else 0.0)
    return sums


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
