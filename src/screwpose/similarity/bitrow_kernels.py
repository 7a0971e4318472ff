"""Compiled loops that score bit rows: what `target.Target` and `reference.dice` say of a mask, without the mask."""

import numpy as np
from numba import njit

from screwpose.projection.kernels import count_bits, fill, lowest_bit, project


@njit(cache=True, nogil=True, error_model="numpy")
def measure(bits, first_row, last_row, first_word, last_word, region, beside, below, metal, sums):
    """What the loss and the Dice score need of a mask.

    Parameters
    ----------
    bits : (rows, words), the mask; empty outside the given rows and words (first to last, the last not included).
    region, metal : (rows, words), the pixels that count, and the segmented implants among them.
    beside, below : (rows, words), where a pixel and its left neighbour, or the one below, both count.
    sums : (rows, columns + 1), the adjoint summed along each row: ``sums[r, c]`` is that of the columns before c.

    Returns
    -------
    The sum of the adjoint under the mask, how many differences are not zero, the mask's area, and that of its metal.
    """
    rows, words = bits.shape
    columns = sums.shape[1] - 1
    one, top, zero = np.uint64(1), np.uint64(63), np.uint64(0)
    correlation, transitions, area, common = 0.0, zero, zero, zero
    for row in range(first_row, last_row):
        carry, is_inside = zero, False
        for word in range(first_word, last_word):
            mask = bits[row, word] & region[row, word]
            under = bits[row + 1, word] & region[row + 1, word] if row + 1 < rows else zero
            transitions += count_bits((mask ^ under) & below[row, word])
            if row == first_row and row > 0:
                transitions += count_bits(mask & below[row - 1, word])
            edges = mask ^ ((mask << one) | carry)
            carry = mask >> top
            transitions += count_bits(edges & beside[row, word])
            area += count_bits(mask)
            common += count_bits(mask & metal[row, word])
            while edges != zero:
                column = 64 * word + np.int64(lowest_bit(edges))
                edges &= edges - one
                correlation += sums[row, column] if is_inside else -sums[row, column]
                is_inside = not is_inside
        if is_inside:  # up to the last word's last bit, or the image's border
            correlation += sums[row, min(64 * last_word, columns)]
            if last_word < words:
                transitions += count_bits(one & beside[row, last_word])
    return correlation, np.int64(transitions), np.int64(area), np.int64(common)


@njit(cache=True, nogil=True, error_model="numpy")
def measure_scenes(
    pixels_from_world, world_from_cad, vertices, vertex_start, faces, face_start, is_closed,
    region, beside, below, metal, sums, correlation, counts,
):  # fmt: skip
    """Project, fill and measure many scenes in one view.

    Parameters
    ----------
    pixels_from_world : (3, 4).
    world_from_cad : (K, B, 4, 4), K scenes of B bodies.
    vertices, faces : of all bodies, one after the other; body b has those from start[b] to start[b + 1].
    correlation : (K,), filled: the sum of the adjoint under each mask.
    counts : (K, 3), filled: transitions, area, common.

    Returns
    -------
    The smallest depth of any vertex, mm.
    """
    rows, words = region.shape
    columns = sums.shape[1] - 1
    bits = np.zeros((rows, words), dtype=np.uint64)
    u, v = np.empty(len(vertices)), np.empty(len(vertices))
    nearest = np.inf
    for scene in range(world_from_cad.shape[0]):
        left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
        for body in range(world_from_cad.shape[1]):
            first, last = vertex_start[body], vertex_start[body + 1]
            pixels_from_cad = pixels_from_world @ world_from_cad[scene, body]
            nearest = min(nearest, project(pixels_from_cad, vertices[first:last], u[first:last], v[first:last]))
            for i in range(first, last):
                left, right = min(left, u[i]), max(right, u[i])
                top, bottom = min(top, v[i]), max(bottom, v[i])
        if not nearest > 0.0:
            return nearest
        # Clipped before they become integers: a body far outside must not overflow them.
        first_row = np.int64(min(max(np.floor(top), 0.0), rows))
        last_row = np.int64(min(max(np.floor(bottom) + 1.0, first_row), rows))
        first_word = np.int64(min(max(np.floor(left), 0.0), columns)) >> 6
        last_word = max((np.int64(min(max(np.floor(right), -1.0), columns - 1.0)) >> 6) + 1, first_word)
        for body in range(world_from_cad.shape[1]):
            first, last = vertex_start[body], vertex_start[body + 1]
            of_body = faces[face_start[body] : face_start[body + 1]]
            fill(u[first:last], v[first:last], of_body, is_closed[body], bits, columns)
        correlation[scene], counts[scene, 0], counts[scene, 1], counts[scene, 2] = measure(
            bits, first_row, last_row, first_word, last_word, region, beside, below, metal, sums
        )
        bits[first_row:last_row, first_word:last_word] = 0
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
