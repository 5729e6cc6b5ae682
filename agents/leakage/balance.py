"""The flow balance of both chambers, fitted to a window of measured signals by least squares, without simulation.

The balances (12), (13), integrated from the start of the window, say what the piston must have moved:

    A_a x + C_a = ∫ (Q_a − G_i (p_a − p_b)) dt,     A_b x − C_b = ∫ (Q_b − G_i (p_a − p_b) + G_e p_b) dt

C is the volume by which the oil of a chamber was compressed. Q_a and Q_b are the flows (2), (3) through the valve at
the measured spool position and pressures. Their unknowns are twelve (:class:`Unknowns`); each has a prior from the
data sheet, so that a window that says nothing about one of them leaves it there (maximum a posteriori).

Two residuals are fitted. The first is the balance of chamber a, in metres of piston travel; the noise of the position
sensor is white in it. In the second, the sum of both balances, the position cancels. Errors of the flows add up over
time, as a random walk; a scalar Kalman filter whitens both residuals and their derivatives, which makes the fit one of
generalised least squares (Gauss–Newton; Kailath, Sayed & Hassibi 2000, *Linear Estimation*, chapter 9). The noise of
the flows grows with the speed of the spool, which is known between the samples from the nominal valve alone.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.controllers.sampled_loop import FULL_COMMAND, zero_order_hold
from hydro_env import TaskConfig
from hydro_env.compiling import SOURCES, compiled, inline, tuple_reader, tuple_replacer
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parts.chambers import chamber_volumes
from hydro_env.plant.parts.supply import supply_rates
from hydro_env.plant.parts.valve import smooth_root
from hydro_env.plant.states import ATMOSPHERIC_PRESSURE
from hydro_env.task.randomisation import own_value
from hydro_env.task.sensors import CHANNELS
from hydro_env.task.settings import settings_of
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

POINTS = 2
"""Points between two samples at which the flows are evaluated."""

ITERATIONS = 6

NOISE_WITHOUT_LAG = 1.17
"""Factor by which taking out the transducers' lag raises their noise."""

FREQUENCIES, DAMPINGS = 9, 3
"""Numbers of natural frequencies and damping ratios of the valve that are tried."""

AT_ONCE = 1e5
"""1/s; of parts of the valve that the model lets follow at once."""

FLOW_ERROR = 0.015
"""Error of the flow between two samples, in parts of the change that the spool's motion makes."""


CAVITATING = 1e-3


class Unknowns(NamedTuple):
    """What the fit estimates; as a value, as its standard deviation, and as its prior."""

    flow_gain: Any  # of the valve, in parts of the data sheet's
    supply_pressure: Any  # Pa, setting of the relief valve
    supply_excess: Any  # Pa, supply pressure above that setting when the window begins
    underlap: Any  # of full stroke
    null: Any  # of full stroke; null shift of the valve and bias of the spool sensor together
    internal_leak: Any  # l/min at 100 bar
    external_leak: Any  # l/min at 100 bar
    compressibility: Any  # of the oil without air, in parts of the data sheet's
    air_fraction: Any
    dead_volume: Any  # m³, above the data sheet's
    bias_a: Any  # Pa, of the pressure transducer of chamber a
    bias_b: Any  # Pa
    tank_pressure: Any  # Pa


COUNT = len(Unknowns._fields)
COMPRESSIBILITY = Unknowns._fields.index("compressibility")
_read_unknowns = tuple_reader(Unknowns)
_read_coefficients = tuple_reader(Coefficients)


class Sheet(NamedTuple):
    """What the data sheet says of an axis, for the compiled fit."""

    coefficients: NDArray[np.float64]  # of the nominal plant
    mean: NDArray[np.float64]  # (COUNT,), of the priors
    spread: NDArray[np.float64]  # (COUNT,), standard deviations of the priors
    transition: NDArray[np.float64]  # (valves, POINTS + 1, 3, 5), see _valve_steps
    spool_noise: float  # of full stroke
    sensor_low: NDArray[np.float64]  # (4,), lower ends of the ranges of position, pressures and spool position
    sensor_high: NDArray[np.float64]  # (4,)
    lowest_a: float  # Pa; below this a reading may be at the end of its range
    lowest_b: float  # Pa
    pressure_decay: float  # exp(−T/τ) of the pressure transducers
    pressure_lag: float  # τ/T
    gas_volume: float  # m³, of the accumulator at the supply's pressure
    period: float  # s
    position_noise: float  # m
    pressure_noise_a: float  # Pa
    pressure_noise_b: float  # Pa
    flow_noise: float  # m per period, of the travel that the noise of the spool's sensor makes
    flow_error: float  # m per period, of the travel that full spool stroke makes, times FLOW_ERROR


def sheet_of(config: TaskConfig) -> Sheet:
    """The data sheet of a task's axis, with priors that also hold worn axes.

    The width of a prior is that of the task's range of the parameter, and more where faults change it.
    """
    plant, sensors = config.plant, config.sensors
    c = plant_coefficients(plant)
    numbers = settings_of(config)[0]

    def drawn(path: str) -> tuple[float, float]:
        own = own_value(plant, path)
        distribution = config.randomisation.get(path)
        low, high = distribution.bounds(own) if distribution is not None else (own, own)
        return 0.5 * (low + high), 0.5 * (high - low)

    supply, supply_range = drawn("supply.pressure")
    dead, dead_range = drawn("cylinder.dead_volume")
    mean = Unknowns(
        flow_gain=1.0,
        supply_pressure=supply,
        supply_excess=0.6 * c.pump_flow / c.relief_slope if c.supply_dynamics > 0.0 and c.relief_slope > 0.0 else 0.0,
        underlap=drawn("valve.underlap")[0],
        null=plant.valve.null_shift,
        internal_leak=0.0,
        external_leak=0.0,
        compressibility=1.1,
        air_fraction=drawn("fluid.air_fraction")[0],
        dead_volume=dead - plant.cylinder.dead_volume,
        bias_a=0.0,
        bias_b=0.0,
        tank_pressure=plant.supply.tank_pressure,
    )
    spread = Unknowns(
        flow_gain=0.2,
        supply_pressure=0.7 * supply_range + 0.1 * supply,
        supply_excess=0.5 * mean.supply_excess + 1e3,
        underlap=0.02,
        null=0.01,
        internal_leak=2.0,
        external_leak=1.0,
        compressibility=0.2,
        air_fraction=0.003,
        dead_volume=0.6 * dead_range + 1e-7,
        bias_a=sensors.pressure_a.bias + 1e3,
        bias_b=sensors.pressure_b.bias + 1e3,
        tank_pressure=1e5,
    )
    frequency, frequency_range = drawn("valve.natural_frequency")
    damping, damping_range = drawn("valve.damping_ratio")
    transition = [
        _valve_steps(config, frequency + across * frequency_range, damping + along * damping_range)
        for across in (np.linspace(-1.0, 1.0, FREQUENCIES) if frequency_range > 0.0 else [0.0])
        for along in (np.linspace(-1.0, 1.0, DAMPINGS) if damping_range > 0.0 else [0.0])
    ]
    full_flow = c.edge_gain * math.sqrt(0.5 * supply)
    travel = full_flow * config.control_period / min(c.area_a, c.area_b)
    return Sheet(
        coefficients=np.array(c),
        mean=np.array(mean),
        spread=np.array(spread),
        transition=np.array(transition),
        sensor_low=np.array([getattr(sensors, name).low for name in CHANNELS]),
        sensor_high=np.array([getattr(sensors, name).high for name in CHANNELS]),
        lowest_a=sensors.pressure_a.low + sensors.pressure_a.bias + 4.0 * sensors.pressure_a.noise,
        lowest_b=sensors.pressure_b.low + sensors.pressure_b.bias + 4.0 * sensors.pressure_b.noise,
        spool_noise=sensors.spool_position.noise + 1e-9,
        pressure_decay=float(numbers["pressure_decay"]),
        pressure_lag=float(numbers["pressure_lag"]),
        gas_volume=float(gas_volume_of(plant)),
        period=config.control_period,
        position_noise=math.hypot(sensors.position.noise, sensors.position.resolution) + 1e-9,
        pressure_noise_a=NOISE_WITHOUT_LAG * sensors.pressure_a.noise + 1.0,
        pressure_noise_b=NOISE_WITHOUT_LAG * sensors.pressure_b.noise + 1.0,
        flow_noise=0.4 * travel * sensors.spool_position.noise + 1e-12,
        flow_error=travel * FLOW_ERROR,
    )


def gas_volume_of(plant: Any) -> float:
    """Volume in m³ of the accumulator's gas at the setting of the relief valve."""
    supply = plant.supply
    ratio = (supply.precharge_pressure + ATMOSPHERIC_PRESSURE) / (supply.pressure + ATMOSPHERIC_PRESSURE)
    return float(supply.accumulator_volume * ratio ** (1.0 / supply.polytropic_index))


def _valve_steps(config: TaskConfig, frequency: float, damping: float) -> NDArray[np.float64]:
    """Matrices (POINTS + 1, 3, 5) of a valve: its states at the points of a period and at its end.

    They multiply the states at its start, the previous command and the new one. States: spool position, its speed, and
    the current of the coil as the spool position that it commands.
    """
    c = plant_coefficients(config.plant)
    if c.ideal_spool > 0.0:
        frequency, damping = AT_ONCE, 1.0
    coil = AT_ONCE if c.ideal_drive > 0.0 else c.coil_rate
    a = np.array([[0.0, 1.0, 0.0], [-(frequency**2), -2.0 * damping * frequency, frequency**2], [0.0, 0.0, -coil]])
    b = np.array([0.0, 0.0, coil * FULL_COMMAND * c.drive_rate / c.coil_rate * c.spool_gain])
    steps = []
    for share in (*((np.arange(POINTS) + 0.5) / POINTS), 1.0):
        time = share * config.control_period
        first, old = zero_order_hold(a, b, min(time, config.command_latency))
        rest, new = zero_order_hold(a, b, max(time - config.command_latency, 0.0))
        steps.append(np.column_stack([rest @ first, rest @ old, new]))
    return np.array(steps)


@inline
def _root_slope(pressure_drop, transition_squared):
    """Derivative of :func:`smooth_root`, 1/√Pa."""
    squared = pressure_drop * pressure_drop
    total = squared + transition_squared
    return (0.5 * squared + transition_squared) / (total * math.sqrt(math.sqrt(total)))


@inline
def _absolute(pressure):
    return max(pressure + ATMOSPHERIC_PRESSURE, 0.2 * ATMOSPHERIC_PRESSURE)


_set_to = tuple_replacer(Coefficients, "relief_pressure")


class _Supplied(NamedTuple):
    supply_pressure: float
    gas_volume: float


@inline
def _factor(matrix):
    """Cholesky factor of a symmetric positive definite matrix, in place; the lower half counts."""
    n = matrix.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = math.sqrt(max(total, 0.05)) if i == j else total / matrix[j, j]


@inline
def _substitute(factor, right):
    """Solve with a Cholesky factor, in place."""
    n = right.shape[0]
    for i in range(n):
        for k in range(i):
            right[i] -= factor[i, k] * right[k]
        right[i] /= factor[i, i]
    for back in range(n):
        i = n - 1 - back
        for k in range(i + 1, n):
            right[i] -= factor[k, i] * right[k]
        right[i] /= factor[i, i]


@inline
def _advance(valve, row, old, new):
    """Move the states of a valve by a period: (3, 5) matrix, previous command and new one."""
    first = row[0, 0] * valve[0] + row[0, 1] * valve[1] + row[0, 2] * valve[2] + row[0, 3] * old + row[0, 4] * new
    second = row[1, 0] * valve[0] + row[1, 1] * valve[1] + row[1, 2] * valve[2] + row[1, 3] * old + row[1, 4] * new
    third = row[2, 0] * valve[0] + row[2, 1] * valve[1] + row[2, 2] * valve[2] + row[2, 3] * old + row[2, 4] * new
    valve[0], valve[1], valve[2] = first, second, third


@inline
def _best_valve(reading, command, candidates, noise, valve):
    """Index of the valve whose answer to the commands is nearest to the readings, apart from a constant."""
    best, least = 0, 1e300
    for candidate in range(candidates.shape[0]):
        row = candidates[candidate, POINTS]
        valve[0], valve[1], valve[2] = reading[0], 0.0, command[0]
        mean, total = 0.0, 0.0
        for k in range(1, reading.shape[0]):
            _advance(valve, row, command[k - 1], command[k])
            # Far differences, such as at the slew limit, count no more than 20 times the noise.
            off = min(max(reading[k] - valve[0] - mean, -20.0 * noise), 20.0 * noise)
            mean += off / (k + 5.0)
            total += off * off
        if total < least:
            best, least = candidate, total
    return best


@inline
def _spool_between(reading, command, transition, noise, valve, spool, error, smooth):
    """Spool position between samples (T − 1, POINTS), and the readings less the valve's answer at the samples (T,).

    The difference between readings and answer is taken as a random walk under the sensor's noise, and smoothed
    (Rauch, Tung & Striebel 1965, with the gains of the steady state).
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
def _without_lag(sensed, decay, lag, pressure):
    """Pressure before a transducer's first-order lag; the inverse of :func:`hydro_env.task.signals.lagged`."""
    follow = lag * (1.0 - decay) - decay
    pressure[0] = sensed[0]
    for k in range(sensed.shape[0] - 1):
        pressure[k + 1] = (sensed[k + 1] - decay * sensed[k] - follow * pressure[k]) / (1.0 - decay - follow)


def _build(sources: int) -> Any:
    def fit(signals, sheet, estimate, deviation, misfit, valve_choice, spool_error):
        assert sources >= 0  # keys numba's cache
        c = _read_coefficients(sheet.coefficients)
        samples = signals.shape[2]
        spool = np.empty((samples, POINTS))
        p_a, p_b = np.empty(samples), np.empty(samples)
        theta, step = np.empty(COUNT), np.empty(COUNT)
        normal, column = np.empty((COUNT, COUNT)), np.empty(COUNT)
        slope_a, slope_b = np.zeros(COUNT), np.zeros(COUNT)  # of the travels, summed since the window began
        filtered = np.empty((2, COUNT + 1))
        whitened = np.empty(COUNT + 1)
        valve = np.empty(3)
        error, smooth = np.empty(samples), np.empty(samples)
        variance = np.empty(2)
        inflation = np.empty(2)
        leak_unit = LITRE_PER_MINUTE / LEAKAGE_TEST_PRESSURE
        part = sheet.period / POINTS
        for window in range(signals.shape[0]):
            x, sensed_a, sensed_b, reading, command = signals[window]
            _without_lag(sensed_a, sheet.pressure_decay, sheet.pressure_lag, p_a)
            _without_lag(sensed_b, sheet.pressure_decay, sheet.pressure_lag, p_b)
            candidate = _best_valve(reading, command, sheet.transition, sheet.spool_noise, valve)
            _spool_between(
                reading, command, sheet.transition[candidate], sheet.spool_noise, valve, spool, error, smooth
            )
            valve_choice[window] = candidate
            for k in range(samples):
                spool_error[window, k] = error[k]

            for i in range(COUNT):
                theta[i] = sheet.mean[i]
            inflation[0] = inflation[1] = 1.0
            for iteration in range(ITERATIONS + 1):
                u = _read_unknowns(theta)
                gain = c.edge_gain * u.flow_gain
                underlap = u.underlap
                internal, external = leak_unit * u.internal_leak, leak_unit * u.external_leak
                supply, gas = u.supply_pressure + u.supply_excess, sheet.gas_volume
                excess_share = 1.0
                for i in range(COUNT):
                    column[i] = (sheet.mean[i] - theta[i]) / sheet.spread[i]
                    slope_a[i] = slope_b[i] = 0.0
                    for j in range(COUNT):
                        normal[i, j] = 1.0 if i == j else 0.0
                    filtered[0, i] = filtered[1, i] = 0.0
                filtered[0, COUNT] = filtered[1, COUNT] = 0.0
                variance[0] = sheet.position_noise**2
                variance[1] = (u.compressibility * sheet.pressure_noise_b / c.bulk_modulus * c.volume_b0 / c.area_b) ** 2
                travel_a = travel_b = 0.0
                for residual in range(2):
                    if iteration > 1:
                        inflation[residual] *= min(max(misfit[window, residual], 0.5), 4.0)
                    if inflation[residual] < 1.0:
                        inflation[residual] = 1.0
                    misfit[window, residual] = 0.0
                for k in range(samples - 1):
                    drawn = 0.0
                    drop_a = drop_b = 0.0
                    for point in range(POINTS):
                        share = (point + 0.5) / POINTS
                        a = p_a[k] + share * (p_a[k + 1] - p_a[k]) - u.bias_a
                        b = p_b[k] + share * (p_b[k + 1] - p_b[k]) - u.bias_b
                        opening = spool[k, point] - u.null
                        width = math.sqrt(opening * opening + underlap * underlap)
                        forward, backward = 0.5 * (width + opening), 0.5 * (width - opening)
                        t2 = c.transition_squared
                        in_a, out_a = smooth_root(supply - a, t2), smooth_root(a - u.tank_pressure, t2)
                        out_b, in_b = smooth_root(b - u.tank_pressure, t2), smooth_root(supply - b, t2)
                        din_a, dout_a = _root_slope(supply - a, t2), _root_slope(a - u.tank_pressure, t2)
                        dout_b, din_b = _root_slope(b - u.tank_pressure, t2), _root_slope(supply - b, t2)
                        unit_a, unit_b = forward * in_a - backward * out_a, forward * out_b - backward * in_b
                        flow_a = gain * unit_a - internal * (a - b)
                        flow_b = gain * unit_b - internal * (a - b) + external * b
                        drawn += gain * (forward * in_a + backward * in_b) / POINTS
                        scale_a, scale_b = part / c.area_a, part / c.area_b
                        travel_a += scale_a * flow_a
                        travel_b += scale_b * flow_b
                        lap = 0.5 * underlap / width
                        shift_forward, shift_backward = -0.5 * (opening / width + 1.0), -0.5 * (opening / width - 1.0)
                        to_supply_a, to_supply_b = gain * forward * din_a, -gain * backward * din_b
                        to_tank_a, to_tank_b = gain * backward * dout_a, -gain * forward * dout_b
                        slope_a[0] += scale_a * c.edge_gain * unit_a
                        slope_b[0] += scale_b * c.edge_gain * unit_b
                        slope_a[1] += scale_a * to_supply_a
                        slope_b[1] += scale_b * to_supply_b
                        slope_a[2] += scale_a * to_supply_a * excess_share
                        slope_b[2] += scale_b * to_supply_b * excess_share
                        slope_a[3] += scale_a * gain * lap * (in_a - out_a)
                        slope_b[3] += scale_b * gain * lap * (out_b - in_b)
                        slope_a[4] += scale_a * gain * (shift_forward * in_a - shift_backward * out_a)
                        slope_b[4] += scale_b * gain * (shift_forward * out_b - shift_backward * in_b)
                        slope_a[5] -= scale_a * leak_unit * (a - b)
                        slope_b[5] -= scale_b * leak_unit * (a - b)
                        slope_b[6] += scale_b * leak_unit * b
                        # True pressure is the reading less the bias.
                        slope_a[10] += scale_a * (to_supply_a + to_tank_a + internal)
                        slope_b[10] += scale_b * internal
                        slope_a[11] -= scale_a * internal
                        slope_b[11] += scale_b * (to_tank_b + to_supply_b - internal - external)
                        slope_a[12] += scale_a * to_tank_a
                        slope_b[12] += scale_b * to_tank_b
                    # Compression.
                    volume_a, volume_b = chamber_volumes(0.5 * (x[k] + x[k + 1]), c)
                    first_a, last_a = _absolute(p_a[k] - u.bias_a), _absolute(p_a[k + 1] - u.bias_a)
                    first_b, last_b = _absolute(p_b[k] - u.bias_b), _absolute(p_b[k + 1] - u.bias_b)
                    oil_a, oil_b = (last_a - first_a) / c.bulk_modulus, (last_b - first_b) / c.bulk_modulus
                    air_a = ATMOSPHERIC_PRESSURE * (1.0 / first_a - 1.0 / last_a)
                    air_b = ATMOSPHERIC_PRESSURE * (1.0 / first_b - 1.0 / last_b)
                    squeezed_a = u.compressibility * oil_a + u.air_fraction * air_a
                    squeezed_b = u.compressibility * oil_b + u.air_fraction * air_b
                    all_a, all_b = (volume_a + u.dead_volume) / c.area_a, (volume_b + u.dead_volume) / c.area_b
                    travel_a -= all_a * squeezed_a
                    travel_b += all_b * squeezed_b
                    slope_a[7] -= all_a * oil_a
                    slope_b[7] += all_b * oil_b
                    slope_a[8] -= all_a * air_a
                    slope_b[8] += all_b * air_b
                    slope_a[9] -= squeezed_a / c.area_a
                    slope_b[9] += squeezed_b / c.area_b
                    # Supply.
                    rate, gas_rate = supply_rates(_Supplied(supply, gas), drawn, _set_to(c, u.supply_pressure))
                    if c.supply_dynamics > 0.0:
                        excess_share *= math.exp(
                            -sheet.period * c.supply_dynamics * (supply + ATMOSPHERIC_PRESSURE) / gas * c.relief_slope
                        )
                    supply += sheet.period * rate
                    gas += sheet.period * gas_rate
                    # Whitening.
                    sensed = math.hypot(all_a * sheet.pressure_noise_a, all_b * sheet.pressure_noise_b) / c.bulk_modulus
                    speed = abs(reading[k + 1] - reading[k])
                    noise = sheet.flow_noise**2 + (sheet.flow_error * speed) ** 2
                    if min(p_a[k], p_a[k + 1]) < sheet.lowest_a or min(p_b[k], p_b[k + 1]) < sheet.lowest_b:
                        noise += CAVITATING**2  # the reading may be at the end of its range
                    for residual in range(2):
                        other = residual == 1
                        base = u.compressibility * sensed if other else sheet.position_noise
                        variance[residual] += noise
                        total = variance[residual] + base * base
                        blend, unit = variance[residual] / total, 1.0 / math.sqrt(total * inflation[residual])
                        variance[residual] *= 1.0 - blend
                        value = travel_b - travel_a if other else x[k + 1] - x[0] - travel_a
                        innovation = value - filtered[residual, COUNT]
                        filtered[residual, COUNT] += blend * innovation
                        size = abs(unit * innovation)
                        weight = 1.0 if size < 3.0 else math.sqrt(3.0 / size)  # Huber
                        misfit[window, residual] += (unit * innovation) ** 2
                        for i in range(COUNT):
                            slope = slope_b[i] - slope_a[i] if other else -slope_a[i]
                            new = slope * sheet.spread[i] - filtered[residual, i]
                            filtered[residual, i] += blend * new
                            whitened[i] = weight * unit * new
                        whitened[COUNT] = weight * unit * innovation
                        if other:  # the noise of the pressures is in the derivative by the compressibility too
                            noisy = (unit * sheet.spread[COMPRESSIBILITY] * sensed) ** 2
                            normal[COMPRESSIBILITY, COMPRESSIBILITY] -= 0.5 * noisy
                            column[COMPRESSIBILITY] += noisy * u.compressibility / sheet.spread[COMPRESSIBILITY]
                        for i in range(COUNT):
                            for j in range(i + 1):
                                normal[i, j] += whitened[i] * whitened[j]
                            column[i] -= whitened[i] * whitened[COUNT]
                misfit[window, 0] /= samples - 1
                misfit[window, 1] /= samples - 1
                if iteration == ITERATIONS:
                    misfit[window, 0] *= inflation[0]
                    misfit[window, 1] *= inflation[1]
                if iteration < ITERATIONS:
                    _factor(normal)
                    _substitute(normal, column)
                    for i in range(COUNT):
                        theta[i] += min(max(column[i], -1.5), 1.5) * sheet.spread[i]
                    theta[0] = min(max(theta[0], 0.2), 3.0)
                    theta[3] = max(theta[3], 1e-3)
                    theta[7] = max(theta[7], 0.3)
            for i in range(COUNT):
                estimate[window, i] = theta[i]
            _factor(normal)
            for i in range(COUNT):  # diagonal of the inverse
                for j in range(COUNT):
                    column[j] = 1.0 if i == j else 0.0
                _substitute(normal, column)
                deviation[window, i] = math.sqrt(column[i]) * sheet.spread[i]

    return compiled(fit)


_fit = _build(SOURCES)


class Balance(NamedTuple):
    """The fit of N windows of T samples."""

    estimate: NDArray[np.float64]  # (N, COUNT), of the unknowns
    deviation: NDArray[np.float64]  # (N, COUNT), their standard deviations
    misfit: NDArray[np.float64]  # (N, 2), mean squares of the whitened residuals; about 1 where the model holds
    valve: NDArray[np.int64]  # (N,), index of the valve that answers most like the spool
    spool_error: NDArray[np.float64]  # (N, T), reading of the spool less that valve's answer to the commands


def fit_balance(signals: NDArray[np.float64], sheet: Sheet) -> Balance:
    """Fit the flow balance of windows.

    Args:
        signals: (N, 5, T), position, pressures, spool position and previous command in SI units, without NaN.
        sheet: data sheet of the axis.
    """
    count, _, samples = signals.shape
    balance = Balance(
        np.empty((count, COUNT)),
        np.empty((count, COUNT)),
        np.empty((count, 2)),
        np.empty(count, dtype=np.int64),
        np.empty((count, samples)),
    )
    _fit(np.ascontiguousarray(signals), sheet, *balance)
    return balance
