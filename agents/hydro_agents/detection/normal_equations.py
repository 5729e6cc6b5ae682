"""Least squares in compiled code: whitened residuals, and small symmetric systems."""

from __future__ import annotations

import math

from hydro_env.compiling import inline

SMALLEST_PIVOT = 0.05
"""Lower limit of a pivot; it keeps a matrix definite after the subtraction of known noise."""

OUTLIER = 3.0
"""Standard deviations beyond which a residual counts linearly (Huber)."""


@inline
def whiten(value, slope, other, filtered, whitened, spread, blend, unit):
    """Write the whitened residual and derivatives to ``whitened``; returns the residual's square, linear for outliers.

    If ``other`` is true, the residual is the difference of both travels, else position minus the travel of chamber a.
    """
    count = spread.shape[0]
    innovation = value - filtered[count]
    filtered[count] += blend * innovation
    size = abs(unit * innovation)
    weight = unit * (1.0 if size < OUTLIER else math.sqrt(OUTLIER / size))
    for i in range(count):
        change = spread[i] * (slope[1, i] - slope[0, i] if other else -slope[0, i]) - filtered[i]
        filtered[i] += blend * change
        whitened[i] = weight * change
    whitened[count] = weight * innovation
    return size * size if size < OUTLIER else OUTLIER * (2.0 * size - OUTLIER)


@inline
def factor(matrix):
    """Cholesky factor of a symmetric positive definite matrix, in place; only the lower half is used."""
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(total, SMALLEST_PIVOT)) if i == j else total / matrix[j, j]


@inline
def hold(matrix, right, unknown, value):
    """Fix an unknown of the normal equations at a value, in place; only the lower half of the matrix is used."""
    for i in range(right.shape[0]):
        row, column = max(i, unknown), min(i, unknown)
        right[i] -= matrix[row, column] * value
        matrix[row, column] = 0.0
    matrix[unknown, unknown], right[unknown] = 1.0, value


@inline
def substitute(lower, right):
    """Solve with a Cholesky factor, in place."""
    count = right.shape[0]
    for i in range(count):
        for k in range(i):
            right[i] -= lower[i, k] * right[k]
        right[i] /= lower[i, i]
    for back in range(count):
        i = count - 1 - back
        for k in range(i + 1, count):
            right[i] -= lower[k, i] * right[k]
        right[i] /= lower[i, i]
