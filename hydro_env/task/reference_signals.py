"""The references of the axis, one row of samples per episode.

Every family starts at the axis's initial position and stays inside the range, speed and acceleration of the healthy
plant (:class:`Feasible`). There are two intended exceptions: steps exceed the speed, and ramps and start–stop runs
change their speed abruptly.
"""

import math
from typing import NamedTuple

from hydro_env.compiling import function_of_number, inline
from hydro_env.task.random_numbers import between, log_between, log_within, uniform, within


class Feasible(NamedTuple):
    """Limits of a plant for references."""

    low: float  # m
    high: float  # m
    force_out: float  # N, at full pressure, outwards
    force_in: float  # N, at full pressure, inwards
    speed_per_root_force: float  # (m/s)/√N: K/√(A_a³ + A_b³)
    stiffness: float  # N/m, spring
    external_force: float  # N


@inline
def supply_forces(c):
    """Force in N at full supply pressure, outwards and inwards."""
    force_out = c.area_a * c.relief_pressure - c.area_b * c.tank_pressure
    force_in = c.area_b * c.relief_pressure - c.area_a * c.tank_pressure
    return force_out, force_in


@inline
def feasible(c, limits):
    """:class:`Feasible` of a plant without leakage; see ``speed_limits`` and ``reachable_range`` of the analysis.

    ``c`` are the coefficients of the plant, ``limits`` the group ``references`` of the task.
    """
    force_out, force_in = supply_forces(c)
    largest = min(limits.largest_amplitude, 0.9 * c.end_stop_position)
    stiffness = c.spring_stiffness
    high = low = largest
    if stiffness > 0.0:
        high = min(largest, limits.range_share * (force_out - c.external_force) / stiffness)
        low = min(largest, limits.range_share * (force_in + c.external_force) / stiffness)
    return Feasible(
        -max(low, 0.0),
        max(high, 0.0),
        force_out,
        force_in,
        c.edge_gain / math.sqrt(c.area_a**3 + c.area_b**3 / c.edge_ratio**2),
        stiffness,
        c.external_force,
    )


@inline
def _speed_limit(start, end, f, limits):
    """Largest speed in m/s between two positions, valid in both directions."""
    out = f.force_out - f.stiffness * max(start, end) - f.external_force
    back = f.force_in + f.stiffness * min(start, end) + f.external_force
    return limits.speed_share * f.speed_per_root_force * math.sqrt(max(min(out, back), 1.0))


@inline
def _target(key, index, f):
    return between(key, index, f.low, f.high)


@inline
def _farther_end(start, f):
    return f.high if f.high - start > start - f.low else f.low


@inline
def fill_step(row, key, start, period, f, limits):
    """One to four steps at random times, each of a size within the configured range."""
    value = start
    change = between(key, 0, 0.05, 0.3)
    draw = 1
    for sample in range(len(row)):
        if sample * period >= change:
            size = within(key, draw, limits.step_range)
            up = value + size <= f.high
            down = value - size >= f.low
            if up and (not down or uniform(key, draw + 1) < 0.5):
                value += size
            elif down:
                value -= size
            else:  # the range is smaller than the step
                value = f.high if value - f.low < f.high - value else f.low
            change += between(key, draw + 2, 0.4, 1.0)
            draw += 3
        row[sample] = value


@inline
def fill_point_to_point(row, key, start, period, f, limits):
    """Smooth moves (quintic, at rest at both ends) between random targets, with pauses."""
    origin, target = start, start
    begin, duration = 0.0, between(key, 0, 0.05, 0.25)
    draw = 1
    for sample in range(len(row)):
        time = sample * period
        while time >= begin + duration:
            begin += duration
            if target != origin or draw == 1:  # a move follows
                pause = between(key, draw, 0.0, 0.2) if draw > 1 else 0.0
                origin, target = target, _target(key, draw + 1, f)
                distance = abs(target - origin)
                speed = _speed_limit(origin, target, f, limits) * between(key, draw + 2, 0.4, 1.0)
                # The quintic's peaks: 1.875 distance/duration and 5.774 distance/duration².
                duration = max(1.875 * distance / speed, math.sqrt(5.774 * distance / limits.acceleration_limit))
                duration = max(duration, 2.0 * period)
                begin += pause
                draw += 3
        share = min(max((time - begin) / duration, 0.0), 1.0)
        smooth = share * share * share * (10.0 + share * (6.0 * share - 15.0))
        row[sample] = origin + (target - origin) * smooth


@inline
def fill_ramp(row, key, start, period, f, limits):
    """Stretches of constant speed to random targets, with pauses; the speed changes abruptly."""
    value, target, speed = start, start, 0.0
    wait = between(key, 0, 0.05, 0.25)
    draw = 1
    for sample in range(len(row)):
        row[sample] = value
        if wait > 0.0:
            wait -= period
            continue
        if value == target:
            target = _target(key, draw, f)
            speed = _speed_limit(value, target, f, limits) * between(key, draw + 1, 0.3, 1.0)
            draw += 2
        value += min(max(target - value, -speed * period), speed * period)
        if abs(value - target) < 1e-12:
            value = target
            wait = between(key, draw, 0.0, 0.3)
            draw += 1


@inline
def _inwards(start, f):
    """±1 if an end of the range is so near that oscillations can swing to the inner side only, else 0."""
    near = 0.1 * (f.high - f.low)
    if f.high - start < near:
        return -1.0
    return 1.0 if start - f.low < near else 0.0


@inline
def _largest_sine(start, inwards, frequency, f, limits):
    """Largest amplitude within range, speed and acceleration of a sine from ``start``."""
    omega = 2.0 * math.pi * frequency
    room = min(f.high - start, start - f.low) if inwards == 0.0 else 0.1 * (f.high - f.low)
    centre = start + inwards * room
    speed = _speed_limit(centre - room, centre + room, f, limits)
    return min(min(room, speed / omega), limits.acceleration_limit / (omega * omega))


@inline
def _swing(time, frequency, inwards):
    """Sine of amplitude 1 that starts at 0, within the speed and acceleration of a sine.

    It fades in over half a period; at an end of the range it swings between 0 and 2 inwards instead.
    """
    angle = 2.0 * math.pi * frequency * time
    if inwards != 0.0:
        return inwards * (1.0 - math.cos(angle))
    return min(2.0 * frequency * time, 1.0) * math.sin(angle)


@inline
def fill_sine(row, key, start, period, f, limits):
    """One sine about the initial position, or on its inner side if an end of the range is near."""
    frequency = log_within(key, 0, limits.frequency_range)
    inwards = _inwards(start, f)
    amplitude = _largest_sine(start, inwards, frequency, f, limits) * between(key, 1, 0.4, 1.0)
    amplitude = amplitude if uniform(key, 2) < 0.5 or inwards != 0.0 else -amplitude
    for sample in range(len(row)):
        row[sample] = start + amplitude * _swing(sample * period, frequency, inwards)


@inline
def fill_multi_sine(row, key, start, period, f, limits):
    """Four sines of different frequency and sign that share range, speed and acceleration."""
    inwards = _inwards(start, f)
    for sample in range(len(row)):
        row[sample] = start
    for number in range(4):
        frequency = log_within(key, number, limits.frequency_range)
        amplitude = 0.25 * _largest_sine(start, inwards, frequency, f, limits) * between(key, 4 + number, 0.6, 1.0)
        amplitude = amplitude if uniform(key, 8 + number) < 0.5 or inwards != 0.0 else -amplitude
        for sample in range(len(row)):
            row[sample] += amplitude * _swing(sample * period, frequency, inwards)


@inline
def fill_start_stop(row, key, start, period, f, limits):
    """Start–stop: consecutive short runs at constant speed with abrupt ends, towards a far target and back."""
    value, target = start, _farther_end(start, f)
    speed = _speed_limit(f.low, f.high, f, limits) * between(key, 0, 0.5, 1.0)
    running = False
    left = between(key, 1, 0.05, 0.2)
    draw = 2
    for sample in range(len(row)):
        row[sample] = value
        left -= period
        if running:
            value += min(max(target - value, -speed * period), speed * period)
            if abs(value - target) < 1e-12:
                target = f.low if target == f.high else f.high
                left = 0.0
        if left <= 0.0:
            running = not running
            left = between(key, draw, 0.1, 0.35) if running else between(key, draw, 0.1, 0.3)
            draw += 1


@inline
def fill_pause(row, key, start, period, f, limits):
    """A pause until about the last second, then one smooth move (quintic) towards the farther end."""
    target = start + between(key, 0, 0.1, 1.0) * (_farther_end(start, f) - start)
    speed = _speed_limit(start, target, f, limits) * between(key, 1, 0.4, 1.0)
    distance = abs(target - start)
    duration = max(1.875 * distance / speed, math.sqrt(5.774 * distance / limits.acceleration_limit), 2.0 * period)
    begin = max((len(row) - 1) * period - between(key, 2, 0.8, 1.0), 0.05)
    for sample in range(len(row)):
        share = min(max((sample * period - begin) / duration, 0.0), 1.0)
        row[sample] = start + (target - start) * share * share * share * (10.0 + share * (6.0 * share - 15.0))


@inline
def fill_creep(row, key, start, period, f, limits):
    """One slow run at constant speed, 0.5 to 1.5 % of the largest, towards the farther end."""
    target = _farther_end(start, f)
    speed = _speed_limit(f.low, f.high, f, limits) * log_between(key, 0, 0.005, 0.015)
    begin = between(key, 1, 0.05, 0.25)
    for sample in range(len(row)):
        travel = min(max(sample * period - begin, 0.0) * speed, abs(target - start))
        row[sample] = start + (travel if target > start else -travel)


@inline
def fill_staircase(row, key, start, period, f, limits):
    """Small steps of one size, 2.5 to 10 % of the smallest step, back and forth at random times."""
    size = limits.step_range[0] * log_between(key, 0, 0.025, 0.1)
    value, change = start, between(key, 1, 0.05, 0.25)
    draw = 2
    for sample in range(len(row)):
        if sample * period >= change:
            up = uniform(key, draw) < 0.5
            rise = value + size <= f.high if up else value - size < f.low
            value += size if rise else -size
            change += between(key, draw + 1, 0.1, 0.3)
            draw += 2
        row[sample] = value


FAMILIES = {
    "step": fill_step,
    "point_to_point": fill_point_to_point,
    "ramp": fill_ramp,
    "sine": fill_sine,
    "multi_sine": fill_multi_sine,
    "start_stop": fill_start_stop,
    "pause": fill_pause,
    "creep": fill_creep,
    "staircase": fill_staircase,
}
"""The function that writes each family of references; append a new one at the end."""

MOVING_FAMILIES = ("step", "point_to_point", "ramp", "sine", "multi_sine", "start_stop")
"""Families that a task draws unless told otherwise; at the others the axis hardly moves for most of the time."""

REFERENCE_FAMILIES = (*FAMILIES, "user")
"""Families of references; ``user`` is an array given by the user."""

USER_FAMILY = REFERENCE_FAMILIES.index("user")


fill_reference = function_of_number(tuple(FAMILIES.values()), "row, family, key, start, period, f, limits", "family")
"""Write the samples (samples,), m, of one reference; the family ``user`` leaves the row unchanged.

``key`` is that of the source REFERENCE, ``start`` the initial position in m, ``f`` :class:`Feasible`, and ``limits``
the group ``references`` of the task.
"""

RESTING_FROM = list(FAMILIES).index("pause")  # the first family that compiles only when it is drawn or named

fill_usual = function_of_number(
    tuple(FAMILIES.values())[:RESTING_FROM], "row, family, key, start, period, f, limits", "family"
)
"""The same for the families before :data:`RESTING_FROM` alone."""
