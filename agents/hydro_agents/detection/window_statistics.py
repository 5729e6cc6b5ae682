"""Statistics of a window of measured signals, in compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple

from hydro_agents.detection.balance_parts import factor, substitute
from hydro_env.compiling import inline

STILL_COMMAND = 2e-3
"""Change of the command within one period below which the spool should be at the commanded position."""

FULL_COMMAND = 0.999

RIDGE = 1e-3
"""Added to the diagonal of the normal equations of the load, per sample (ridge regression)."""


class Summary(NamedTuple):
    """A signal over a window, in its unit."""

    mean: float
    size: float  # mean of the absolute values
    spread: float  # standard deviation
    change: float  # root mean square of the change within a period


class SpoolErrors(NamedTuple):
    """Deviations of the spool from the commanded position."""

    over_position: float  # slope of the error over the commanded position
    against_direction: float  # mean error in the direction in which the command moves
    at_rest: float  # mean size of the error while the command is constant


class Load(NamedTuple):
    """The oil's force over position and speed, as a fraction of the supply's force."""

    spring: float
    offset: float
    friction: float
    misfit: float


@inline
def logarithm(value, floor):
    """log10 of a size above a floor."""
    return math.log10(abs(value) + floor)


@inline
def summary(values):
    """:class:`Summary` of a signal, (T,)."""
    samples = values.shape[0]
    total, size, squares, changes = 0.0, 0.0, 0.0, 0.0
    for k in range(samples):
        total += values[k]
        size += abs(values[k])
    mean = total / samples
    for k in range(samples):
        squares += (values[k] - mean) ** 2
    for k in range(samples - 1):
        changes += (values[k + 1] - values[k]) ** 2
    return Summary(mean, size / samples, math.sqrt(squares / samples), math.sqrt(changes / (samples - 1)))


@inline
def mean_distance(first, second):
    """Mean size of the difference of two signals, (T,)."""
    total = 0.0
    for k in range(first.shape[0]):
        total += abs(first[k] - second[k])
    return total / first.shape[0]


@inline
def share_of_full(command):
    """Share of the samples with a full command."""
    count = 0.0
    for k in range(command.shape[0]):
        count += 1.0 if abs(command[k]) > FULL_COMMAND else 0.0
    return count / command.shape[0]


@inline
def spool_errors(spool, error, command):
    """:class:`SpoolErrors`; ``error``: spool reading minus the response of the valve to the command."""
    samples = spool.shape[0]
    told_mean, covariance, variance, turning, resting, rests = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    for k in range(samples):
        told_mean += (spool[k] - error[k]) / samples
    for k in range(samples):
        told = spool[k] - error[k] - told_mean
        covariance += error[k] * told / samples
        variance += told * told / samples
        change = command[k] - command[max(k - 1, 0)]
        turning += error[k] * (1.0 if change > 0.0 else (-1.0 if change < 0.0 else 0.0)) / samples
        if abs(change) < STILL_COMMAND:
            resting += abs(error[k])
            rests += 1.0
    return SpoolErrors(covariance / (variance + 1e-6), turning, resting / rests)


@inline
def leak_changes(leak, deviation, change):
    """Write the distance of each part's leak from their mean to ``change``; returns the mean square.

    The unit is the part's own standard deviation.
    """
    parts = leak.shape[0]
    total, weights, squares = 0.0, 0.0, 0.0
    for part in range(parts):
        weight = 1.0 / (deviation[part] * deviation[part])
        total += weight * leak[part]
        weights += weight
    for part in range(parts):
        change[part] = (leak[part] - total / weights) / deviation[part]
        squares += change[part] * change[part]
    return squares / parts


@inline
def _moving(x, k, period, stroke, row):
    """Regressors of the force at sample ``k``: constant, position, speed, and its direction."""
    samples = x.shape[0]
    inside = k >= 2 and k < samples - 2
    speed = (x[min(k + 2, samples - 1)] - x[max(k - 2, 0)]) / (4.0 * period) if inside else 0.0
    row[0], row[1] = 1.0, x[k] / (0.5 * stroke)
    row[2], row[3] = speed / stroke, math.tanh(speed / (5e-3 * stroke))


@inline
def load(x, p_a, p_b, c, pressure, period, normal, right, row):
    """:class:`Load`, by least squares; ``normal`` (4, 4), ``right`` and ``row`` (4,) are work space."""
    samples, stroke, scale = x.shape[0], 2.0 * c.end_stop_position, pressure * c.area_a
    normal[:] = 0.0
    right[:] = 0.0
    for k in range(samples):
        _moving(x, k, period, stroke, row)
        force = (p_a[k] * c.area_a - p_b[k] * c.area_b) / scale
        for i in range(4):
            right[i] += row[i] * force
            for j in range(i + 1):
                normal[i, j] += row[i] * row[j]
    for i in range(4):
        normal[i, i] += RIDGE * samples
    factor(normal)
    substitute(normal, right)
    mean, squares = 0.0, 0.0
    for k in range(samples):
        _moving(x, k, period, stroke, row)
        left = (p_a[k] * c.area_a - p_b[k] * c.area_b) / scale
        for i in range(4):
            left -= right[i] * row[i]
        mean += left / samples
        squares += left * left / samples
    return Load(right[1], right[0], 10.0 * right[3], math.sqrt(max(squares - mean * mean, 0.0)))
