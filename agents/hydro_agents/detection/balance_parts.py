"""Parts of the flow balance, in compiled code: the spool between two samples, and small least-squares systems.

The candidate valve that fits the readings best gives the spool's motion, and the readings correct it.
"""

import math

from hydro_agents.detection.sheet import POINTS
from hydro_env.compiling import inline

SMALLEST_PIVOT = 0.05  # lower limit of a pivot; it keeps a matrix definite after the subtraction of known noise
OUTLIER = 3.0  # standard deviations beyond which a residual counts linearly (Huber)


@inline
def _advance(valve, row, old, new):
    """Move the states of a valve by a period: (3, 5) matrix, previous command and new one."""
    first = row[0, 0] * valve[0] + row[0, 1] * valve[1] + row[0, 2] * valve[2] + row[0, 3] * old + row[0, 4] * new
    second = row[1, 0] * valve[0] + row[1, 1] * valve[1] + row[1, 2] * valve[2] + row[1, 3] * old + row[1, 4] * new
    third = row[2, 0] * valve[0] + row[2, 1] * valve[1] + row[2, 2] * valve[2] + row[2, 3] * old + row[2, 4] * new
    valve[0], valve[1], valve[2] = first, second, third


@inline
def follow_commands(command, row, valve, spool):
    """Write the response of a valve, ideal at the start, to the commands (T,)."""
    valve[0], valve[1], valve[2] = command[0], 0.0, command[0]
    spool[0] = valve[0]
    for k in range(1, command.shape[0]):
        _advance(valve, row, command[k - 1], command[k])
        spool[k] = valve[0]


@inline
def best_valve(reading, command, candidates, noise, valve):
    """Index of the valve whose response to the commands is closest to the readings, apart from a constant."""
    best, least = 0, 1e300
    for candidate in range(candidates.shape[0]):
        row = candidates[candidate, POINTS]
        valve[0], valve[1], valve[2] = reading[0], 0.0, command[0]
        mean, total = 0.0, 0.0
        for k in range(1, reading.shape[0]):
            _advance(valve, row, command[k - 1], command[k])
            # Large differences, such as at the slew limit, count as at most 20 times the noise.
            off = min(max(reading[k] - valve[0] - mean, -20.0 * noise), 20.0 * noise)
            mean += off / (k + 5.0)
            total += off * off
        if total < least:
            best, least = candidate, total
    return best


@inline
def spool_between(reading, command, transition, noise, valve, spool, error, smooth):
    """Spool position between samples (T − 1, POINTS), and the readings minus the valve's response at the samples (T,).

    The difference between readings and response is modelled as a random walk with sensor noise, and smoothed (Rauch,
    Tung & Striebel 1965, with steady-state gains).
    """
    samples = reading.shape[0]
    valve[0], valve[1], valve[2] = reading[0], 0.0, command[0]
    error[0] = 0.0
    walk = 0.0
    for k in range(samples - 1):
        for point in range(POINTS):
            row = transition[point]
            spool[k, point] = row[0, 3] * command[k] + row[0, 4] * command[k + 1]
            for state in range(3):
                spool[k, point] += row[0, state] * valve[state]
        _advance(valve, transition[POINTS], command[k], command[k + 1])
        error[k + 1] = reading[k + 1] - valve[0]
        walk += (error[k + 1] - error[k]) ** 2 / (samples - 1)
    measured = noise * noise
    walk = max(walk - 2.0 * measured, 1e-4 * measured)
    ahead = 0.5 * (walk + math.sqrt(walk * walk + 4.0 * walk * measured))
    steady = ahead / (ahead + measured)
    smooth[0] = error[0]
    for k in range(1, samples):
        smooth[k] = smooth[k - 1] + max(1.0 / (k + 1.0), steady) * (error[k] - smooth[k - 1])
    for back in range(samples - 1):
        k = samples - 2 - back
        kept = max(1.0 / (k + 1.0), steady) * measured
        smooth[k] += kept / (kept + walk) * (smooth[k + 1] - smooth[k])
        for point in range(POINTS):
            share = (point + 0.5) / POINTS
            spool[k, point] += (1.0 - share) * smooth[k] + share * smooth[k + 1]


@inline
def whiten(value, slope, other, filtered, whitened, spread, blend, unit):
    """Write the whitened residual and derivatives to ``whitened``; returns the residual's square, linear for outliers.

    If ``other`` is true, the residual is the difference of both travels, else position minus the travel of chamber a.
    """
    count = spread.shape[0]
    innovation = value - filtered[count]
    filtered[count] += blend * innovation
    size = abs(unit * innovation)
    weight, square = unit, size * size
    if size >= OUTLIER:
        weight, square = unit * math.sqrt(OUTLIER / size), OUTLIER * (2.0 * size - OUTLIER)
    for i in range(count):
        change = spread[i] * (slope[1, i] - slope[0, i] if other else -slope[0, i]) - filtered[i]
        filtered[i] += blend * change
        whitened[i] = weight * change
    whitened[count] = weight * innovation
    return square


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
