"""Episodes of many axes in compiled code: how one begins, and what one control period does to it.

Per axis there is a row of ``record`` (columns named by ``Record``), a row of reference samples, a row of physical
parameters, and a row of the plant's arrays (see ``plant.kernel``). All draws come from counted random numbers, so
that an axis' episode depends on its own root and episode number alone.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_env.compiling import SOURCES, compiled, inline, tuple_reader
from hydro_env.plant.arrays import read_coefficients, read_physical, read_state, write_coefficients, write_state
from hydro_env.plant.equations import Coefficients, coefficients
from hydro_env.plant.equilibrium import equilibrium_state
from hydro_env.plant.kernel import IMPACT_SPEED, MOST_STEPS_PER_PERIOD, PEAK_PRESSURE, Accuracy, Plants, integrate_part
from hydro_env.plant.states import first_outside, valid_range
from hydro_env.task.random_numbers import (
    DISTURBANCE,
    INITIAL_STATE,
    LEAKAGE,
    NOISE,
    PLANT,
    REFERENCE,
    between,
    log_between,
    normal_pair,
    source_key,
    uniform,
)
from hydro_env.task.record import (
    CANNOT_BE_HELD,
    CANNOT_BE_REACHED,
    CHANNEL_COLUMNS,
    DRAW_HIGH,
    DRAW_INDEX,
    DRAW_LOG,
    DRAW_LOW,
    DRAW_OTHERWISE,
    DRAW_PROBABILITY,
    DRAW_TIMES,
    FIRST_INVALID_STATE,
    FIXED_OBSERVATIONS,
    HIT_END_STOP,
    N_SETTINGS,
    NO_FAILURE,
    OVERPRESSURE,
    Record,
    Settings,
)
from hydro_env.task.reference_signals import Limits, feasible, fill_reference
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

_column = {name: index for index, name in enumerate(Record._fields)}
C_STEP = _column["step"]
C_COMMAND = _column["command"]
C_FAMILY = _column["reference_family"]
C_LEAK = _column["leak_flow"]
C_LEAK_START = _column["leak_start_flow"]
C_LEAK_TARGET = _column["leak_target_flow"]
C_LEAK_TIME = _column["leak_start_time"]
C_FORCE = _column["force_amplitude"]
C_FORCE_TIME = _column["force_start_time"]
C_FORCE_FREQUENCY = _column["force_frequency"]
C_FORCE_BASE = _column["force_base"]
C_BIAS = _column["bias_position"]
C_MEASURED = _column["measured_position"]
C_VELOCITY_ESTIMATE = _column["velocity_estimate"]
C_INTEGRAL = _column["error_integral"]
C_TRUE = _column["true_a"]
C_SENSED = _column["sensed_a"]
C_POSITION = _column["position"]
C_VELOCITY = _column["velocity"]
C_REFERENCE = _column["reference"]
C_COST = _column["cost_tracking"]
C_FAILURE = _column["failure"]

_LEAKAGE_CONDUCTANCE = Coefficients._fields.index("leakage_conductance")
_LEAKAGE_ORIFICE_GAIN = Coefficients._fields.index("leakage_orifice_gain")
_EXTERNAL_FORCE = Coefficients._fields.index("external_force")
_USER_FAMILY = 6
_SINE = 3.0
_PULSE = 2.0

_read_settings = tuple_reader(Settings)
_read_limits = tuple_reader(Limits)


@inline
def _unpack(constants, observations):
    """Views of what :func:`~hydro_env.task.packing.step_constants` packed behind the settings."""
    previews = observations - FIXED_OBSERVATIONS
    first = N_SETTINGS + 2
    scale = first + previews
    limit = scale + observations
    channels = limit + observations
    return (
        constants[N_SETTINGS:first],
        constants[first:scale],
        constants[scale:limit],
        constants[limit:channels],
        constants[channels:],
    )


@inline
def _quantised(value, resolution):
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value


@inline
def _measure(true, bias, noise, sensors, first):
    """What the acquisition reads: bias and noise added, limited to the range, in 16-bit steps.

    ``sensors`` from index ``first`` on: noise, bias, resolution, low, high of the channel.
    """
    low, high = sensors[first + 3], sensors[first + 4]
    value = min(max(true + bias + sensors[first] * noise, low), high)
    return min(max(low + _quantised(value - low, sensors[first + 2]), low), high)


@inline
def _sample_signals(row, position, spool, noise_key, sensors, settings):
    """Read the four transducers at this instant into the record."""
    if settings.sensors_enabled == 0.0:
        row[C_MEASURED] = position
        row[C_MEASURED + 1] = row[C_TRUE]
        row[C_MEASURED + 2] = row[C_TRUE + 1]
        row[C_MEASURED + 3] = spool
        return
    step = np.int64(row[C_STEP])
    first, second = normal_pair(noise_key, 2 * step)
    third, fourth = normal_pair(noise_key, 2 * step + 1)
    row[C_MEASURED] = _measure(position, row[C_BIAS], first, sensors, 0)
    row[C_MEASURED + 1] = _measure(row[C_SENSED], row[C_BIAS + 1], second, sensors, CHANNEL_COLUMNS)
    row[C_MEASURED + 2] = _measure(row[C_SENSED + 1], row[C_BIAS + 2], third, sensors, 2 * CHANNEL_COLUMNS)
    row[C_MEASURED + 3] = _measure(spool, row[C_BIAS + 3], fourth, sensors, 3 * CHANNEL_COLUMNS)


@inline
def _write_observation(observation, row, reference, preview, scale, limit):
    """One row of the observation: physical values over their fixed scale, inside the bounds of the Box."""
    step = np.int64(row[C_STEP])
    now = reference[step]
    observation[0] = now / scale[0]
    count = preview.shape[0]
    for index in range(count):
        observation[1 + index] = (reference[step + np.int64(preview[index])] - now) / scale[1 + index]
    observation[1 + count] = row[C_MEASURED] / scale[1 + count]
    observation[2 + count] = row[C_VELOCITY_ESTIMATE] / scale[2 + count]
    observation[3 + count] = row[C_MEASURED + 1] / scale[3 + count]
    observation[4 + count] = row[C_MEASURED + 2] / scale[4 + count]
    observation[5 + count] = row[C_MEASURED + 3] / scale[5 + count]
    observation[6 + count] = row[C_COMMAND] / scale[6 + count]
    observation[7 + count] = (now - row[C_MEASURED]) / scale[7 + count]
    observation[8 + count] = row[C_INTEGRAL] / scale[8 + count]
    for index in range(observation.shape[0]):
        observation[index] = min(max(observation[index], -limit[index]), limit[index])


@inline
def _leak_flow(row, time, settings):
    """Leakage of the schedule at a time, l/min at 100 bar: constant, sudden onset, or log-linear growth."""
    start, target, begin = row[C_LEAK_START], row[C_LEAK_TARGET], row[C_LEAK_TIME]
    if settings.schedule == 0.0:
        return target
    if time < begin:
        return start
    if settings.schedule == 1.0 or target == start:  # which may both be 0
        return target
    end = settings.steps * settings.control_period
    share = min((time - begin) / max(end - begin, settings.control_period), 1.0)
    return start * (target / start) ** share


@inline
def _set_leak(row, coefficient, flow, settings):
    row[C_LEAK] = flow
    if settings.orifice_law == 0.0:
        coefficient[_LEAKAGE_CONDUCTANCE] = flow * LITRE_PER_MINUTE / LEAKAGE_TEST_PRESSURE
        coefficient[_LEAKAGE_ORIFICE_GAIN] = 0.0
    else:
        coefficient[_LEAKAGE_CONDUCTANCE] = 0.0
        coefficient[_LEAKAGE_ORIFICE_GAIN] = flow * LITRE_PER_MINUTE / math.sqrt(LEAKAGE_TEST_PRESSURE)


@inline
def _external_force(row, time, settings):
    """External force in N of the configured disturbance, besides the plant's own."""
    after = time - row[C_FORCE_TIME]
    if after < 0.0:
        return row[C_FORCE_BASE]
    force = row[C_FORCE]
    if settings.disturbance == _PULSE and after >= settings.pulse_duration:
        force = 0.0
    if settings.disturbance == _SINE:
        force *= math.sin(2.0 * math.pi * row[C_FORCE_FREQUENCY] * after)
    return row[C_FORCE_BASE] + force


@inline
def _draw_plant(physical, key, base, draws, override):
    """Physical parameters of an episode: base and drawn values, except where the caller fixed them (not NaN)."""
    for index in range(base.shape[0]):
        physical[index] = base[index] if math.isnan(override[index]) else override[index]
    for number in range(draws.shape[0]):
        draw = draws[number]
        if draw[DRAW_LOG] > 0.0:
            value = log_between(key, 2 * number, draw[DRAW_LOW], draw[DRAW_HIGH])
        else:
            value = between(key, 2 * number, draw[DRAW_LOW], draw[DRAW_HIGH])
        if draw[DRAW_TIMES] >= 0.0:
            value *= physical[np.int64(draw[DRAW_TIMES])]
        if uniform(key, 2 * number + 1) < draw[DRAW_PROBABILITY]:
            value = draw[DRAW_OTHERWISE]
        index = np.int64(draw[DRAW_INDEX])
        if math.isnan(override[index]):
            physical[index] = value


def _build(sources):
    def begin_episodes(
        axes,
        constants,
        limits_array,
        base,
        draws,
        family_weights,
        roots,
        episodes,
        parameter_override,
        leak_override,
        position_override,
        family_override,
        user_reference,
        state,
        coefficient,
        physical,
        record,
        reference,
        noise_key,
        observation,
    ):
        assert sources >= 0  # keys numba's cache
        settings = _read_settings(constants)
        _, preview, scale, limit, sensors = _unpack(constants, observation.shape[1])
        limits = _read_limits(limits_array)
        for number in range(axes.shape[0]):
            axis = axes[number]
            row = record[axis]
            root, episode = roots[axis], episodes[axis]
            row[:] = 0.0
            _draw_plant(physical[axis], source_key(root, episode, PLANT), base, draws, parameter_override[axis])
            p = read_physical(physical[axis])
            c = coefficients(p)
            write_coefficients(coefficient[axis], c)

            # Leakage: healthy or faulty, and when it starts.
            key = source_key(root, episode, LEAKAGE)
            healthy = log_between(key, 0, settings.healthy_low, settings.healthy_high)
            faulty = log_between(key, 1, settings.faulty_low, settings.faulty_high)
            target = healthy if uniform(key, 2) < settings.healthy_share else faulty
            if not math.isnan(leak_override[axis]):
                target = leak_override[axis]
                healthy = min(healthy, target)
            row[C_LEAK_START] = healthy
            row[C_LEAK_TARGET] = target
            duration = settings.steps * settings.control_period
            row[C_LEAK_TIME] = duration * between(key, 3, settings.leak_start_low, settings.leak_start_high)
            _set_leak(row, coefficient[axis], _leak_flow(row, 0.0, settings), settings)

            # Disturbance.
            row[C_FORCE_BASE] = c.external_force
            if settings.disturbance > 0.0:
                key = source_key(root, episode, DISTURBANCE)
                force = between(key, 0, settings.force_low, settings.force_high)
                row[C_FORCE] = force if uniform(key, 1) < 0.5 else -force
                row[C_FORCE_TIME] = duration * between(key, 2, settings.force_start_low, settings.force_start_high)
                row[C_FORCE_FREQUENCY] = between(key, 3, settings.force_frequency_low, settings.force_frequency_high)

            # Initial position and reference. A user's reference starts where it says.
            f = feasible(c, limits)
            key = source_key(root, episode, REFERENCE)
            family = family_override[axis]
            if family < 0:
                share = uniform(key, 1_000_000)
                family = 0
                while family < family_weights.shape[0] - 1 and share >= family_weights[family]:
                    share -= family_weights[family]
                    family += 1
            row[C_FAMILY] = family
            place = between(source_key(root, episode, INITIAL_STATE), 0, settings.initial_low, settings.initial_high)
            start = place * f.high if place > 0.0 else -place * f.low
            if family == _USER_FAMILY:
                source = user_reference[axis if user_reference.shape[0] > 1 else 0]
                for sample in range(reference.shape[1]):
                    reference[axis, sample] = source[sample]
                start = reference[axis, 0]
                for sample in range(reference.shape[1]):
                    spring = c.spring_stiffness * reference[axis, sample] + c.external_force
                    if spring > f.force_out or -spring > f.force_in:
                        row[C_FAILURE] = CANNOT_BE_REACHED
            if not math.isnan(position_override[axis]):
                start = position_override[axis]
            if family != _USER_FAMILY:
                fill_reference(reference[axis], family, key, start, settings.control_period, f, limits)

            # The axis holds its initial position.
            held = read_coefficients(coefficient[axis])
            s, voltage, found = equilibrium_state(start, p, held)
            write_state(state[axis], s)
            if not found or abs(start) > c.end_stop_position:
                row[C_FAILURE] = CANNOT_BE_HELD
            row[C_COMMAND] = 0.1 * voltage

            # Sensors.
            noise = source_key(root, episode, NOISE)
            noise_key[axis] = noise
            for channel in range(4):
                row[C_BIAS + channel] = sensors[channel * CHANNEL_COLUMNS + 1] * between(
                    noise, 1_000_000_000 + channel, -1.0, 1.0
                )
            row[C_TRUE] = row[C_SENSED] = s.pressure_a
            row[C_TRUE + 1] = row[C_SENSED + 1] = s.pressure_b
            row[C_POSITION] = s.position
            row[C_REFERENCE] = reference[axis, 0]
            _sample_signals(row, s.position, s.spool_position, noise, sensors, settings)
            _write_observation(observation[axis], row, reference[axis], preview, scale, limit)

    def step_axes(
        constants,
        state,
        coefficient,
        voltage,
        peaks,
        record,
        reference,
        noise_key,
        actions,
        observation,
        reward,
        terminated,
        truncated,
        first,
        last,
    ):
        assert sources >= 0
        settings = _read_settings(constants)
        durations, preview, scale, limit, sensors = _unpack(constants, observation.shape[1])
        period = settings.control_period
        # The previous command acts for the latency, the new one for the rest (MODEL 2.7).
        for axis in range(first, last):
            row = record[axis]
            command = min(max(np.float64(actions[axis]), -1.0), 1.0)
            voltage[axis, 0] = 10.0 * row[C_COMMAND]
            voltage[axis, 1] = 10.0 * command
            change = command - row[C_COMMAND]
            row[C_COST + 1] = settings.effort_weight * change * change
            row[C_COMMAND] = command
            time = row[C_STEP] * period
            if settings.schedule > 0.0:
                _set_leak(row, coefficient[axis], _leak_flow(row, time, settings), settings)
            if settings.disturbance > 0.0:
                coefficient[axis, _EXTERNAL_FORCE] = _external_force(row, time + 0.5 * period, settings)

        integrate_part(
            Plants(state, coefficient, voltage, peaks),
            durations,
            Accuracy(settings.maximum_step, settings.tolerance, MOST_STEPS_PER_PERIOD),
            first,
            last,
        )

        last_step = np.int64(settings.steps)
        for axis in range(first, last):
            row = record[axis]
            row[C_STEP] = min(row[C_STEP] + 1.0, settings.steps)
            step = np.int64(row[C_STEP])
            position = state[axis, 0]
            row[C_POSITION] = position
            row[C_VELOCITY] = state[axis, 1]
            now = reference[axis, step]
            row[C_REFERENCE] = now

            # Transducers: exact response of a first-order lag to a pressure that changes linearly over the period.
            for chamber in range(2):
                old, new = row[C_TRUE + chamber], state[axis, 2 + chamber]
                slope = settings.pressure_lag * (new - old)
                lagging = row[C_SENSED + chamber] - old + slope
                row[C_SENSED + chamber] = new - slope + settings.pressure_decay * lagging
                row[C_TRUE + chamber] = new
            before = row[C_MEASURED]
            _sample_signals(row, position, state[axis, 4], noise_key[axis], sensors, settings)
            rate = (row[C_MEASURED] - before) / period
            row[C_VELOCITY_ESTIMATE] += settings.velocity_blend * (rate - row[C_VELOCITY_ESTIMATE])
            error = now - row[C_MEASURED]
            integral = row[C_INTEGRAL] + period * (error - row[C_INTEGRAL] / settings.integral_time)
            row[C_INTEGRAL] = min(max(integral, -settings.integral_limit), settings.integral_limit)

            failure = NO_FAILURE
            if peaks[axis, IMPACT_SPEED] > settings.end_stop_speed:
                failure = HIT_END_STOP
            if peaks[axis, PEAK_PRESSURE] > settings.pressure_rating:
                failure = OVERPRESSURE
            lowest, highest = valid_range(read_coefficients(coefficient[axis]))
            invalid = first_outside(read_state(state[axis]), lowest, highest)
            if invalid >= 0:
                failure = FIRST_INVALID_STATE + invalid
            row[C_FAILURE] = failure

            error = abs(now - position)
            row[C_COST] = settings.tracking_weight * min(error / settings.error_scale, settings.error_limit)
            row[C_COST + 2] = settings.failure_weight if failure != NO_FAILURE else 0.0
            reward[axis] = -(row[C_COST] + row[C_COST + 1] + row[C_COST + 2])
            terminated[axis] = failure != NO_FAILURE
            truncated[axis] = step >= last_step
            _write_observation(observation[axis], row, reference[axis], preview, scale, limit)

    return compiled(begin_episodes), compiled(step_axes)


begin_episodes, step_axes = _build(SOURCES)
