"""Compiled loops from path lengths that change with the bodies' motions to normal equations."""

import numpy as np
from numba import njit

from screwpose.similarity.near_kernels import add_row, along_row, near_spans, product


@njit(cache=True, nogil=True, error_model="numpy")
def _derivatives_of(drawn, body, values, taps, near_row, near_left, near_right, near_offset, smoothed, sloped, out):
    """Derivatives (2, n) along u and v of a body's values, over its near spans.

    Parameters
    ----------
    values : (n,), in the order of the drawn lengths; smoothed, sloped : scratch, (n + 2 reach rows,).
    """
    smooth, slope = taps
    reach = len(smooth) - 1
    first, end = drawn.row_start[body], drawn.row_start[body + 1]
    widest = 0
    for place in range(first, end):
        widest = max(widest, drawn.last_column[place] - drawn.first_column[place])
    padded = np.zeros(widest + 4 * reach, np.float32)
    base = drawn.offset[first]
    for place in range(first, end):
        begin = drawn.offset[place]
        width = drawn.offset[place + 1] - begin
        if width == 0:
            continue
        padded[2 * reach : 2 * reach + width] = values[begin : begin + width]
        padded[2 * reach + width : width + 4 * reach] = np.float32(0.0)
        own = slice(begin - base + 2 * reach * (place - first), begin - base + 2 * reach * (place - first + 1) + width)
        along_row(padded, width + 2 * reach, smooth, slope, smoothed[own], sloped[own])
    out[:] = np.float32(0.0)
    for row in range(len(near_left)):
        y = row + near_row
        if near_right[row] <= near_left[row]:
            continue
        for other in range(
            max(y - reach, drawn.first_row[body]), min(y + reach + 1, drawn.first_row[body] + end - first)
        ):
            place = first + other - drawn.first_row[body]
            if drawn.last_column[place] <= drawn.first_column[place]:
                continue
            begin_column = drawn.first_column[place] - reach
            left = max(near_left[row], begin_column)
            right = min(near_right[row], drawn.last_column[place] + reach)
            if left >= right:
                continue
            origin = drawn.offset[place] - base + 2 * reach * (place - first) - begin_column
            goal = near_offset[row] - near_left[row]
            away = other - y
            weight = smooth[abs(away)]
            steep = slope[abs(away)] if away > 0 else -slope[abs(away)]
            if away == 0:
                steep = np.float32(0.0)
            add_row(
                smoothed[origin + left : origin + right], sloped[origin + left : origin + right], weight, steep,
                out[0, goal + left : goal + right], out[1, goal + left : goal + right],
            )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def steepness_of(drawn, response, constants, total_mm, window):
    """How the response changes with the path length, s'(L), at every pixel that a body covers: as `lengths_mm`."""
    top, left = window
    steepness = np.zeros(len(drawn.lengths_mm), np.float32)
    for body in range(len(drawn.first_row)):
        for place in range(drawn.row_start[body], drawn.row_start[body + 1]):
            row = drawn.first_row[body] + place - drawn.row_start[body] - top
            for k in range(drawn.offset[place], drawn.offset[place + 1]):
                length = total_mm[row, drawn.first_column[place] + k - drawn.offset[place] - left]
                total = np.float32(0.0)
                for i in range(len(response)):
                    if response[i] > 0.0:
                        total += np.float32(response[i] / constants.saturation_mm[i]) * np.exp(
                            -length / constants.saturation_mm[i]
                        )
                steepness[k] = total
    return steepness


@njit(cache=True, nogil=True, error_model="numpy")
def pulled_by(pulls, view):
    """The adjoint of the derivatives: what the pulls (2, rows, columns) on the model's derivatives along u and v are
    on the model itself, (rows, columns). The filters are odd one way and even the other, so it is they, turned round.
    """
    smooth, slope = view.smooth, view.slope
    reach = len(smooth) - 1
    _, rows, columns = pulls.shape
    padded = np.zeros(columns + 2 * reach, np.float32)
    filtered = np.empty((2, rows, columns), np.float32)
    unused = np.empty(columns, np.float32)
    for row in range(rows):
        padded[reach : reach + columns] = pulls[0, row]
        along_row(padded, columns, smooth, slope, unused, filtered[0, row])
        padded[reach : reach + columns] = pulls[1, row]
        along_row(padded, columns, smooth, slope, filtered[1, row], unused)
    pulled = np.zeros((rows, columns), np.float32)
    for row in range(rows):
        for other in range(max(row - reach, 0), min(row + reach + 1, rows)):
            away = other - row
            steep = slope[abs(away)] if away > 0 else -slope[abs(away)]
            _subtract_row(filtered[0, other], filtered[1, other], smooth[abs(away)], steep, pulled[row])
    return pulled


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _subtract_row(first, second, of_first, of_second, total):
    for i in range(len(total)):
        total[i] -= of_first * first[i] + of_second * second[i]


@njit(cache=True, nogil=True, error_model="numpy")
def add_gradient(drawn, steepness, pulled, window, gradient):
    """Fill the right side of the normal equations, (6 B,): how much the pulls on the model gain by each motion."""
    top, left = window
    for body in range(len(drawn.first_row)):
        for place in range(drawn.row_start[body], drawn.row_start[body + 1]):
            begin, end = drawn.offset[place], drawn.offset[place + 1]
            if begin == end:
                continue
            row = drawn.first_row[body] + place - drawn.row_start[body] - top
            first = drawn.first_column[place] - left
            gained = pulled[row, first : first + end - begin] * steepness[begin:end]
            for i in range(6):
                gradient[6 * body + i] += np.float64(product(gained, drawn.by_motion[i, begin:end]))


@njit(cache=True, nogil=True, error_model="numpy")
def add_information(drawn, taps, bounds, steepness, window, weights, information):
    """Fill the matrix of the normal equations, (6 B, 6 B): weights are (2, rows, columns) of the window.

    Returns
    -------
    How the derivatives change, (6, 2, n), and where they stand: of each body its first row, and where its rows are
    among all; of each row its first column, its last, and its offset.
    """
    count = len(drawn.first_row)
    top, left = window
    smooth, slope = taps
    reach = len(smooth) - 1
    near_rows = np.zeros(count, np.int64)
    rows_of = np.zeros(count + 1, np.int64)
    for body in range(count):
        near_rows[body], lefts, rights = near_spans(drawn, body, reach, bounds)
        rows_of[body + 1] = rows_of[body] + len(lefts)
    near_left, near_right = np.empty(rows_of[count], np.int64), np.empty(rows_of[count], np.int64)
    near_offset = np.zeros(rows_of[count] + 1, np.int64)
    for body in range(count):
        _, lefts, rights = near_spans(drawn, body, reach, bounds)
        for row in range(len(lefts)):
            place = rows_of[body] + row
            near_left[place], near_right[place] = lefts[row], max(rights[row], lefts[row])
            near_offset[place + 1] = near_offset[place] + near_right[place] - near_left[place]
    moved = np.empty((6, 2, near_offset[rows_of[count]]), np.float32)
    for body in range(count):
        first, end = drawn.row_start[body], drawn.row_start[body + 1]
        own_rows = slice(rows_of[body], rows_of[body + 1])
        begin, last = near_offset[rows_of[body]], near_offset[rows_of[body + 1]]
        size = drawn.offset[end] - drawn.offset[first] + 2 * reach * (end - first)
        smoothed, sloped = np.empty(size, np.float32), np.empty(size, np.float32)
        values = np.empty(len(steepness), np.float32)
        for k in range(6):
            for place in range(drawn.offset[first], drawn.offset[end]):
                values[place] = steepness[place] * drawn.by_motion[k, place]
            _derivatives_of(
                drawn, body, values, (smooth, slope), near_rows[body], near_left[own_rows],
                near_right[own_rows], near_offset[own_rows] - begin, smoothed, sloped, moved[k, :, begin:last],
            )  # fmt: skip
    widest = 0
    for row in range(len(near_left)):
        widest = max(widest, near_right[row] - near_left[row])
    weighted = np.empty((6, 2, widest), np.float32)
    for body in range(count):
        for row in range(rows_of[body + 1] - rows_of[body]):
            place = rows_of[body] + row
            width = near_right[place] - near_left[place]
            if width == 0:
                continue
            y = near_rows[body] + row - top
            goal = near_left[place] - left
            own = slice(near_offset[place], near_offset[place + 1])
            for along in range(2):
                weight = weights[along, y, goal : goal + width]
                for i in range(6):
                    source, result = moved[i, along, own], weighted[i, along, :width]
                    for k in range(width):
                        result[k] = weight[k] * source[k]
            for other in range(body, count):
                other_row = y + top - near_rows[other]
                if other_row < 0 or other_row >= rows_of[other + 1] - rows_of[other]:
                    continue
                its = rows_of[other] + other_row
                begin, last = max(near_left[place], near_left[its]), min(near_right[place], near_right[its])
                if begin >= last:
                    continue
                mine, shift = begin - near_left[place], near_offset[its] + begin - near_left[its]
                for i in range(6):
                    for j in range(i if other == body else 0, 6):
                        for along in range(2):
                            information[6 * body + i, 6 * other + j] += np.float64(
                                product(
                                    weighted[i, along, mine : mine + last - begin],
                                    moved[j, along, shift : shift + last - begin],
                                )
                            )
    for i in range(6 * count):
        for j in range(i):
            information[i, j] = information[j, i]
    return moved, near_rows, rows_of, near_left, near_right, near_offset


@njit(cache=True, nogil=True, error_model="numpy")
def add_scores(motions, window, pulls, block_px, scores):
    """Fill what each block of the image adds to the right side of the normal equations, (block rows, block columns,
    6 B): motions as `add_information` returns them; pulls are (2, rows, columns) of the window."""
    moved, first_row, rows_of, lefts, rights, offset = motions
    top, left = window
    for body in range(len(first_row)):
        for row in range(rows_of[body + 1] - rows_of[body]):
            place = rows_of[body] + row
            y = first_row[body] + row
            column, end = lefts[place], rights[place]
            while column < end:
                last = min((column // block_px + 1) * block_px, end)
                begin = offset[place] + column - lefts[place]
                own = slice(begin, begin + last - column)
                block = scores[y // block_px, column // block_px]
                for along in range(2):
                    pull = pulls[along, y - top, column - left : last - left]
                    for i in range(6):
                        block[6 * body + i] += np.float64(product(pull, moved[i, along, own]))
                column = last
