"""Compiled loops over the pixels that derivatives of metal reach: which they are, and filters along their rows."""

from collections import namedtuple

import numpy as np
from numba import njit

Near = namedtuple("Near", ["first_row", "run_start", "first_column", "last_column", "offset"])
"""The pixels that derivatives of metal reach, as runs of columns: row y of the image has those from
run_start[y - first_row] to the next; values of a run stand from its offset on."""

BLOCK = 512


@njit(cache=True, nogil=True, error_model="numpy")
def near_spans(drawn, body, reach, bounds):
    """A body's rows and spans, wider by the reach all round: first row, first columns, last columns."""
    first, end = drawn.row_start[body], drawn.row_start[body + 1]
    begin = max(drawn.first_row[body] - reach, bounds[0])
    rows = max(min(drawn.first_row[body] + end - first + reach, bounds[1]) - begin, 0) if end > first else 0
    lefts, rights = np.full(rows, bounds[3]), np.full(rows, bounds[2])
    for place in range(first, end):
        if drawn.last_column[place] <= drawn.first_column[place]:
            continue
        y = drawn.first_row[body] + place - first
        left = max(drawn.first_column[place] - reach, bounds[2])
        right = min(drawn.last_column[place] + reach, bounds[3])
        for row in range(max(y - reach, begin) - begin, min(y + reach + 1, begin + rows) - begin):
            lefts[row] = min(lefts[row], left)
            rights[row] = max(rights[row], right)
    return begin, lefts, rights


@njit(cache=True, nogil=True, error_model="numpy")
def near_runs(drawn, reach, bounds):
    """`Near` of all bodies together: spans that meet become one run."""
    count = len(drawn.first_row)
    first_row, last_row = bounds[1], bounds[0]
    for body in range(count):
        rows = drawn.row_start[body + 1] - drawn.row_start[body]
        if rows:
            first_row = min(first_row, max(drawn.first_row[body] - reach, bounds[0]))
            last_row = max(last_row, min(drawn.first_row[body] + rows + reach, bounds[1]))
    rows = max(last_row - first_row, 0)
    lefts, rights = np.full((rows, count), bounds[3]), np.full((rows, count), bounds[2])
    for body in range(count):
        begin, left, right = near_spans(drawn, body, reach, bounds)
        for row in range(len(left)):
            lefts[row + begin - first_row, body] = left[row]
            rights[row + begin - first_row, body] = right[row]
    run_start = np.zeros(rows + 1, np.int64)
    first_column, last_column = np.empty(rows * count, np.int64), np.empty(rows * count, np.int64)
    runs = 0
    for row in range(rows):
        begin_of_row = runs
        done = bounds[2] - 1
        for _ in range(count):
            # The next span by its first column; of two that begin alike the longer, and the other lies within it.
            left, right = bounds[3], bounds[2]
            for body in range(count):
                begin, end = lefts[row, body], rights[row, body]
                if end > begin > done and (begin < left or (begin == left and end > right)):
                    left, right = begin, end
            if right <= left:
                break
            done = left
            if runs > begin_of_row and left <= last_column[runs - 1]:
                last_column[runs - 1] = max(last_column[runs - 1], right)
            else:
                first_column[runs], last_column[runs] = left, right
                runs += 1
        run_start[row + 1] = runs
    offset = np.zeros(runs + 1, np.int64)
    for run in range(runs):
        offset[run + 1] = offset[run] + last_column[run] - first_column[run]
    return Near(first_row, run_start, first_column[:runs], last_column[:runs], offset)


@njit(cache=True, nogil=True, error_model="numpy")
def mark_near(drawn, body, reach, least_mm, bounds, window, flags):
    """Flag (rows, columns of the window) what lies no further from metal than the reach, along rows alone."""
    top, left = window
    for place in range(drawn.row_start[body], drawn.row_start[body + 1]):
        row = drawn.first_row[body] + place - drawn.row_start[body] - top
        shift = drawn.offset[place] - drawn.first_column[place]
        free = 0
        for column in range(drawn.first_column[place], drawn.last_column[place]):
            if drawn.lengths_mm[column + shift] > least_mm:
                for near_column in range(max(column - reach, bounds[2], free), min(column + reach + 1, bounds[3])):
                    flags[row, near_column - left] = 1
                free = min(column + reach + 1, bounds[3])


@njit(cache=True, nogil=True, error_model="numpy")
def spread_to_rows(flags, row, first, last, reach, found):
    """Spread a row's flags over the rows within reach: found (last - first,)."""
    found[:] = 0
    for other in range(max(row - reach, 0), min(row + reach + 1, flags.shape[0])):
        for column in range(first, last):
            found[column - first] |= flags[other, column]


@njit(cache=True, nogil=True, error_model="numpy")
def scattered(near, window, values, image):
    """Put packed values in their places."""
    top, left = window
    for row in range(len(near.run_start) - 1):
        for run in range(near.run_start[row], near.run_start[row + 1]):
            image[near.first_row + row - top, near.first_column[run] - left : near.last_column[run] - left] = values[
                near.offset[run] : near.offset[run + 1]
            ]


# In the innermost loops an index runs from 0 over slices: an index that is a sum could be negative for all that the
# compiler knows, and then it does not use the wide registers.


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def along_row(padded, width, smooth, slope, smoothed, sloped):
    """Smooth and differentiate along a row: outputs (width,) from padded (width + 2 reach,)."""
    reach = len(smooth) - 1
    middle, weight = padded[reach : reach + width], smooth[0]
    for i in range(width):
        smoothed[i] = weight * middle[i]
        sloped[i] = np.float32(0.0)
    for t in range(1, reach + 1):
        weight, steep = smooth[t], slope[t]
        before, after = padded[reach - t : reach - t + width], padded[reach + t : reach + t + width]
        for i in range(width):
            smoothed[i] += weight * (before[i] + after[i])
            sloped[i] += steep * (after[i] - before[i])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def add_row(smoothed, sloped, weight, steep, along_u, along_v):
    """Add a row's share to the derivatives of a row above or below it."""
    for i in range(len(along_u)):
        along_u[i] += weight * sloped[i]
        along_v[i] += steep * smoothed[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def product(first, second):
    """The sum of products, in single precision: for a row or a block."""
    total = np.float32(0.0)
    for i in range(len(first)):
        total += first[i] * second[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def long_product(first, second):
    """The sum of products of long vectors: blocks in single precision, their sum in double."""
    total = 0.0
    for begin in range(0, len(first), BLOCK):
        end = min(begin + BLOCK, len(first))
        total += np.float64(product(first[begin:end], second[begin:end]))
    return total
