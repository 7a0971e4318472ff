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
def upright(xa, ya, xb, yb, xc, yc):
    """A triangle's corners from the top down, and the slopes of its long edge and of its two short ones."""
    if yb < ya:
        xa, ya, xb, yb = xb, yb, xa, ya
    if yc < ya:
        xa, ya, xc, yc = xc, yc, xa, ya
    if yc < yb:
        xb, yb, xc, yc = xc, yc, xb, yb
    long_slope = (xc - xa) / (yc - ya) if yc > ya else 0.0
    upper_slope = (xb - xa) / (yb - ya) if yb > ya else 0.0
    lower_slope = (xc - xb) / (yc - yb) if yc > yb else 0.0
    return xa, ya, xb, yb, yc, long_slope, upper_slope, lower_slope


@njit(cache=True, nogil=True, error_model="numpy")
def fill(u, v, faces, one_sided, bits, columns):
    """Set the bits of every pixel whose centre lies in or on the edge of a triangle.

    Parameters
    ----------
    u, v : (N,) vertices, px.
    faces : (F, 3).
    one_sided : leave out the triangles that turn one way: those of a closed surface that face the other way cover
        the same pixels.
    bits : (rows, words), uint64; bits beyond `columns` stay as they are.
    """
    rows = bits.shape[0]
    for face in range(faces.shape[0]):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        xa, ya, xb, yb, xc, yc = u[a], v[a], u[b], v[b], u[c], v[c]
        doubled_area = (xb - xa) * (yc - ya) - (yb - ya) * (xc - xa)
        if doubled_area == 0.0 or (one_sided and doubled_area < 0.0):
            continue
        first, last = max(math.ceil(min(ya, yb, yc)), 0), min(math.floor(max(ya, yb, yc)), rows - 1)
        if first > last:
            continue
        xa, ya, xb, yb, _, long_slope, upper_slope, lower_slope = upright(xa, ya, xb, yb, xc, yc)
        for row in range(first, last + 1):
            on_long = xa + (row - ya) * long_slope
            on_short = xa + (row - ya) * upper_slope if row < yb else xb + (row - yb) * lower_slope
            left = max(math.ceil(min(on_long, on_short)), 0)
            right = min(math.floor(max(on_long, on_short)), columns - 1)
            if left > right:
                continue
            set_run(bits, row, left, right)
