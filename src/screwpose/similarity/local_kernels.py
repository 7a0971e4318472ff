"""Compiled loops that let the response's gain and the noise differ from place to place: see `thickness.localised`."""

import numpy as np
from numba import njit

from screwpose.similarity.near_kernels import scattered


@njit(cache=True, nogil=True, error_model="numpy")
def _boxed(values, half, sums):
    """Sums over boxes of 2 half + 1 px along each side, (rows, columns); 0 lies beyond the border."""
    rows, columns = values.shape
    along = np.empty((rows, columns), np.float32)
    for row in range(rows):
        total = np.float32(0.0)
        for column in range(min(half, columns)):
            total += values[row, column]
        for column in range(columns):
            if column + half < columns:
                total += values[row, column + half]
            if column - half > 0:
                total -= values[row, column - half - 1]
            along[row, column] = total
    down = np.zeros(columns, np.float32)
    for row in range(min(half, rows)):
        down += along[row]
    for row in range(rows):
        if row + half < rows:
            down += along[row + half]
        if row - half > 0:
            down -= along[row - half - 1]
        sums[row] = down


@njit(cache=True, nogil=True, error_model="numpy")
def _box_around(near, window, shape, half, values):
    """Replace packed values (N,) by their sums over boxes: of sums that are not negative, and rounding may make so."""
    image, sums = np.zeros(shape, np.float32), np.empty(shape, np.float32)
    scattered(near, window, values, image)
    _boxed(image, half, sums)
    top, left = window
    for row in range(len(near.run_start) - 1):
        for run in range(near.run_start[row], near.run_start[row + 1]):
            first, last = near.first_column[run] - left, near.last_column[run] - left
            values[near.offset[run] : near.offset[run + 1]] = sums[near.first_row + row - top, first:last]


@njit(cache=True, nogil=True, error_model="numpy")
def localise(near, window, shape, image, model, mask, spread, constants, weights, residuals):
    """The gain (N,) at every pixel; fills residuals and weights (2, N) by it and by the noise about each pixel.

    Parameters
    ----------
    near, window, shape : where packed values are in a window, its first row and column, and its rows and columns.
    image, model : (2, N), packed; mask (N,), 1 where they are compared.
    spread : of all residuals; weights (2, N), as it makes them.
    """
    size = len(mask)
    upper, lower = np.zeros(size, np.float32), np.zeros(size, np.float32)
    for along in range(2):
        for k in range(size):
            weighted = weights[along, k] * model[along, k]
            upper[k] += weighted * image[along, k]
            lower[k] += weighted * model[along, k]
    total, compared = 0.0, 0.0
    for k in range(size):
        total += lower[k]
        compared += mask[k]
    half = constants.gain_px
    hold = np.float32(constants.gain_hold * total / max(compared, 1.0) * (2 * half + 1) ** 2 + 1e-30)
    _box_around(near, window, shape, half, upper)
    _box_around(near, window, shape, half, lower)
    gain = np.empty(size, np.float32)
    least, most = np.float32(1.0 / constants.most_gain), np.float32(constants.most_gain)
    for k in range(size):
        gain[k] = min(max((upper[k] + hold) / (max(lower[k], np.float32(0.0)) + hold), least), most)
    # Squares beyond what is believed are cut, so that an outlier does not make its surroundings doubtful.
    variance = np.float32(spread * spread)
    squared_cauchy = np.float32(constants.cauchy * constants.cauchy)
    squares, counts = np.zeros(size, np.float32), mask.copy()
    for along in range(2):
        for k in range(size):
            left = image[along, k] - gain[k] * model[along, k]
            residuals[along, k] = left
            squares[k] += mask[k] * min(left * left, np.float32(4.0) * squared_cauchy * variance)
    half = constants.spread_px
    hold = np.float32(constants.spread_hold * (2 * half + 1) ** 2)
    _box_around(near, window, shape, half, squares)
    _box_around(near, window, shape, half, counts)
    for k in range(size):
        about = max(squares[k], np.float32(0.0)) * np.float32(0.5) + hold * variance
        about /= max(counts[k], np.float32(0.0)) + hold
        for along in range(2):
            left = residuals[along, k]
            weights[along, k] = mask[k] * variance / (about + left * left / squared_cauchy)
    return gain
