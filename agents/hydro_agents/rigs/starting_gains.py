"""Gains of a PID from the figures of a rig: where the search for tuned gains begins on another rig."""

from __future__ import annotations

from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.sampled_loop import places_in_reach
from hydro_agents.rigs.check import beyond_dead_band, worst_gain
from hydro_env import TaskConfig
from hydro_env.files import Group
from hydro_env.plant.analysis import speed_limits

SHARE_OF_STABLE = 0.5
"""Proportional gain over the largest stable one: a gain margin of 6 dB."""

INTEGRAL_SHARE = 0.1
"""Rate of the integral over the crossover frequency: it costs 6° of phase there."""


def pid_from_figures(task: TaskConfig) -> PIDGains | None:
    """Half of the largest stable gain, and the inverse of the no-load speeds as feed-forward; no derivative.

    Args:
        task: the task; its plant, control period and latency count.

    Returns:
        The gains, or ``None`` if no gain makes the loop unstable, or each gain does.
    """
    plant = beyond_dead_band(task.plant)
    stable = worst_gain(plant, places_in_reach(task.plant), task.control_period, task.command_latency)
    out, back = speed_limits(plant)
    if not isinstance(stable, float) or stable <= 0.0 or min(out, back) <= 0.0:
        return None
    proportional = SHARE_OF_STABLE * stable
    crossover = proportional * 0.5 * (out + back)
    return PIDGains(
        proportional=proportional,
        integral=INTEGRAL_SHARE * crossover * proportional,
        feedforward_extending=1.0 / out,
        feedforward_retracting=1.0 / back,
        lead_in_integral=False,
    )


def stable_start(task: TaskConfig, given: Group) -> Group:
    """The given gains; for a PID whose gains would make the position loop unstable, those from the rig's figures."""
    if not isinstance(given, PIDGains):
        return given
    own = pid_from_figures(task)
    return own if own is not None and given.proportional > own.proportional / SHARE_OF_STABLE else given
