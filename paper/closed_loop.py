"""Position loops with a proportional controller: runs of the nonlinear plant, largest stable gain, speed."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from hydro_agents.controllers.sampled_loop import (
    COMMAND_LATENCY,
    CONTROL_PERIOD,
    SampledLoop,
    places_in_reach,
    sampled_loop,
    speed_per_command,
)
from hydro_agents.report.leaks import FINE_ABOVE, TIGHT
from hydro_env import HydroError, PlantParameters, equilibrium, simulate
from hydro_env.plant.linearisation import linearise
from hydro_env.plant.states import STATE_NAMES
from hydro_env.units import FULL_VOLTAGE
from paper.rig import LAWS, Rig, with_leak

Array = NDArray[np.float64]

GAIN_MARGIN = 2.0
"""Gain margin: largest stable gain over the gain in use."""

SETTLED_SHARE = 0.02
"""Relative deviation from the final value within which a step response counts as settled."""

LONGEST_SETTLING = 10.0
"""s; a response that settles later has no settling time."""

INNER = 1e-3
"""s; sample time of the plant in a loop. Control period and latency are multiples of it."""


def loop_at(parameters: PlantParameters, position: float) -> SampledLoop | None:
    """The linearised loop at a position, or None if the position cannot be held."""
    try:
        return sampled_loop(parameters, position)
    except HydroError:
        return None


@lru_cache(maxsize=8)
def sensible_gain(rig: Rig) -> float:
    """Gain (command per metre, 1 = 10 V): the largest stable one over the whole reach with a tight seal, over a margin.

    Raises:
        HydroError: no gain is stable, or no gain is too large.
    """
    plant = with_leak(rig.parameters, TIGHT, "laminar")
    loops = [loop for loop in (loop_at(plant, place) for place in places_in_reach(plant)) if loop is not None]
    limit = min((loop.largest_stable_gain() for loop in loops), default=0.0)
    if not 0.0 < limit < float("inf"):
        raise HydroError(f"no sensible gain: the largest stable one of the position loop is {limit:g} per metre")
    return limit / GAIN_MARGIN


def bandwidth(loop: SampledLoop, gain: float) -> float:
    """Frequency in Hz where the gain from reference to position first falls 3 dB below its value at rest, or NaN."""
    nyquist = 0.5 / loop.control_period
    frequencies = np.geomspace(1e-4, 0.999, 1200) * nyquist
    size = np.abs(loop.response(gain, frequencies)) / loop.final_value(gain)
    below = np.flatnonzero(size < np.sqrt(0.5))
    if len(below) == 0 or below[0] == 0:
        return float("nan")
    last = below[0] - 1
    share = (size[last] - np.sqrt(0.5)) / (size[last] - size[last + 1])
    return float(frequencies[last] * (frequencies[last + 1] / frequencies[last]) ** share)


def settling_time(loop: SampledLoop, gain: float, longest: float = LONGEST_SETTLING) -> float:
    """Time in s after a small step until the linear loop stays within 2 % of its final value; NaN if too long."""
    response = loop.step_response(gain, round(longest / loop.control_period))
    final = loop.final_value(gain)
    outside = np.flatnonzero(np.abs(response - final) > SETTLED_SHARE * final)
    if len(outside) and outside[-1] >= len(response) - 2:
        return float("nan")
    return float((outside[-1] + 1) * loop.control_period) if len(outside) else 0.0


Control = Callable[[float, float], float]
"""Reference and position in m → command (1 = 10 V)."""


def proportional(gain: float, offset: float = 0.0) -> Control:
    """Command = gain (per metre) · (reference − position) + offset, within ±1."""
    return lambda reference, position: float(np.clip(gain * (reference - position) + offset, -1.0, 1.0))


def closed_loop_run(
    parameters: PlantParameters,
    reference: ArrayLike,
    control: Control,
    start: float,
    deviation: float = 0.0,
    latency: float = COMMAND_LATENCY,
    sample_time: float = INNER,
) -> pd.DataFrame:
    """Simulate the nonlinear plant in a sampled position loop; one row per sample, including the end.

    Args:
        parameters: the plant.
        reference: m, one value per control period, shape (n,).
        control: the controller, called once per control period.
        start: m, initial position, at rest.
        deviation: m, added to the initial position.
        latency: s, until a command acts.
        sample_time: s; control period and latency are multiples of it.

    Returns:
        ``time_s``, ``reference_m``, ``position_m``, ``command`` (1 = 10 V).
    """
    targets = np.asarray(reference, dtype=np.float64)
    state, holding = equilibrium(parameters, start)
    state, before = state | {"position": start + deviation}, holding / FULL_VOLTAGE
    per_period, late = round(CONTROL_PERIOD / sample_time), round(latency / sample_time)
    positions, commands = [np.array([state["position"]])], []
    for target in targets:
        command = control(float(target), state["position"])
        acting = np.repeat([before, command], [late, per_period - late])
        run = simulate(parameters, FULL_VOLTAGE * acting, sample_time, state)
        positions.append(run.position[1:])
        commands.append(acting)
        state = dict(zip(STATE_NAMES, run.states[-1].tolist(), strict=True))
        before = command
    held, acting = np.repeat(targets, per_period), np.concatenate(commands)
    return pd.DataFrame(
        {
            "time_s": sample_time * np.arange(len(held) + 1),
            "reference_m": np.append(held, held[-1]),
            "position_m": np.concatenate(positions),
            "command": np.append(acting, acting[-1]),
        }
    )


def limit_table(rig: Rig, leaks: tuple[float, ...] = FINE_ABOVE) -> pd.DataFrame:
    """Largest stable gain by law, leak and position, and the speed of the loop at lower gains.

    ``limit_per_m`` in command (1 = 10 V) per metre; ``continuous_limit_per_m`` = 2 ζ ω over the speed per command: no
    sampling, no latency, an ideal valve (Merritt 1967). NaN where the position cannot be held. ``gain_per_m`` is the
    smallest limit over the positions at this leak, divided by the gain margin; ``bandwidth_hz``, ``settling_s`` (2 % of
    a small step) and ``velocity_gain_per_s`` are those of the loop at this place with that gain.

    Raises:
        HydroError: no gain is too large anywhere.
    """
    rows = []
    for law in LAWS:
        for leak in leaks:
            plant = with_leak(rig.parameters, leak, law)
            loops = {place: loop_at(plant, place) for place in places_in_reach(rig.parameters)}
            limits = {place: loop.largest_stable_gain() if loop else math.nan for place, loop in loops.items()}
            known = [limit for limit in limits.values() if math.isfinite(limit) and limit > 0.0]
            gain = min(known) / GAIN_MARGIN if known else math.nan
            for place, loop in loops.items():
                row = {"law": law, "leak_lpm": leak, "position_mm": 1e3 * place, "limit_per_m": limits[place]}
                row |= {"continuous_limit_per_m": _continuous_limit(plant, place), "gain_per_m": gain}
                speed = bandwidth_here = settling = math.nan
                if loop is not None and math.isfinite(gain):
                    bandwidth_here, settling = bandwidth(loop, gain), settling_time(loop, gain)
                    speed = gain * speed_per_command(plant, place)
                rows.append(
                    row | {"bandwidth_hz": bandwidth_here, "settling_s": settling, "velocity_gain_per_s": speed}
                )
    table = pd.DataFrame(rows)
    if not np.isfinite(table["limit_per_m"]).any():
        raise HydroError("no gain up to 1e6 per metre makes the position loop unstable anywhere: there is no limit")
    return table


def _continuous_limit(plant: PlantParameters, place: float) -> float:
    try:
        mode = linearise(plant.replace(friction={"model": "none"}), position=place).hydraulic_mode
        return 2.0 * mode.damping_ratio * mode.natural_frequency / speed_per_command(plant, place)
    except (ArithmeticError, HydroError):  # overdamped, or the position cannot be held
        return math.nan


def achievable(table: pd.DataFrame) -> pd.DataFrame:
    """Per law and leak, with one gain for the whole reach: the worst bandwidth, settling time and velocity gain.

    It uses only positions that can be held with every leak; all leaks are therefore compared at the same positions.
    """
    held = table.groupby("position_mm")["limit_per_m"].transform(lambda limits: limits.notna().all())
    judged = table[held] if held.any() else table
    worst = {"limit_per_m": "min", "gain_per_m": "first", "bandwidth_hz": "min", "settling_s": "max"}
    return judged.groupby(["law", "leak_lpm"], sort=False).agg(worst | {"velocity_gain_per_s": "min"}).reset_index()
