"""Compiled loops that fit the response of a view, robustly: see `thickness`."""

import math

import numpy as np
from numba import njit

from screwpose.similarity.near_kernels import BLOCK, product

_FEW = 6


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_free(matrix, right, is_free):
    """Solve for the free unknowns by Cholesky, the others 0; what a pivot leaves nothing of stays 0 too."""
    n = len(right)
    factor, x = np.zeros((n, n)), np.zeros(n)
    for i in range(n):
        if not is_free[i]:
            continue
        for j in range(i + 1):
            if not is_free[j]:
                continue
            total = matrix[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = math.sqrt(total) if total > 1e-12 * matrix[i, i] else 0.0
            else:
                factor[i, j] = total / factor[j, j] if factor[j, j] > 0.0 else 0.0
    for i in range(n):
        if factor[i, i] > 0.0:
            total = right[i]
            for k in range(i):
                total -= factor[i, k] * x[k]
            x[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        if factor[i, i] > 0.0:
            total = x[i]
            for k in range(i + 1, n):
                total -= factor[k, i] * x[k]
            x[i] = total / factor[i, i]
    return x


@njit(cache=True, nogil=True, error_model="numpy")
def _by_active_set(matrix, right):
    """The same for more unknowns: Lawson & Hanson (1974), chapter 23."""
    n = len(right)
    x, is_free = np.zeros(n), np.zeros(n, np.bool_)
    for _ in range(3 * n):
        best, steepest = -1, 0.0
        for i in range(n):
            if not is_free[i]:
                slope = right[i]
                for j in range(n):
                    slope -= matrix[i, j] * x[j]
                slope /= math.sqrt(max(matrix[i, i], 1e-300))
                if slope > steepest:
                    best, steepest = i, slope
        if best < 0 or steepest < 1e-9 * math.sqrt(max(np.max(np.abs(right)), 1e-300)):
            break
        is_free[best] = True
        while True:
            trial = _solve_free(matrix, right, is_free)
            share, last = 1.0, -1
            for i in range(n):
                if is_free[i] and trial[i] <= 0.0:
                    reach = x[i] / (x[i] - trial[i]) if x[i] > trial[i] else 0.0
                    if reach < share:
                        share, last = reach, i
            if last < 0:
                x[:] = trial
                break
            for i in range(n):
                x[i] += share * (trial[i] - x[i])
                if is_free[i] and (i == last or x[i] <= 0.0):
                    x[i], is_free[i] = 0.0, False
        if not is_free[best]:
            break  # rounding alone had wanted it
    return x


@njit(cache=True, nogil=True, error_model="numpy")
def solve_nonnegative(matrix, right):
    """The x >= 0 (n,) that makes ``x^T M x / 2 - b^T x`` least, M positive definite: every set of free unknowns is
    tried, 31 for five unknowns; with many, see `_by_active_set`."""
    n = len(right)
    if n > _FEW:
        return _by_active_set(matrix, right)
    best, best_value = np.zeros(n), 0.0
    places = np.empty(n, np.int64)
    for chosen in range(1, 1 << n):
        size = 0
        for i in range(n):
            if chosen >> i & 1:
                places[size] = i
                size += 1
        factor = np.zeros((size, size))
        fits = True
        for i in range(size):
            for j in range(i + 1):
                total = matrix[places[i], places[j]]
                for k in range(j):
                    total -= factor[i, k] * factor[j, k]
                if i == j:
                    fits = fits and total > 0.0
                    factor[i, i] = math.sqrt(max(total, 1e-300))
                else:
                    factor[i, j] = total / factor[j, j]
        if not fits:
            continue
        x = np.empty(size)
        for i in range(size):
            total = right[places[i]]
            for k in range(i):
                total -= factor[i, k] * x[k]
            x[i] = total / factor[i, i]
        for i in range(size - 1, -1, -1):
            total = x[i]
            for k in range(i + 1, size):
                total -= factor[k, i] * x[k]
            x[i] = total / factor[i, i]
            fits = fits and x[i] >= 0.0
        if not fits:
            continue
        value = 0.0
        for i in range(size):
            value -= 0.5 * right[places[i]] * x[i]
        if value < best_value:
            best_value = value
            best[:] = 0.0
            for i in range(size):
                best[places[i]] = x[i]
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def _ranked(values, rank):
    """The value (n,) that is greater than `rank` others; changes their order. Quickselect: Hoare (1961)."""
    first, last = 0, len(values) - 1
    while first < last:
        pivot = values[(first + last) // 2]
        i, j = first, last
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if rank <= j:
            last = j
        elif rank >= i:
            first = i
        else:
            break
    return values[rank]


@njit(cache=True, nogil=True, error_model="numpy")
def _spread_of(model, residuals, mask, constants):
    """Robust standard deviation of the residuals where the model has its edges; order statistics need but samples."""
    size = mask.shape[0]
    counted = 0
    for i in range(size):
        counted += mask[i] > 0
    step = max(1, 2 * counted // constants.samples)
    edges, misfits = np.empty(2 * counted // step + 2, np.float32), np.empty(2 * counted // step + 2, np.float32)
    taken, seen = 0, 0
    for along in range(2):
        for i in range(size):
            if mask[i] > 0:
                if seen % step == 0:
                    edges[taken], misfits[taken] = abs(model[along, i]), abs(residuals[along, i])
                    taken += 1
                seen += 1
    if taken == 0:
        return 1.0
    limit = constants.rim_share * _ranked(edges[:taken].copy(), np.int64(0.99 * (taken - 1) + 0.5))
    rim = 0
    for i in range(taken):
        if edges[i] > limit:
            misfits[rim] = misfits[i]
            rim += 1
    if rim == 0:  # no edges at all
        return 1e-9
    return max(1.4826 * np.float64(_ranked(misfits[:rim], rim // 2)), 1e-9)


@njit(cache=True, nogil=True, error_model="numpy")
def _weighted_equations(basis, image, weights, matrix, right):
    """The normal equations of the response: there are five unknowns, and a hundred thousand rows."""
    terms, size = basis.shape[0], weights.shape[1]
    matrix[:], right[:] = 0.0, 0.0
    weighted = np.empty(BLOCK, np.float32)
    for along in range(2):
        for begin in range(0, size, BLOCK):
            end = min(begin + BLOCK, size)
            weight, seen, part = weights[along, begin:end], image[along, begin:end], weighted[: end - begin]
            for i in range(terms):
                one = basis[i, along, begin:end]
                for k in range(end - begin):
                    part[k] = weight[k] * one[k]
                right[i] += np.float64(product(part, seen))
                for j in range(i, terms):
                    matrix[i, j] += np.float64(product(part, basis[j, along, begin:end]))
    for i in range(terms):
        for j in range(i):
            matrix[i, j] = matrix[j, i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add_scaled(values, factor, total):
    for k in range(len(total)):
        total[k] += factor * values[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _robust_weights(residuals, scale, mask, weights):
    """Cauchy's weights of the pixels that count."""
    for k in range(len(mask)):
        far = residuals[k] * scale
        weights[k] = mask[k] / (np.float32(1.0) + far * far)


@njit(cache=True, nogil=True, error_model="numpy")
def fit_response(basis, image, mask, weights, model, residuals, constants):
    """Weights of the basis (n, 2, N) that are not negative, robustly; fills weights, model and residuals (2, N)."""
    terms = basis.shape[0]
    for along in range(2):
        weights[along] = mask
    response, spread = np.zeros(terms), 1.0
    matrix, right = np.empty((terms, terms)), np.empty(terms)
    for _ in range(constants.reweighted):
        _weighted_equations(basis, image, weights, matrix, right)
        ridge = 0.0
        for i in range(terms):
            ridge += 1e-9 * matrix[i, i]
        for i in range(terms):
            matrix[i, i] += ridge
        response = solve_nonnegative(matrix, right)
        model[:] = np.float32(0.0)
        for along in range(2):
            for i in range(terms):
                if response[i] > 0.0:
                    _add_scaled(basis[i, along], np.float32(response[i]), model[along])
            residuals[along] = image[along] - model[along]
        spread = _spread_of(model, residuals, mask, constants)
        scale = np.float32(1.0 / (constants.cauchy * spread))
        for along in range(2):
            _robust_weights(residuals[along], scale, mask, weights[along])
    return response, spread
