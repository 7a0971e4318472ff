"""Compiled normal equations of the thickness fit."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})  # sums several lanes at once
def normal_equations(columns, weights, target):
    """``A^T W A`` (n, n) and ``A^T W b`` (n,) of columns (n, rows), weights (rows,) and target (rows,).

    Summed in one order whatever the number of threads, so that the same input gives the same bits on a machine; in
    blocks that the cache holds.
    """
    n, rows = columns.shape
    matrix, right = np.zeros((n, n)), np.zeros(n)
    block = 2048
    weighted = np.empty(block)
    for begin in range(0, rows, block):
        end = min(begin + block, rows)
        for i in range(n):
            for k in range(begin, end):
                weighted[k - begin] = columns[i, k] * weights[k]
            total = 0.0
            for k in range(begin, end):
                total += weighted[k - begin] * target[k]
            right[i] += total
            for j in range(i, n):
                total = 0.0
                for k in range(begin, end):
                    total += weighted[k - begin] * columns[j, k]
                matrix[i, j] += total
    for i in range(n):
        for j in range(i):
            matrix[i, j] = matrix[j, i]
    return matrix, right


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def add_block(first, second, offset, weights, block):
    """Add ``A^T W B`` of two bodies' derivatives to a block (6, 6), over the pixels that both windows hold.

    Parameters
    ----------
    first, second : (2, rows, columns, 6), of the image's derivatives along u and v by each body's motion.
    offset : (4,), row and column of the first's window, then of the second's, in the weights' image.
    weights : (2, rows, columns), of the residuals; 0 where nothing is compared.
    """
    top, left = max(offset[0], offset[2]), max(offset[1], offset[3])
    bottom = min(offset[0] + first.shape[1], offset[2] + second.shape[1])
    right = min(offset[1] + first.shape[2], offset[3] + second.shape[2])
    total = np.zeros((6, 6))
    for along in range(2):
        for row in range(top, bottom):
            for column in range(left, right):
                weight = weights[along, row, column]
                if weight != 0.0:
                    a = first[along, row - offset[0], column - offset[1]]
                    b = second[along, row - offset[2], column - offset[3]]
                    for i in range(6):
                        scaled = weight * np.float64(a[i])
                        for j in range(6):
                            total[i, j] += scaled * b[j]
    block += total


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def add_gradient(first, offset, weights, residuals, gradient):
    """Add ``A^T W r`` of a body's derivatives to its part (6,) of the right side; as `add_block`."""
    for along in range(2):
        for row in range(first.shape[1]):
            for column in range(first.shape[2]):
                weight = weights[along, row + offset[0], column + offset[1]]
                if weight != 0.0:
                    weight *= residuals[along, row + offset[0], column + offset[1]]
                    for i in range(6):
                        gradient[i] += weight * np.float64(first[along, row, column, i])
