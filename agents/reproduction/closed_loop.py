"""The nonlinear plant in a sampled position loop, as the paper's rig has it, and the gain that the figures use."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from agents.controllers.sampled_loop import COMMAND_LATENCY, CONTROL_PERIOD, FULL_COMMAND, SampledLoop, sampled_loop
from agents.reproduction.rig import Rig, with_leak
from hydro_env import HydroError, PlantParameters, equilibrium, simulate
from hydro_env.plant.states import STATE_NAMES

Array = NDArray[np.float64]

TIGHT = 0.01
"""l/min at 100 bar; a new seal."""

GAIN_MARGIN = 2.0
"""Largest stable gain over the gain used."""

PLACES = 5
SETTLED_SHARE = 0.02
"""Part of the final value within which a step response counts as settled."""

LONGEST_SETTLING = 10.0
"""s; what settles later has no settling time."""

INNER = 1e-3
"""s; period and latency are multiples of it."""

TIMING = f"position sampled every {1e3 * CONTROL_PERIOD:g} ms, command {1e3 * COMMAND_LATENCY:g} ms late"


def places(rig: Rig) -> tuple[float, ...]:
    """Positions in m over the reach, ends included."""
    low, high = rig.reach
    return tuple(low + (high - low) * part / (PLACES - 1) for part in range(PLACES))


def loop_at(parameters: PlantParameters, position: float) -> SampledLoop | None:
    """The linearised loop at a position, or None where it cannot be held."""
    try:
        return sampled_loop(parameters, position)
    except HydroError:
        return None


@lru_cache(maxsize=8)
def sensible_gain(rig: Rig) -> float:
    """Command (1 = 10 V) per metre: the largest gain stable over the whole reach with a tight seal, over the margin.

    Raises:
        HydroError: no gain is stable, or no gain is too large.
    """
    plant = with_leak(rig.parameters, TIGHT, "laminar")
    loops = [loop for loop in (loop_at(plant, place) for place in places(rig)) if loop is not None]
    limit = min((loop.largest_stable_gain() for loop in loops), default=0.0)
    if not 0.0 < limit < float("inf"):
        raise HydroError(f"no sensible gain: the largest stable one of the position loop is {limit:g} per metre")
    return limit / GAIN_MARGIN


def bandwidth(loop: SampledLoop, gain: float) -> float:
    """Frequency in Hz at which reference to position first falls below 1/√2 of its value at rest; NaN if nowhere."""
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
    """Time in s after a small step until the linear loop stays within 2 % of its final value; NaN if not in time."""
    response = loop.step_response(gain, round(longest / loop.control_period))
    final = loop.final_value(gain)
    outside = np.flatnonzero(np.abs(response - final) > SETTLED_SHARE * final)
    if len(outside) and outside[-1] >= len(response) - 2:
        return float("nan")
    return float((outside[-1] + 1) * loop.control_period) if len(outside) else 0.0


def closed_loop_run(
    parameters: PlantParameters,
    reference: ArrayLike,
    gain: float,
    start: float,
    offset: float = 0.0,
    deviation: float = 0.0,
) -> pd.DataFrame:
    """The nonlinear plant under command = gain · (reference − position) + offset; one row per millisecond.

    Args:
        parameters: the plant.
        reference: m, one value per control period, shape (n,).
        gain: command (1 = 10 V) per metre.
        start: m; at rest there.
        offset: constant part of the command.
        deviation: m; the position is put off by it at the start.

    Returns:
        ``time_s``, ``reference_m``, ``position_m``, ``command``; 5 rows per period and the end.
    """
    targets = np.asarray(reference, dtype=np.float64)
    state, holding = equilibrium(parameters, start)
    state, before = state | {"position": start + deviation}, holding / FULL_COMMAND
    per_period, late = round(CONTROL_PERIOD / INNER), round(COMMAND_LATENCY / INNER)
    positions, commands = [np.array([state["position"]])], []
    for target in targets:
        command = float(np.clip(gain * (target - state["position"]) + offset, -1.0, 1.0))
        acting = np.repeat([before, command], [late, per_period - late])
        run = simulate(parameters, FULL_COMMAND * acting, INNER, state)
        positions.append(run.position[1:])
        commands.append(acting)
        state = dict(zip(STATE_NAMES, run.states[-1].tolist(), strict=True))
        before = command
    held = np.repeat(targets, per_period)
    acting = np.concatenate(commands)
    return pd.DataFrame(
        {
            "time_s": INNER * np.arange(len(held) + 1),
            "reference_m": np.append(held, held[-1]),
            "position_m": np.concatenate(positions),
            "command": np.append(acting, acting[-1]),
        }
    )
