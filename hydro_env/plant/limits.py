"""What the state may not pass, and when the right-hand side is about to change its course.

The spool has its stroke and its slew limit, oil its vapour pressure: :func:`hold_limits` keeps them exactly. Where
one of them is met or left, or where friction turns round, the solution has a kink. A Runge–Kutta step across a kink
loses its order, and its own error estimate does not always notice; :func:`time_to_kink` says how long the next step
may be so that it ends there instead.
"""

from __future__ import annotations

import math

from hydro_env.compiling import inline
from hydro_env.plant.equations import VAPOUR_PRESSURE, State

FAR = 1e9
"""s; no kink ahead."""

GRAZING = 0.3
"""A motion that covers 1 / (1 + GRAZING) of the way to a limit before it turns may yet meet it."""

SHORTEST = 1e-6
"""s; kinks are met no more exactly than this."""


@inline
def hold_limits(s, c):
    """The state with its hard limits held exactly: spool stroke and slew, vapour pressure.

    The derivative stops at these limits; a step passes them by a fraction of itself, which this takes back.
    """
    return State(
        s.position,
        s.velocity,
        max(s.pressure_a, VAPOUR_PRESSURE),
        max(s.pressure_b, VAPOUR_PRESSURE),
        min(max(s.spool_position, -1.0), 1.0),
        min(max(s.spool_velocity, -c.slew_limit), c.slew_limit),
        s.coil_current,
        s.supply_pressure,
        s.gas_volume,
        s.bristle_deflection,
    )


@inline
def _time_to_cover(distance, rate, change):
    """First time t > 0 with rate t + change t²/2 = distance (≥ 0), s; :data:`FAR` if there is none.

    Where the motion turns back just before, the time of turning: the extrapolation may be wrong by that little.
    """
    under_root = rate * rate + 2.0 * change * distance
    divisor = rate + math.sqrt(max(under_root, 0.0))
    grazing = under_root < 0.0 and under_root > -GRAZING * rate * rate and rate > 0.0
    crossing = 2.0 * distance / divisor if under_root >= 0.0 and divisor > 0.0 else FAR
    return -rate / change if grazing else crossing


@inline
def time_to_kink(s, rate, c):
    """Time in s to the next kink, by extrapolation from the state ``s`` and its derivative ``rate``; at least 1 µs.

    Kinks: the spool meets or leaves its slew limit or its stroke; a chamber begins to cavitate; the piston reverses
    (there dry friction changes over the few mm/s of its transition velocity, which a long step would leap over).
    """
    way = 1.0 if s.spool_velocity >= 0.0 else -1.0
    pull = c.spool_stiffness * (c.spool_gain * s.coil_current - s.spool_position) - c.spool_damping * s.spool_velocity
    jerk = c.spool_stiffness * (c.spool_gain * rate.coil_current - rate.spool_position)
    jerk -= c.spool_damping * rate.spool_velocity
    to_slew = c.slew_limit - way * s.spool_velocity
    slewing = to_slew <= 0.0
    # At the limit the spool leaves it when what pulls it has faded; before, when its speed has grown so far.
    fading = -c.coil_rate * c.spool_stiffness * c.spool_gain * rate.coil_current
    slew = _time_to_cover(
        way * pull if slewing else to_slew,
        -way * jerk if slewing else way * pull,
        -way * fading if slewing else way * jerk,
    )
    slew = FAR if slewing and way * pull <= 0.0 else slew
    # The same for the stroke: left when the speed has turned, met when the rest of the way is covered.
    to_end = 1.0 - way * s.spool_position
    ended = to_end <= 0.0
    stroke = _time_to_cover(
        way * s.spool_velocity if ended else to_end,
        -way * rate.spool_velocity if ended else way * s.spool_velocity,
        0.0 if ended else way * rate.spool_velocity,
    )
    over_a = s.pressure_a - VAPOUR_PRESSURE
    over_b = s.pressure_b - VAPOUR_PRESSURE
    cavitation_a = over_a / -rate.pressure_a if rate.pressure_a < 0.0 and over_a > 0.0 else FAR
    cavitation_b = over_b / -rate.pressure_b if rate.pressure_b < 0.0 and over_b > 0.0 else FAR
    # Up to twice the transition velocity, then one transition velocity at a time.
    speed = abs(s.velocity) * c.inverse_transition_velocity
    turning = s.velocity * rate.velocity < 0.0 or speed < 2.0
    change = abs(rate.velocity) * c.inverse_transition_velocity
    reversal = max(speed - 2.0, 1.0) / change if turning and change > 0.0 else FAR
    nearest = min(min(slew, stroke), min(min(cavitation_a, cavitation_b), reversal))
    return max(nearest, SHORTEST)


@inline
def valid_limits(end_stop_position, slew_limit, volume_b0, area_a, area_b, supply_dynamics, accumulator_volume):
    """Lowest and highest value of each state for which the model holds, as two tuples in the order of State.

    Pressures end where a steel cylinder does (2000 bar); the accumulator must hold gas and oil; the piston may press
    into an end stop by half of what the dead volume allows. Arguments as in
    :class:`~hydro_env.plant.equations.Coefficients`.
    """
    dead_volume = volume_b0 - area_b * end_stop_position
    reach = end_stop_position + 0.5 * dead_volume / max(area_a, area_b)
    slew = slew_limit * (1.0 + 1e-9)
    most_gas = accumulator_volume * 1.001 if supply_dynamics > 0.0 else 1e300
    floor = VAPOUR_PRESSURE * (1.0 + 1e-9)
    return (
        (-reach, -20.0, floor, floor, -1.000000001, -slew, -1e4, floor, 1e-12, -1.0),
        (reach, 20.0, 2e8, 2e8, 1.000000001, slew, 1e4, 2e8, most_gas, 1.0),
    )
