"""The flow balance of both chambers, fitted to a window of measured signals by least squares, without simulation.

Integrated from the start of the window, the balances (12), (13) give the travel of the piston:

    A_a x = ∫ (Q_a − G_i (p_a − p_b)) dt − C_a,     A_b x = ∫ (Q_b − G_i (p_a − p_b) + G_e p_b) dt + C_b

C is the volume by which the oil of a chamber was compressed. Q_a and Q_b are the flows (2), (3) through the valve at
the measured spool position and pressures. Each unknown (:class:`~hydro_agents.detection.sheet.Unknowns`) has a prior
from the data sheet (maximum a posteriori): without information in the window, it keeps the value of the prior.

Two residuals are fitted. The first is the balance of chamber a, in metres of piston travel; it contains the white noise
of the position sensor. The second is the difference between the travels of the two balances: the position cancels, and
the white noise of the pressures remains. Errors of the flows add up over time, as a random walk. A scalar Kalman filter
whitens both residuals and their derivatives, which turns the Gauss–Newton fit into generalised least squares (Kailath,
Sayed & Hassibi 2000, *Linear Estimation*, chapter 9).

The noise of the pressures is also in the derivative with respect to the compressibility. Plain least squares would
estimate the oil as too stiff, above all at standstill. The fit therefore subtracts the known variance of that noise
(corrected least squares: Fuller 1987, *Measurement Error Models*, section 2.2).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.detection.balance_parts import best_valve, factor, hold, spool_between, substitute, whiten
from hydro_agents.detection.sheet import POINTS, SOURCES, Sheet, Unknowns
from hydro_env.compiling import compiled, inline, tuple_reader, tuple_replacer
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parts.chambers import chamber_volumes
from hydro_env.plant.parts.supply import supply_rates
from hydro_env.plant.parts.valve import smooth_root
from hydro_env.plant.states import ATMOSPHERIC_PRESSURE
from hydro_env.types import Floats

ITERATIONS = 12  # largest number of evaluations of the balance
FIRST_DAMPING = 1e-3  # fraction of the normal matrix's diagonal that is added to it (Levenberg–Marquardt)
ENOUGH = 0.1  # decrease of the cost (χ²) below which the fit ends
LARGEST_MOVE = 1.5  # largest change of an unknown in one iteration, in standard deviations of its prior

SMALLEST_GAIN, SMALLEST_UNDERLAP, SMALLEST_COMPRESSIBILITY, LARGEST_OVERLAP = 0.2, 1e-3, 0.3, 0.5

CAVITATING = 1e-3  # m per period; error of the travel while a pressure may be at the end of its sensor's range

PARTS, TRACED = 8, 4
"""Number of equal parts of a window, and of the unknowns that are also estimated for each part alone: the leak, the
supply pressure, and the biases of the pressure transducers."""

COUNT = len(Unknowns._fields)
GAIN, SUPPLY, EXCESS, UNDERLAP, NULL, INTERNAL, EXTERNAL, OIL, AIR, DEAD, BIAS_A, BIAS_B, TANK, OVERLAP = range(COUNT)

_read_unknowns = tuple_reader(Unknowns)
_read_coefficients = tuple_reader(Coefficients)
_set_to = tuple_replacer(Coefficients, "relief_pressure")


class _Supplied(NamedTuple):
    """The part of the state that the law of the supply reads."""

    supply_pressure: float
    gas_volume: float


@inline
def _absolute(pressure):
    return max(pressure + ATMOSPHERIC_PRESSURE, 0.2 * ATMOSPHERIC_PRESSURE)


@inline
def _traced(one):
    """Place among the unknowns of one of those that are also estimated for each part alone."""
    return INTERNAL if one == 0 else SUPPLY if one == 1 else BIAS_A if one == 2 else BIAS_B


@inline
def _root_slope(pressure_drop, transition_squared):
    """Derivative of :func:`smooth_root`, 1/√Pa."""
    squared = pressure_drop * pressure_drop
    total = squared + transition_squared
    return (0.5 * squared + transition_squared) / (total * math.sqrt(math.sqrt(total)))


class _Edge(NamedTuple):
    """The opening of an edge, and its derivatives."""

    opening: Any
    shift: Any  # with respect to the spool position
    rounding: Any  # with respect to the underlap
    overlap: Any


@inline
def _edge(stroke, u, c):
    """:class:`_Edge` whose land has moved by ``stroke`` from the null; see :mod:`hydro_env.plant.parts.valve`."""
    factor = 1.0 / (1.0 - u.overlap)
    beyond = (stroke - u.overlap) * factor
    width = math.sqrt(beyond * beyond + u.underlap * u.underlap)
    bend = c.slope_change if beyond > c.knee_position else 0.0
    slope = c.slope * 0.5 * (beyond / width + 1.0) + bend
    opening = c.slope * 0.5 * (width + beyond) + bend * (beyond - c.knee_position)
    return _Edge(opening, factor * slope, c.slope * 0.5 * u.underlap / width, factor * slope * (beyond - 1.0))


@inline
def _without_lag(sensed, sheet, pressure):
    """Pressure before a transducer's first-order lag; the inverse of :func:`hydro_env.task.signals.lagged`."""
    decay = sheet.pressure_decay
    follow = sheet.pressure_lag * (1.0 - decay) - decay
    pressure[0] = sensed[0]
    for k in range(sensed.shape[0] - 1):
        pressure[k + 1] = (sensed[k + 1] - decay * sensed[k] - follow * pressure[k]) / (1.0 - decay - follow)


@inline
def _add_flows(course, a, b, spool, supply, excess_share, sheet, u, c):
    """Add the effect of the flows from one point of a period to the next to both travels and their derivatives.

    Returns:
        The flow in m³/s that the valve draws from the supply.
    """
    travel, slope = course.travel, course.slope
    duration, leak_unit = sheet.period / POINTS, sheet.leak_unit
    gain = c.edge_gain * u.flow_gain
    internal, external = leak_unit * u.internal_leak, leak_unit * u.external_leak
    opening = spool - u.null
    forward, backward = _edge(opening, u, c), _edge(-opening, u, c)
    t2 = c.transition_squared
    in_a, out_a = smooth_root(supply - a, t2), smooth_root(a - u.tank_pressure, t2)
    in_b, out_b = smooth_root(supply - b, t2), smooth_root(b - u.tank_pressure, t2)
    unit_a = forward.opening * in_a - backward.opening * out_a
    unit_b = forward.opening * out_b - backward.opening * in_b
    share_a, share_b = duration / c.area_a, duration / c.area_b
    travel[0] += share_a * (gain * unit_a - internal * (a - b))
    travel[1] += share_b * (c.edge_ratio * gain * unit_b - internal * (a - b) + external * b)
    slope[0, GAIN] += share_a * c.edge_gain * unit_a
    slope[1, GAIN] += share_b * c.edge_ratio * c.edge_gain * unit_b
    gain_a, gain_b = share_a * gain, share_b * c.edge_ratio * gain
    supply_a = gain_a * forward.opening * _root_slope(supply - a, t2)
    supply_b = -gain_b * backward.opening * _root_slope(supply - b, t2)
    tank_a = gain_a * backward.opening * _root_slope(a - u.tank_pressure, t2)
    tank_b = -gain_b * forward.opening * _root_slope(b - u.tank_pressure, t2)
    slope[0, SUPPLY] += supply_a
    slope[1, SUPPLY] += supply_b
    slope[0, EXCESS] += supply_a * excess_share
    slope[1, EXCESS] += supply_b * excess_share
    slope[0, UNDERLAP] += gain_a * (forward.rounding * in_a - backward.rounding * out_a)
    slope[1, UNDERLAP] += gain_b * (forward.rounding * out_b - backward.rounding * in_b)
    slope[0, OVERLAP] += gain_a * (forward.overlap * in_a - backward.overlap * out_a)
    slope[1, OVERLAP] += gain_b * (forward.overlap * out_b - backward.overlap * in_b)
    slope[0, NULL] -= gain_a * (forward.shift * in_a + backward.shift * out_a)
    slope[1, NULL] -= gain_b * (forward.shift * out_b + backward.shift * in_b)
    slope[0, INTERNAL] -= share_a * leak_unit * (a - b)
    slope[1, INTERNAL] -= share_b * leak_unit * (a - b)
    slope[1, EXTERNAL] += share_b * leak_unit * b
    slope[0, BIAS_A] += supply_a + tank_a + share_a * internal  # the pressure is the reading less the bias
    slope[1, BIAS_A] += share_b * internal
    slope[0, BIAS_B] -= share_a * internal
    slope[1, BIAS_B] += supply_b + tank_b - share_b * (internal + external)
    slope[0, TANK] += tank_a
    slope[1, TANK] += tank_b
    return gain * (forward.opening * in_a + c.edge_ratio * backward.opening * in_b)


@inline
def _add_compression(course, chamber, first, last, length, u, c):
    """Add the effect of compressing a chamber between two pressures, Pa; ``length`` is its volume over its area."""
    slope, sign, area = course.slope, -1.0, c.area_a
    if chamber == 1:
        sign, area = 1.0, c.area_b
    begin, end = _absolute(first), _absolute(last)
    oil = (end - begin) / c.bulk_modulus
    air = ATMOSPHERIC_PRESSURE * (1.0 / begin - 1.0 / end)
    squeezed = u.compressibility * oil + u.air_fraction * air
    course.travel[chamber] += sign * length * squeezed
    slope[chamber, OIL] += sign * length * oil
    slope[chamber, AIR] += sign * length * air
    slope[chamber, DEAD] += sign * squeezed / area


class _Signals(NamedTuple):
    """What the fit reads of a window."""

    position: Any  # (T,), m
    pressure_a: Any  # (T,), Pa, without the lag of the transducers
    pressure_b: Any
    reading: Any  # (T,), of the spool position
    spool: Any  # (T, POINTS), between the samples


class _Course(NamedTuple):
    """Both residuals along a window, and the filter that whitens them."""

    travel: Any  # (2,), of the piston since the window began, by the balance of each chamber, m
    slope: Any  # (2, COUNT), derivatives of the travels
    filtered: Any  # (2, COUNT + 1), what the filter expects of derivatives and residual
    variance: Any  # (2,), of the filter
    whitened: Any  # (COUNT + 1,), derivatives and residual of the present sample
    before: Any  # (2,), the whitened residuals of the last sample


class _Sums(NamedTuple):
    """Sums over the samples of a window, for each of the two residuals."""

    normals: Any  # (2, COUNT, COUNT), products of the derivatives; lower halves
    rights: Any  # (2, COUNT), products of derivatives and residual
    mean_square: Any  # (2,)
    product: Any  # (2,), mean product of successive residuals
    pull: Any  # (2, TRACED, PARTS), as ``rights``, of each part alone
    weight: Any  # (2, TRACED, PARTS), as ``normals``


class BalanceFit(NamedTuple):
    """The fit of N windows of T samples."""

    estimate: Floats  # (N, COUNT), of the unknowns
    deviation: Floats  # (N, COUNT), their standard deviations
    misfit: Floats  # (N, 2), mean squares of the whitened residuals; about 1 where the model holds
    correlation: Floats  # (N, 2), of successive whitened residuals; about 0 where the model holds
    spool_error: Floats  # (N, T), spool reading minus the response of the best-fitting candidate valve
    part: Floats  # (N, TRACED, PARTS), unknowns of each part alone, the other estimates unchanged
    part_deviation: Floats  # (N, TRACED, PARTS)


@inline
def _begin(sheet, c, course, sums):
    course.travel[:] = 0.0
    course.slope[:] = 0.0
    course.filtered[:] = 0.0
    course.before[:] = 0.0
    course.variance[0] = sheet.position_noise**2
    course.variance[1] = (sheet.mean[OIL] * sheet.pressure_noise_b / c.bulk_modulus * c.volume_b0 / c.area_b) ** 2
    sums.normals[:] = 0.0
    sums.rights[:] = 0.0
    sums.mean_square[:] = 0.0
    sums.product[:] = 0.0
    sums.pull[:] = 0.0
    sums.weight[:] = 0.0


@inline
def _add_sample(moved, noise, sensed, k, periods, u, sheet, course, sums):
    """Whiten both residuals and their derivatives at sample ``k`` + 1, and add them to the sums.

    ``moved`` is the measured travel, ``noise`` the variance that the random walk of the flows' errors gains in the
    period, ``sensed`` the compressed length that the noise of the pressures feigns.
    """
    whitened, spread, now = course.whitened, sheet.spread, PARTS * k // periods
    for residual in range(2):
        other = residual == 1
        base = sheet.mean[OIL] * sensed if other else sheet.position_noise
        value = course.travel[1] - course.travel[0] if other else moved - course.travel[0]
        course.variance[residual] += noise
        total = course.variance[residual] + base * base
        blend, unit = course.variance[residual] / total, 1.0 / math.sqrt(total)
        course.variance[residual] *= 1.0 - blend
        square = whiten(value, course.slope, other, course.filtered[residual], whitened, spread, blend, unit)
        sums.mean_square[residual] += square / periods
        sums.product[residual] += course.before[residual] * whitened[COUNT] / periods
        course.before[residual] = whitened[COUNT]
        if other:  # subtract the noise of the pressures; less in the matrix, which must stay definite
            known = (unit * sensed) ** 2
            sums.mean_square[1] += known * (sheet.mean[OIL] ** 2 - u.compressibility**2) / periods
            sums.rights[1, OIL] += known * u.compressibility * spread[OIL]
            sums.normals[1, OIL, OIL] -= 0.8 * known * spread[OIL] ** 2
        for i in range(COUNT):
            for j in range(i + 1):
                sums.normals[residual, i, j] += whitened[i] * whitened[j]
            sums.rights[residual, i] -= whitened[i] * whitened[COUNT]
        for one in range(TRACED):
            slope = whitened[_traced(one)]
            sums.pull[residual, one, now] -= slope * whitened[COUNT]
            sums.weight[residual, one, now] += slope * slope


@inline
def _follow(signals, sheet, c, theta, course, sums):
    """Write the sums of a window for the unknowns ``theta``."""
    x, p_a, p_b = signals.position, signals.pressure_a, signals.pressure_b
    u = _read_unknowns(theta)
    _begin(sheet, c, course, sums)
    periods = x.shape[0] - 1
    supply, gas, excess_share = u.supply_pressure + u.supply_excess, sheet.gas_volume, 1.0
    for k in range(periods):
        drawn = 0.0
        for point in range(POINTS):
            share = (point + 0.5) / POINTS
            a = p_a[k] + share * (p_a[k + 1] - p_a[k]) - u.bias_a
            b = p_b[k] + share * (p_b[k + 1] - p_b[k]) - u.bias_b
            drawn += _add_flows(course, a, b, signals.spool[k, point], supply, excess_share, sheet, u, c) / POINTS
        volume_a, volume_b = chamber_volumes(0.5 * (x[k] + x[k + 1]), c)
        length_a, length_b = (volume_a + u.dead_volume) / c.area_a, (volume_b + u.dead_volume) / c.area_b
        _add_compression(course, 0, p_a[k] - u.bias_a, p_a[k + 1] - u.bias_a, length_a, u, c)
        _add_compression(course, 1, p_b[k] - u.bias_b, p_b[k + 1] - u.bias_b, length_b, u, c)

        rate, gas_rate = supply_rates(_Supplied(supply, gas), drawn, _set_to(c, u.supply_pressure))
        stiffness = c.supply_dynamics * (supply + ATMOSPHERIC_PRESSURE) / gas
        excess_share *= math.exp(-sheet.period * stiffness * c.relief_slope)
        supply += sheet.period * rate
        gas = max(gas + sheet.period * gas_rate, 0.1 * sheet.gas_volume)

        sensed = math.hypot(length_a * sheet.pressure_noise_a, length_b * sheet.pressure_noise_b) / c.bulk_modulus
        turned = signals.reading[k + 1] - signals.reading[k]
        noise = sheet.flow_noise**2 + (sheet.flow_error * turned) ** 2
        if min(p_a[k], p_a[k + 1]) < sheet.lowest_a or min(p_b[k], p_b[k + 1]) < sheet.lowest_b:
            noise += CAVITATING**2
        _add_sample(x[k + 1] - x[0], noise, sensed, k, periods, u, sheet, course, sums)


@inline
def _weigh(sums, sheet, theta, periods, normal, right):
    """Write the normal equations; returns the cost (χ²).

    Misfit of the model counts as noise: a residual above 1 contributes its logarithm.
    """
    cost = 0.0
    normal[:] = 0.0
    for i in range(COUNT):
        off = (sheet.mean[i] - theta[i]) / sheet.spread[i]
        normal[i, i], right[i] = 1.0, off
        cost += off * off
    for residual in range(2):
        above = max(sums.mean_square[residual], 1.0)
        for one in range(TRACED):
            for now in range(PARTS):
                sums.pull[residual, one, now] /= above
                sums.weight[residual, one, now] /= above
        cost += periods * (min(sums.mean_square[residual], 1.0) + math.log(above))
        for i in range(COUNT):
            right[i] += sums.rights[residual, i] / above
            for j in range(i + 1):
                normal[i, j] += sums.normals[residual, i, j] / above
    return cost


@inline
def _keep(window, theta, sums, spread, balance):
    """Write the estimates of a window, and of its parts alone."""
    balance.estimate[window] = theta
    balance.misfit[window] = sums.mean_square
    for residual in range(2):
        balance.correlation[window, residual] = sums.product[residual] / (sums.mean_square[residual] + 1e-9)
    for now in range(PARTS):
        for one in range(TRACED):
            at = _traced(one)
            told = 1.0 + sums.weight[0, one, now] + sums.weight[1, one, now]
            pull = sums.pull[0, one, now] + sums.pull[1, one, now]
            balance.part[window, one, now] = theta[at] + spread[at] * pull / told
            balance.part_deviation[window, one, now] = spread[at] / math.sqrt(told)


@inline
def _move(best, best_normal, best_right, damping, spread, normal, right, theta):
    """Write the next unknowns to ``theta``: a damped step from the best ones. A leak cannot be negative."""
    none = -best[INTERNAL] / spread[INTERNAL]
    for held in range(2):
        normal[:] = best_normal
        right[:] = best_right
        for i in range(COUNT):
            normal[i, i] *= 1.0 + damping
        if held == 1:
            hold(normal, right, INTERNAL, max(none, -LARGEST_MOVE))
        factor(normal)
        substitute(normal, right)
        if right[INTERNAL] >= none:
            break
    for i in range(COUNT):
        theta[i] = best[i] + min(max(right[i], -LARGEST_MOVE), LARGEST_MOVE) * spread[i]
    theta[GAIN] = max(theta[GAIN], SMALLEST_GAIN)
    theta[UNDERLAP] = max(theta[UNDERLAP], SMALLEST_UNDERLAP)
    theta[OIL] = max(theta[OIL], SMALLEST_COMPRESSIBILITY)
    theta[OVERLAP] = min(theta[OVERLAP], LARGEST_OVERLAP)


@inline
def _tell_deviations(normal, right, spread, deviation):
    """Write the standard deviations, at most the priors', from the diagonal of the inverse of ``normal``."""
    factor(normal)
    for i in range(COUNT):
        right[:] = 0.0
        right[i] = 1.0
        substitute(normal, right)
        deviation[i] = min(math.sqrt(right[i]), 1.0) * spread[i]


def _build(sources: int) -> Any:
    def fit(signals, sheet, balance):
        assert sources >= 0  # keys numba's cache
        c = _read_coefficients(sheet.coefficients)
        samples = signals.shape[2]
        spool, p_a, p_b = np.empty((samples, POINTS)), np.empty(samples), np.empty(samples)
        smooth, valve = np.empty(samples), np.empty(3)
        theta, normal, right = np.empty(COUNT), np.empty((COUNT, COUNT)), np.empty(COUNT)
        best_normal, best_right = np.empty((COUNT, COUNT)), np.empty(COUNT)
        damping, least = np.empty(1), np.empty(1)  # arrays, because the export spreads the fit over calls
        travel, slope, filtered = np.empty(2), np.empty((2, COUNT)), np.empty((2, COUNT + 1))
        variance, whitened, before = np.empty(2), np.empty(COUNT + 1), np.empty(2)
        course = _Course(travel, slope, filtered, variance, whitened, before)
        normals, rights, mean_square = np.empty((2, COUNT, COUNT)), np.empty((2, COUNT)), np.empty(2)
        product, pull, weight = np.empty(2), np.empty((2, TRACED, PARTS)), np.empty((2, TRACED, PARTS))
        sums = _Sums(normals, rights, mean_square, product, pull, weight)
        for window in range(signals.shape[0]):
            x, sensed_a, sensed_b, reading, command = signals[window]
            _without_lag(sensed_a, sheet, p_a)
            _without_lag(sensed_b, sheet, p_b)
            answer = sheet.transition[best_valve(reading, command, sheet.transition, sheet.spool_noise, valve)]
            error = balance.spool_error[window]
            spool_between(reading, command, answer, sheet.spool_noise, valve, spool, error, smooth)
            window_signals = _Signals(x, p_a, p_b, reading, spool)
            theta[:] = sheet.mean
            damping[0], least[0] = FIRST_DAMPING, math.inf
            for _ in range(ITERATIONS):
                _follow(window_signals, sheet, c, theta, course, sums)
                cost = _weigh(sums, sheet, theta, samples - 1, normal, right)
                if cost < least[0]:
                    gained, least[0] = least[0] - cost, cost
                    damping[0] *= 0.2
                    best_normal[:] = normal
                    best_right[:] = right
                    _keep(window, theta, sums, sheet.spread, balance)
                    if gained < ENOUGH:
                        break
                else:
                    damping[0] *= 10.0
                best = balance.estimate[window]
                _move(best, best_normal, best_right, damping[0], sheet.spread, normal, right, theta)
            _tell_deviations(best_normal, right, sheet.spread, balance.deviation[window])

    return compiled(fit)


fit = _build(SOURCES)


def fit_balance(signals: Floats, sheet: Sheet) -> BalanceFit:
    """Fit the flow balance of windows of SIGNALS, (N, 5, T), in SI units and without NaN."""
    count, _, samples = signals.shape
    shapes = ((COUNT,), (COUNT,), (2,), (2,), (samples,), (TRACED, PARTS), (TRACED, PARTS))
    balance = BalanceFit(*(np.empty((count, *shape)) for shape in shapes))
    fit(np.ascontiguousarray(signals), sheet, balance)
    return balance
