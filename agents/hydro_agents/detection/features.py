"""The features of a window of measured signals for the leakage head: the flow balance, and statistics of the motion."""

import math
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.detection.balance import EXTERNAL, INTERNAL, OVERLAP, PARTS, SUPPLY, TRACED, fit_balance
from hydro_agents.detection.balance_parts import factor, substitute
from hydro_agents.detection.damaged_signals import repaired
from hydro_agents.detection.sheet import SOURCES, Sheet, Unknowns
from hydro_env.compiling import compiled, inline, named_tuple, tuple_reader, tuple_writer
from hydro_env.plant.equations import Coefficients
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Array, Singles

LABELS = ("internal_leak", "external_leak", "valve_fault", "sensor_fault", "return_line")
"""Labels of the head. An axis may have several at once; therefore each has its own probability."""

TOLD = OVERLAP  # number of unknowns that are features; the overlap, the last, only frees the others from its effect
LAST_PARTS = 3  # number of last parts of the window whose own leak is a feature, for the size of a growing leak


Motion = named_tuple(
    "Motion",
    """
    small_internal_leak small_external_leak internal_leak_over_deviation external_leak_over_deviation
    mean_spool_error spread_of_spool_error spool_error_over_position spool_error_against_direction
    spool_error_at_rest mean_pressure_a mean_pressure_b mean_pressure_difference
    mean_size_of_pressure_difference spread_of_pressure_a spread_of_pressure_b change_of_pressure_a
    change_of_pressure_b mean_spool mean_size_of_spool spread_of_spool change_of_spool change_of_command
    share_of_full_command mean_position spread_of_position change_of_position spring force_offset friction
    misfit_of_force
    """,
    __name__,
)
"""The features of the motion, each a plain number."""


FEATURES = (
    *(f"fitted {name}" for name in Unknowns._fields[:TOLD]),
    *(f"deviation of {name}" for name in Unknowns._fields[:TOLD]),
    "misfit of travel",
    "misfit of flows",
    *(name.replace("_", " ") for name in Motion._fields),
    *(f"lost samples of {name}" for name in SENSORS),
    *(
        text
        for name in ("leak", "supply", "bias a", "bias b")
        for text in (*(f"change of {name} in part {number + 1}" for number in range(PARTS)), f"change of {name}")
    ),
    *(f"leak in part {number + 1}" for number in range(PARTS - LAST_PARTS, PARTS)),
    "deviation of leak in last part",
    "correlation of travel",
    "correlation of flows",
    "duration",
    "invalid features",
)
"""Names of the features."""

SPREAD = FEATURES.index("spread of position")
STILL = np.log10(3e-4)  # the axis stands still if this feature is below this value

CHANGE = FEATURES.index("change of leak")  # separates windows with a constant leak from others


STILL_COMMAND = 2e-3  # change of the command within a period below which the spool should be at the commanded position

FULL_COMMAND = 0.999

RIDGE = 1e-3  # added to the diagonal of the normal equations of the load, per sample (ridge regression)


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


class _Regression(NamedTuple):
    """Work space of :func:`load_force`."""

    normal: Any  # (4, 4)
    right: Any  # (4,)
    row: Any  # (4,)


class LoadForce(NamedTuple):
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
        if abs(command[k]) > FULL_COMMAND:
            count += 1.0
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
        direction = 0.0
        if change > 0.0:
            direction = 1.0
        elif change < 0.0:
            direction = -1.0
        turning += error[k] * direction / samples
        if abs(change) < STILL_COMMAND:
            resting += abs(error[k])
            rests += 1.0
    return SpoolErrors(covariance / (variance + 1e-6), turning, resting / rests)


@inline
def changes(value, deviation, change):
    """Write the distance of each part's value from their mean to ``change``; returns the mean square.

    The unit is the part's own standard deviation.
    """
    parts = value.shape[0]
    total, weights, squares = 0.0, 0.0, 0.0
    for part in range(parts):
        weight = 1.0 / (deviation[part] * deviation[part])
        total += weight * value[part]
        weights += weight
    for part in range(parts):
        change[part] = (value[part] - total / weights) / deviation[part]
        squares += change[part] * change[part]
    return squares / parts


@inline
def _moving(x, k, period, stroke, row):
    """Regressors of the force at sample ``k``: constant, position, speed, and its direction."""
    samples = x.shape[0]
    speed = 0.0
    if k >= 2 and k < samples - 2:
        speed = (x[k + 2] - x[k - 2]) / (4.0 * period)
    row[0], row[1] = 1.0, x[k] / (0.5 * stroke)
    row[2], row[3] = speed / stroke, math.tanh(speed / (5e-3 * stroke))


@inline
def load_force(x, p_a, p_b, c, pressure, period, work):
    """:class:`LoadForce`, by least squares."""
    normal, right, row = work.normal, work.right, work.row
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
    return LoadForce(right[1], right[0], 10.0 * right[3], math.sqrt(max(squares - mean * mean, 0.0)))


_AFTER_FIT = 2 * TOLD + 2
AFTER_MOTION = _AFTER_FIT + len(Motion._fields)  # number of the first feature after those of :class:`Motion`
_write_motion = tuple_writer(Motion, first=_AFTER_FIT)
_read_coefficients = tuple_reader(Coefficients)


@inline
def _write_fit(values, window, sheet, balance):
    for i in range(TOLD):
        values[i] = math.asinh(10.0 * (balance.estimate[window, i] - sheet.mean[i]) / sheet.spread[i])
        values[TOLD + i] = math.log10(balance.deviation[window, i] / sheet.spread[i] + 1e-6)
    for i in range(2):
        values[2 * TOLD + i] = logarithm(balance.misfit[window, i], 1e-2)


@inline
def _motion_of(signals, error, estimate, deviation, c, supply, period, work):
    """:class:`Motion` of a window: signals (5, T), spool error (T,), estimates and deviations of the unknowns."""
    position, p_a, p_b, spool, command = signals
    stroke = 2.0 * c.end_stop_position
    internal, external = estimate[INTERNAL], estimate[EXTERNAL]
    x, a, b = summary(position), summary(p_a), summary(p_b)
    s, u, e = summary(spool), summary(command), summary(error)
    errors = spool_errors(spool, error, command)
    force = load_force(position, p_a, p_b, c, supply, period, work)
    return Motion(
        small_internal_leak=math.asinh(internal / 0.02),
        small_external_leak=math.asinh(external / 0.02),
        internal_leak_over_deviation=math.asinh(internal / deviation[INTERNAL]),
        external_leak_over_deviation=math.asinh(external / deviation[EXTERNAL]),
        mean_spool_error=math.asinh(e.mean / 2e-3),
        spread_of_spool_error=logarithm(e.spread, 1e-4),
        spool_error_over_position=math.asinh(20.0 * errors.over_position),
        spool_error_against_direction=math.asinh(errors.against_direction / 1e-3),
        spool_error_at_rest=logarithm(errors.at_rest, 1e-4),
        mean_pressure_a=a.mean / supply,
        mean_pressure_b=b.mean / supply,
        mean_pressure_difference=(a.mean - b.mean) / supply,
        mean_size_of_pressure_difference=mean_distance(p_a, p_b) / supply,
        spread_of_pressure_a=logarithm(a.spread / supply, 1e-4),
        spread_of_pressure_b=logarithm(b.spread / supply, 1e-4),
        change_of_pressure_a=logarithm(a.change / supply, 1e-5),
        change_of_pressure_b=logarithm(b.change / supply, 1e-5),
        mean_spool=math.asinh(20.0 * s.mean),
        mean_size_of_spool=logarithm(s.size, 1e-4),
        spread_of_spool=logarithm(s.spread, 1e-4),
        change_of_spool=logarithm(s.change, 1e-5),
        change_of_command=logarithm(u.change, 1e-5),
        share_of_full_command=share_of_full(command),
        mean_position=x.mean / stroke,
        spread_of_position=logarithm(x.spread / stroke, 1e-5),
        change_of_position=logarithm(x.change / stroke, 1e-6),
        spring=force.spring,
        force_offset=force.offset,
        friction=force.friction,
        misfit_of_force=logarithm(force.misfit, 1e-4),
    )


@inline
def _write_parts(values, first, part, deviation, change):
    """Write the features of the unknowns of each part alone, (TRACED, PARTS), from place ``first`` on."""
    place = first
    for one in range(TRACED):
        mean_square = changes(part[one], deviation[one], change)
        for now in range(PARTS):
            values[place + now] = math.asinh(change[now])
        values[place + PARTS] = logarithm(mean_square, 1e-2)
        place += PARTS + 1
    for now in range(LAST_PARTS):
        values[place + now] = math.asinh(part[0, PARTS - LAST_PARTS + now] / 0.1)
    values[place + LAST_PARTS] = logarithm(deviation[0, PARTS - 1], 1e-4)


@inline
def _count_invalid(values):
    """Replace features that are not finite by 0; the last one is their number."""
    last = values.shape[0] - 1
    invalid = 0.0
    for i in range(last):
        if not math.isfinite(values[i]):
            values[i] = 0.0
            invalid += 1.0
    values[last] = invalid


def _build_describe(sources: int) -> Any:
    def describe(signals, lost, sheet, balance, features):
        assert sources >= 0
        c = _read_coefficients(sheet.coefficients)
        supply, samples, sensors = sheet.mean[SUPPLY], signals.shape[2], lost.shape[1]
        normal, right, row, change = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(PARTS)
        work = _Regression(normal, right, row)
        for window in range(signals.shape[0]):
            values, error = features[window], balance.spool_error[window]
            estimate, deviation = balance.estimate[window], balance.deviation[window]
            _write_fit(values, window, sheet, balance)
            motion = _motion_of(signals[window], error, estimate, deviation, c, supply, sheet.period, work)
            _write_motion(values, motion)
            for sensor in range(sensors):
                values[AFTER_MOTION + sensor] = math.log10(lost[window, sensor] + 1e-3)
            parts, first = AFTER_MOTION + sensors, values.shape[0] - 4
            _write_parts(values, parts, balance.part[window], balance.part_deviation[window], change)
            values[first] = math.asinh(3.0 * balance.correlation[window, 0])
            values[first + 1] = math.asinh(3.0 * balance.correlation[window, 1])
            values[first + 2] = math.log10(samples * sheet.period)
            _count_invalid(values)

    return compiled(describe)


describe = _build_describe(SOURCES)


def features_of(signals: Array, sheet: Sheet) -> Singles:
    """:data:`FEATURES` (N, F) of windows of signals (N, 5, T) in SI units; NaN: a lost sample, or no such sensor."""
    whole = repaired(signals, sheet)
    features = np.empty((len(whole.signals), len(FEATURES)))
    describe(*whole, sheet, fit_balance(whole.signals, sheet), features)
    return features.astype(np.float32)
