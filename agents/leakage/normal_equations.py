"""Small symmetric systems in compiled code: Cholesky factor and substitution."""

from __future__ import annotations

import math

from hydro_env.compiling import inline

SMALLEST_PIVOT = 0.05
"""A smaller pivot is raised to this, which keeps a matrix definite from which known noise was taken out."""


@inline
def factor(matrix):
    """Cholesky factor of a symmetric positive definite matrix, in place; the lower half counts."""
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(total, SMALLEST_PIVOT)) if i == j else total / matrix[j, j]


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
