"""Limit cycles and unrest while the reference stands still.

Under sensor noise every stiff loop moves a little; from such a run nobody can tell the answer to noise from a limit
cycle. Each case therefore runs twice. Without noise, after a small step of the reference, an axis comes to rest unless
it oscillates by itself: what remains is the limit cycle. With noise the run shows unrest, valve travel and offset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from agents.controllers.base import Controller
from agents.evaluation.limit_cycles import find_limit_cycle
from agents.experiments.runs import FIRST_SEED, noiseless, own_reference, run_sweep, working_place
from hydro_env import TaskConfig

STANDSTILL_LEAKS = (0.01, 0.3, 1.0, 4.0, 8.0)
"""l/min at 100 bar."""

PLACES = (0.0, 0.3, -0.3)
"""Where the axis is held: shares of the range that the supply can hold."""

KICK, KICK_SHARE = 0.5, 0.01
"""s until the reference returns from a first step, and the step's share of the range of references."""

SETTLING, JUDGED = 1.5, 6.0
"""s from then on until the axis is judged, and for how long."""


def standstill(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    leaks: Sequence[float] = STANDSTILL_LEAKS,
    plants: int = 8,
    places: Sequence[float] = PLACES,
    first_seed: int = FIRST_SEED,
) -> pd.DataFrame:
    """Hold a position under every controller, once without and once with the noise of the sensors.

    Args:
        config: the task; its plants, sensors and timing count.
        controllers: by name.
        leaks: l/min at 100 bar.
        plants: number of plants, drawn.
        places: shares of the range that the supply of the nominal rig can hold.
        first_seed: seed of the first plant.

    Returns:
        Columns controller, leakage_flow_lpm, seed, place_mm, limit_cycle (an oscillation that lasts without noise and
        exceeds one step of the position sensor), amplitude_um and frequency_hz (without noise), unrest_um (root mean
        square of the position's motion under noise), offset_um (mean of |reference − reading|, frame of the sensor),
        valve_travel_per_s (full strokes), failed.

    Raises:
        ControllerError: a controller raises an exception or returns no finite commands.
    """
    period, floor = config.control_period, config.sensors.position.resolution
    judged = round(JUDGED / period)
    rows = []
    for place in places:
        position = working_place(config.plant, place)
        reference = np.full(round((KICK + SETTLING + JUDGED) / period) + 1, position)
        kicked = reference.copy()
        kicked[round(0.1 / period) : round((0.1 + KICK) / period)] += KICK_SHARE * abs(working_place(config.plant, 1.0))
        still, noisy = own_reference(noiseless(config), kicked), own_reference(config, reference)
        for name, controller in controllers.items():
            sweep = run_sweep(still, controller, leaks, plants, first_seed)
            resting = run_sweep(noisy, controller, leaks, plants, first_seed).rollout
            for case in range(len(sweep.seeds)):
                cycle = find_limit_cycle(sweep.rollout.position[case, -judged:].astype(np.float64), period, floor)
                held = resting.position[case, -judged:].astype(np.float64)
                travel = np.abs(np.diff(resting.spool[case, -judged:].astype(np.float64))).sum()
                rows.append(
                    {
                        **sweep.labels(name, case),
                        "place_mm": 1e3 * position,
                        "limit_cycle": cycle.sustained,
                        "amplitude_um": 1e6 * cycle.amplitude,
                        "frequency_hz": cycle.frequency if cycle.sustained else np.nan,
                        "unrest_um": 1e6 * float(np.std(held)),
                        "offset_um": 1e6 * abs(float(np.mean(held)) + float(resting.position_bias[case]) - position),
                        "valve_travel_per_s": float(travel) / JUDGED,
                        "failed": bool(max(sweep.rollout.failed_at[case], resting.failed_at[case]) >= 0),
                    }
                )
    return pd.DataFrame(rows)
