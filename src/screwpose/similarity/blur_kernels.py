"""Compiled loops of a detector's blur: from path lengths to those that the blurred intensity seems to have passed."""

import numpy as np
from numba import njit

from screwpose.projection.length_kernels import Drawn
from screwpose.similarity.near_kernels import add_row, along_row


@njit(cache=True, nogil=True, error_model="numpy")
def gathered(finer, parts):
    """What was drawn of every pixel's parts, `parts` by `parts`, as one ray each: `Drawn` of their means."""
    count = len(finer.first_row)
    first_row, row_start = np.zeros(count, np.int64), np.zeros(count + 1, np.int64)
    for body in range(count):
        rows = finer.row_start[body + 1] - finer.row_start[body]
        first_row[body] = finer.first_row[body] // parts
        end = -(-(finer.first_row[body] + rows) // parts) if rows else first_row[body]
        row_start[body + 1] = row_start[body] + end - first_row[body]
    rows = row_start[count]
    first_column, last_column = np.full(rows, 1 << 30), np.full(rows, -(1 << 30))
    for body in range(count):
        for place in range(finer.row_start[body], finer.row_start[body + 1]):
            if finer.last_column[place] > finer.first_column[place]:
                y = finer.first_row[body] + place - finer.row_start[body]
                row = row_start[body] + y // parts - first_row[body]
                first_column[row] = min(first_column[row], finer.first_column[place] // parts)
                last_column[row] = max(last_column[row], -(-finer.last_column[place] // parts))
    offset = np.zeros(rows + 1, np.int64)
    for row in range(rows):
        if last_column[row] <= first_column[row]:
            first_column[row] = last_column[row] = 0
        offset[row + 1] = offset[row] + last_column[row] - first_column[row]
    lengths, by_motion = np.zeros(offset[rows]), np.zeros((6, offset[rows]), np.float32)
    share = 1.0 / parts**2
    for body in range(count):
        for place in range(finer.row_start[body], finer.row_start[body + 1]):
            y = finer.first_row[body] + place - finer.row_start[body]
            row = row_start[body] + y // parts - first_row[body]
            for k in range(finer.offset[place], finer.offset[place + 1]):
                column = finer.first_column[place] + k - finer.offset[place]
                goal = offset[row] + column // parts - first_column[row]
                lengths[goal] += share * finer.lengths_mm[k]
                for i in range(6):
                    by_motion[i, goal] += np.float32(share) * finer.by_motion[i, k]
    return Drawn(first_row, row_start, first_column, last_column, offset, lengths, by_motion, finer.nearest_mm)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _two_along_row(padded, width, first, second, one, two):
    """Two even filters along a row: outputs (width,) from padded (width + 2 reach,)."""
    reach = len(first) - 1
    middle, a, b = padded[reach : reach + width], first[0], second[0]
    for i in range(width):
        one[i] = a * middle[i]
        two[i] = b * middle[i]
    for t in range(1, reach + 1):
        a, b = first[t], second[t]
        before, after = padded[reach - t : reach - t + width], padded[reach + t : reach + t + width]
        for i in range(width):
            both = before[i] + after[i]
            one[i] += a * both
            two[i] += b * both


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _along_row(padded, width, taps, one):
    reach = len(taps) - 1
    middle, a = padded[reach : reach + width], taps[0]
    for i in range(width):
        one[i] = a * middle[i]
    for t in range(1, reach + 1):
        a = taps[t]
        before, after = padded[reach - t : reach - t + width], padded[reach + t : reach + t + width]
        for i in range(width):
            one[i] += a * (before[i] + after[i])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add(values, factor, total):
    for i in range(len(total)):
        total[i] += factor * values[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add_products(first, a, second, b, total):
    for i in range(len(total)):
        total[i] += a * first[i] + b * second[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _length(taps):
    """How many of them matter."""
    last = len(taps) - 1
    while last > 0 and abs(taps[last]) < 1e-9:
        last -= 1
    return last + 1


@njit(cache=True, nogil=True, error_model="numpy")
def through_blur(shape, total_mm, wide, left, spread, px_per_px, scratch, limits):
    """The lengths that the blurred intensity seems to have passed, and how they change with the blur, (4,): sigma,
    attenuation, tail, edge. Clips the lengths in place."""
    rows, columns = shape
    seen = np.float32(1.0 - limits.least_lit)
    absorbed, lit_mm = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    begins, ends = np.full(rows, columns), np.zeros(rows, np.int64)
    fine, parts = total_mm.shape[0] // rows, np.float32(1.0 / (total_mm.shape[0] // rows) ** 2)
    for row in range(rows):
        for run in range(wide.run_start[row], wide.run_start[row + 1]):
            for x in range(wide.first_column[run] - left, wide.last_column[run] - left):
                for i in range(fine):
                    for j in range(fine):
                        length = total_mm[fine * row + i, fine * x + j]
                        if length != np.float32(0.0):
                            length = min(max(length, np.float32(0.0)), np.float32(limits.longest_mm))
                            lit = np.exp(np.float32(-spread.per_mm) * length)
                            absorbed[row, x] += parts * seen * (np.float32(1.0) - lit)
                            lit_mm[row, x] += parts * seen * length * lit
                            begins[row], ends[row] = min(begins[row], x), x + 1
    around = np.zeros((4, rows, columns), np.float32)  # absorbed, its changes with sigma and tail, lit_mm
    part, change = np.zeros(columns, np.float32), np.zeros(columns, np.float32)
    for component in range(len(spread.weights)):
        reach = max(_length(spread.smooth[component]), _length(spread.change[component])) - 1
        smooth, slope = spread.smooth[component, : reach + 1], spread.change[component, : reach + 1]
        weight = np.float32(spread.weights[component])
        by_sigma = np.float32(spread.weights[component] * spread.by_sigma[component])
        by_tail = np.float32(spread.weights[component] * spread.by_tail[component])
        for row in range(rows):
            if ends[row] <= begins[row]:
                continue
            first, last = begins[row] - reach, ends[row] + reach
            source = slice(first - reach, last + reach)
            _two_along_row(
                absorbed[row, source], last - first, smooth, slope, scratch[0, row, first:last],
                scratch[1, row, first:last],
            )  # fmt: skip
            _along_row(lit_mm[row, source], last - first, smooth, scratch[2, row, first:last])
        for row in range(rows):
            for run in range(wide.run_start[row], wide.run_start[row + 1]):
                first, last = wide.first_column[run] - left, wide.last_column[run] - left
                part[: last - first] = np.float32(0.0)
                change[: last - first] = np.float32(0.0)
                touched = False
                for other in range(max(row - reach, 0), min(row + reach + 1, rows)):
                    if ends[other] <= begins[other]:
                        continue
                    begin, end = max(first, begins[other] - reach), min(last, ends[other] + reach)
                    if begin >= end:
                        continue
                    touched = True
                    a, b = smooth[abs(other - row)], slope[abs(other - row)]
                    _add(scratch[0, other, begin:end], a, part[begin - first : end - first])
                    _add_products(
                        scratch[0, other, begin:end], b, scratch[1, other, begin:end], a,
                        change[begin - first : end - first],
                    )  # fmt: skip
                    _add(scratch[2, other, begin:end], a * weight, around[3, row, begin:end])
                if touched:
                    _add(part[: last - first], weight, around[0, row, first:last])
                    _add(change[: last - first], by_sigma, around[1, row, first:last])
                    _add(change[: last - first], by_tail, around[2, row, first:last])
    per_mm = np.float32(1.0 / spread.per_mm)
    through = np.zeros((rows, columns), np.float32)
    for row in range(rows):
        for run in range(wide.run_start[row], wide.run_start[row + 1]):
            for x in range(wide.first_column[run] - left, wide.last_column[run] - left):
                lit = max(np.float32(1.0) - around[0, row, x], np.float32(limits.least_lit))
                length = -np.log(lit) * per_mm
                through[row, x] = length
                rise = per_mm / lit
                around[1, row, x] *= rise
                around[2, row, x] *= rise
                # by the attenuation, standardised in its logarithm
                around[3, row, x] = (around[3, row, x] / lit - length) * np.float32(spread.by_per_mm)
    steep = np.zeros((rows, columns), np.float32)
    taps = len(spread.steep_smooth) - 1
    scratch[:2] = np.float32(0.0)
    for row in range(rows):
        for run in range(wide.run_start[row], wide.run_start[row + 1]):
            first, last = wide.first_column[run] - left, wide.last_column[run] - left
            along_row(
                through[row, first - taps : last + taps], last - first, spread.steep_smooth, spread.steep_slope,
                scratch[0, row, first:last], scratch[1, row, first:last],
            )  # fmt: skip
    for row in range(rows):
        for run in range(wide.run_start[row], wide.run_start[row + 1]):
            first, last = wide.first_column[run] - left, wide.last_column[run] - left
            part[: last - first] = np.float32(0.0)
            change[: last - first] = np.float32(0.0)
            for other in range(max(row - taps, 0), min(row + taps + 1, rows)):
                away = other - row
                turned = spread.steep_slope[abs(away)] if away > 0 else -spread.steep_slope[abs(away)]
                add_row(
                    scratch[0, other, first:last], scratch[1, other, first:last], spread.steep_smooth[abs(away)],
                    turned, part[: last - first], change[: last - first],
                )  # fmt: skip
            for x in range(first, last):
                steep[row, x] = np.sqrt(part[x - first] ** 2 + change[x - first] ** 2)
    by_blur = np.zeros((4, rows, columns), np.float32)
    shift, by_edge = np.float32(spread.edge_px * px_per_px), np.float32(spread.by_edge * px_per_px)
    for row in range(rows):
        for run in range(wide.run_start[row], wide.run_start[row + 1]):
            for x in range(wide.first_column[run] - left, wide.last_column[run] - left):
                length = through[row, x] + shift * steep[row, x]
                through[row, x] = min(max(length, np.float32(0.0)), np.float32(limits.longest_mm))
                if length > np.float32(0.0):
                    by_blur[0, row, x], by_blur[1, row, x] = around[1, row, x], around[3, row, x]
                    by_blur[2, row, x], by_blur[3, row, x] = around[2, row, x], by_edge * steep[row, x]
    return through, by_blur
