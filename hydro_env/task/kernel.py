"""Episodes of many axes in compiled code: their beginning, and one control period.

All draws come from counter-based random numbers: an axis's episode depends only on its own root and episode number.
"""

import math
from functools import cache
from typing import Any

import numpy as np

from hydro_env.compiling import SOURCES, compiled, inline
from hydro_env.plant.arrays import (
    read_coefficients,
    read_complete_state,
    read_physical,
    read_state,
    write_coefficients,
    write_complete_state,
)
from hydro_env.plant.equations import coefficients
from hydro_env.plant.equilibrium import complete_at_rest, equilibrium_state
from hydro_env.plant.kernel import (
    IMPACT_SPEED,
    MOST_STEPS_PER_PERIOD,
    PEAK_PRESSURE,
    STEPS,
    Accuracy,
    Plants,
    integrators,
)
from hydro_env.plant.parts.lines import VOLUMES, WAVES
from hydro_env.plant.states import RIGID, Structure, first_outside, valid_range
from hydro_env.task.fault_effects import draw_faults, driven, read_truly
from hydro_env.task.paces import periods_late
from hydro_env.task.random_numbers import (
    DISTURBANCE,
    FAULT,
    INITIAL_STATE,
    LATENCY,
    LEAKAGE,
    NOISE,
    PLANT,
    REFERENCE,
    RIG,
    between,
    log_between,
    redrawn,
    source_key,
    uniform,
    within,
)
from hydro_env.task.record import (
    CANNOT_BE_HELD,
    CANNOT_BE_REACHED,
    COMMANDS,
    FIRST_COEFFICIENT,
    FIRST_DURATION,
    FIRST_INVALID_STATE,
    FIRST_PEAK,
    FIRST_VOLTAGE,
    HIT_END_STOP,
    NO_FAILURE,
    OVER_BUDGET,
    OVERPRESSURE,
)
from hydro_env.task.reference_signals import USER_FAMILY, feasible, fill_reference, fill_usual
from hydro_env.task.rewards import costs
from hydro_env.task.schedules import draw_changing_force, draw_leak, draw_steady_force, follow_schedules, set_leak
from hydro_env.task.sensors import Sensors
from hydro_env.task.settings import choice
from hydro_env.task.signals import POSITION, draw_biases, follow_motion, lagged, sample, write_observation
from hydro_env.units import FULL_VOLTAGE

MOST_DRAWS = 200  # largest number of draws of plant, leak and initial position until an episode can begin

PREVIOUS, NEW = range(COMMANDS)
"""Columns of the voltage: the previous command acts during the latency, the new one during the rest of the period; of a
latency above a period its part within a period counts, and both commands are older by the whole periods."""

_VALVE = choice(Sensors, "pressures_at", "valve")

_FAMILY_NUMBER = 1_000_000  # index of the number for the family, beyond those that shape a reference


@inline
def _draw_plant(physical, key, plant, draws, fixed):
    """Physical parameters of an episode: base and drawn values, except where the caller fixed them (not NaN)."""
    for index in range(len(fixed)):
        physical[index] = plant[index] if math.isnan(fixed[index]) else fixed[index]
    for number in range(len(draws)):
        draw = draws[number]
        if draw.parameter < 0:
            break
        if draw.logarithmic:
            value = log_between(key, 2 * number, draw.low, draw.high)
        else:
            value = between(key, 2 * number, draw.low, draw.high)
        if draw.times >= 0:
            value *= physical[draw.times]
        if uniform(key, 2 * number + 1) < draw.otherwise_probability:
            value = draw.otherwise
        if math.isnan(fixed[draw.parameter]):
            physical[draw.parameter] = value


@inline
def _draw_family(key, fixed, weights):
    """Family of the reference; ``fixed`` replaces the draw if it is not negative."""
    if fixed >= 0:
        return fixed
    share = uniform(key, _FAMILY_NUMBER)
    family = 0
    while family < len(weights) - 1 and share >= weights[family]:
        share -= weights[family]
        family += 1
    return family


@inline
def _reaches(row, c, f):
    """Whether the supply can hold each position of a user's reference against spring and external force."""
    reaches = True
    for sample_number in range(len(row)):
        spring = c.spring_stiffness * row[sample_number] + c.external_force
        if spring > f.force_out or -spring > f.force_in:
            reaches = False
    return reaches


@inline
def _failure(s, peaks, c, settings):
    """Index of the failure in this period; if several occur, the last one checked."""
    failure = NO_FAILURE
    if peaks[IMPACT_SPEED] > settings.failure.end_stop_speed:
        failure = HIT_END_STOP
    if peaks[PEAK_PRESSURE] > settings.failure.pressure_rating:
        failure = OVERPRESSURE
    lowest, highest = valid_range(c)
    invalid = first_outside(s, lowest, highest)
    if invalid >= 0:
        failure = FIRST_INVALID_STATE + invalid
    if peaks[STEPS] > MOST_STEPS_PER_PERIOD:
        failure = OVER_BUDGET
    return failure


@inline
def _late(row, before, now):
    """Drives that act now, the older one first: as many periods old as the command is late; ``before`` came last."""
    if row.late > 0.0:
        late = np.int64(row.late)
        now = before if late == 1 else row.sent[late - 2]
        older = row.sent[late - 1]
        for place in range(row.sent.shape[0] - 1, 0, -1):
            row.sent[place] = row.sent[place - 1]
        row.sent[0] = before
        before = older
    return before, now


@inline
def _at_the_valve(state, s, settings):
    """Pressures where their sensors sit, at the cylinder or at the valve, Pa; without waves in the lines both agree."""
    everything = read_complete_state(state)
    if settings.sensors.pressures_at == _VALVE:
        return everything.line_a_pressure_1, everything.line_b_pressure_1
    return s.pressure_a, s.pressure_b


@inline
def _at_the_cylinder(state, s, settings):
    return s.pressure_a, s.pressure_b


def _begin(sources, everything, lines):
    fill = fill_reference if everything else fill_usual

    def begin_episodes(chosen, task, layout, chances, fixed, physical, record, plant, references, observation):
        """Begin an episode on the axes ``chosen``, (M,); their records must be zero.

        A plant that cannot hold its initial position is drawn again, :data:`MOST_DRAWS` times at most; ``failure`` in
        the record gives the reason for the last one.

        Of each rig ``task`` (rigs,) holds :data:`~hydro_env.task.settings.SETTINGS` and ``layout`` (rigs, observations)
        :data:`~hydro_env.task.signals.LAYOUT`; ``chances`` are :class:`~hydro_env.task.record.Chances`, ``fixed``
        :class:`~hydro_env.task.record.Fixed`. Written: ``physical`` (N, parameters), and the four arrays of
        :class:`~hydro_env.task.record.AxisArrays`.
        """
        assert sources >= 0  # keys numba's cache
        states = plant[:, :FIRST_COEFFICIENT]
        coefficient = plant[:, FIRST_COEFFICIENT:FIRST_VOLTAGE]
        for number in range(len(chosen)):
            axis = chosen[number]
            row = record[axis]
            root, episode = chances.seeds[axis].root, chances.seeds[axis].episode
            rig = fixed.rig[axis]
            if rig < 0:
                rig = np.int64(len(task) * uniform(source_key(root, episode, RIG), 0))
            row.rig = rig
            settings = task[rig]
            reference = references[axis, : settings.samples]
            reference_key = source_key(root, episode, REFERENCE)
            family = _draw_family(reference_key, fixed.family[axis], chances.family_weights)
            row.reference_family = family
            if family == USER_FAMILY:
                for sample_number in range(len(reference)):
                    reference[sample_number] = fixed.user_reference[axis, sample_number]
            row.noise_key = source_key(root, episode, NOISE)
            draw_biases(row, settings)
            row.latency = within(source_key(root, episode, LATENCY), 0, settings.latency_range)
            force_key = source_key(root, episode, DISTURBANCE)
            row.failure = CANNOT_BE_HELD
            attempt = 0
            while row.failure != NO_FAILURE and attempt < MOST_DRAWS:
                row.redraws = attempt
                drawn = redrawn(root, attempt)
                _draw_plant(
                    physical[axis],
                    source_key(drawn, episode, PLANT),
                    chances.plant[rig],
                    chances.draws[rig],
                    fixed.parameters[axis],
                )
                p = read_physical(physical[axis])
                write_coefficients(coefficient[axis], coefficients(p))
                draw_steady_force(row, coefficient[axis], force_key, settings)
                draw_leak(row, source_key(drawn, episode, LEAKAGE), fixed.leakage_flow_lpm[axis], settings)
                set_leak(row, coefficient[axis], 0.0, settings)
                if everything:
                    draw_faults(row, coefficient[axis], source_key(drawn, episode, FAULT), fixed.faults[axis], settings)

                # A user's reference sets its own start.
                c = read_coefficients(coefficient[axis])
                f = feasible(c, settings.references)
                place = within(source_key(drawn, episode, INITIAL_STATE), 0, settings.initial_position_range)
                start = place * f.high if place > 0.0 else -place * f.low
                row.failure = NO_FAILURE
                if family == USER_FAMILY:
                    start = reference[0]
                    if not _reaches(reference, c, f):
                        row.failure = CANNOT_BE_REACHED
                if not math.isnan(fixed.initial_position[axis]):
                    start = fixed.initial_position[axis]
                fill(reference, family, reference_key, start, settings.control_period, f, settings.references)

                # The axis holds the position that its sensor reads as the initial position.
                held = start
                if settings.start_bias_share > 0.0:
                    held = read_truly(start - row.bias[POSITION], POSITION, row, settings.channels[POSITION])
                s, voltage, found = equilibrium_state(held, p, c, lines)
                write_complete_state(states[axis], complete_at_rest(s, c))
                if not found or abs(held) > c.end_stop_position:
                    row.failure = CANNOT_BE_HELD
                row.command = row.drive = (1.0 / FULL_VOLTAGE) * voltage
                attempt += 1

            if everything:
                draw_changing_force(row, coefficient[axis], force_key, settings)
            row.late = periods_late(row.latency, settings.control_period)
            for place in range(row.sent.shape[0]):
                row.sent[place] = row.drive
            after = min(row.latency - row.late * settings.control_period, settings.control_period)
            plant[axis, FIRST_DURATION + PREVIOUS] = after
            plant[axis, FIRST_DURATION + NEW] = settings.control_period - after
            s = read_state(states[axis])
            pressure_a, pressure_b = _at_the_valve(states[axis], s, settings)
            row.true_a = row.sensed_a = pressure_a
            row.true_b = row.sensed_b = pressure_b
            row.position = s.position
            row.reference = reference[0]
            sample(row, s, settings)
            write_observation(observation[axis], row, reference, layout[rig])

    return compiled(begin_episodes)


def _follow(sources):
    def follow(task, record, plant, first, last):
        """Set leak, faults and external force of some axes for the next period, if any of them changes."""
        assert sources >= 0
        for axis in range(first, last):
            row = record[axis]
            follow_schedules(row, plant[axis, FIRST_COEFFICIENT:FIRST_VOLTAGE], task[np.int64(row.rig)])

    return compiled(follow)


def _step(sources, integrate_part, pressures):
    def step_axes(task, layout, record, plant, reference, observation, actions, first, last):
        """Advance the axes from ``first`` up to ``last`` by one control period with ``actions``, (N,)."""
        assert sources >= 0
        states = plant[:, :FIRST_COEFFICIENT]
        coefficient = plant[:, FIRST_COEFFICIENT:FIRST_VOLTAGE]
        voltage = plant[:, FIRST_VOLTAGE:FIRST_DURATION]
        durations = plant[:, FIRST_DURATION:FIRST_PEAK]
        peaks = plant[:, FIRST_PEAK:]
        for axis in range(first, last):
            row = record[axis]
            settings = task[np.int64(row.rig)]
            command = min(max(np.float64(actions[axis]), -1.0), 1.0)
            row.change = command - row.command
            row.command = command
            before = row.drive
            row.drive = driven(command, before, row)
            older, newer = _late(row, before, row.drive)
            voltage[axis, PREVIOUS] = FULL_VOLTAGE * older
            voltage[axis, NEW] = FULL_VOLTAGE * newer

        integrate_part(
            Plants(states, coefficient, voltage, durations, peaks),
            Accuracy(task[0].maximum_step, task[0].tolerance, MOST_STEPS_PER_PERIOD),
            first,
            last,
        )

        for axis in range(first, last):
            row = record[axis]
            rig = np.int64(row.rig)
            settings = task[rig]
            s = read_state(states[axis])
            row.step = min(row.step + 1.0, settings.steps)
            row.position = s.position
            row.velocity = s.velocity
            row.reference = reference[axis, np.int64(row.step)]

            pressure_a, pressure_b = pressures(states[axis], s, settings)
            row.sensed_a = lagged(row.sensed_a, row.true_a, pressure_a, settings)
            row.sensed_b = lagged(row.sensed_b, row.true_b, pressure_b, settings)
            row.true_a = pressure_a
            row.true_b = pressure_b
            before = row.measured[POSITION]
            sample(row, s, settings)
            follow_motion(row, before, settings)

            c = read_coefficients(coefficient[axis])
            failure = _failure(s, peaks[axis], c, settings)
            row.failure = failure
            for index, cost in enumerate(costs(row, row.change, failure != NO_FAILURE, settings)):
                row.costs[index] = cost
            write_observation(observation[axis], row, reference[axis], layout[rig])

        # Separate, so that a compiler that contracts products and sums cannot round the sum differently.
        for axis in range(first, last):
            row = record[axis]
            total = 0.0
            for index in range(row.costs.shape[0]):
                total += row.costs[index]
            row.reward = -total

    return compiled(step_axes)


def _observe(sources):
    def observe(task, layout, record, reference, observation, before):
        """Write the observation of one axis whose plant is elsewhere; its record holds signals and command.

        ``reference`` begins now; ``before`` is the position measured one period ago, m; NaN: the episode begins.
        """
        assert sources >= 0
        row = record[0]
        row.reference = reference[0]
        if not math.isnan(before):
            follow_motion(row, before, task[0])
        write_observation(observation[0], row, reference, layout)

    return compiled(observe)


@cache
def step_of(structure: Structure) -> Any:
    """:data:`step_axes` for axes with a structure."""
    _, integrate_part = integrators(structure)
    return _step(SOURCES + structure.number, integrate_part, _at_the_valve if structure.lines else _at_the_cylinder)


# Few tasks have faults, a changing force, or references at which an axis hardly moves; they take long to compile.
begin_usual, begin_any = _begin(SOURCES, False, VOLUMES), _begin(SOURCES, True, VOLUMES)
begin_with_lines = _begin(SOURCES + 1, True, WAVES)  # for rigs of which some have lines with waves
follow, step_axes, observe = _follow(SOURCES), step_of(RIGID), _observe(SOURCES)
