"""Limit cycles and residual motion at a constant reference.

With sensor noise every stiff loop moves a little, and its response to noise looks like a limit cycle. Each case
therefore runs twice. Without noise, an axis comes to rest after a small step of the reference unless it oscillates by
itself: the remaining motion is the limit cycle. The run with noise gives residual motion, valve travel and offset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.limit_cycles import find_limit_cycle
from hydro_agents.evaluation.sweeps import run_sweep, working_place
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.running.tasks import noiseless, own_reference
from hydro_env import TaskConfig

STANDSTILL_LEAKS = (0.01, 0.3, 1.0, 4.0, 8.0)
"""l/min at 100 bar."""

PLACES = (0.0, 0.3, -0.3)
"""Held positions: shares of the range that the supply can hold."""

KICK, KICK_SHARE = 0.5, 0.01
"""s until the reference returns from a first step, and the step's share of the range of references."""

SETTLING, JUDGED = 1.5, 6.0
"""s from then until the evaluation, and length of the evaluation."""


def standstill(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    leaks: Sequence[float] = STANDSTILL_LEAKS,
    plants: int = 8,
    places: Sequence[float] = PLACES,
    first_seed: int = EXPERIMENT_AXES.first,
) -> pd.DataFrame:
    """Hold a position under every controller, once without and once with the noise of the sensors.

    Args:
        config: the task, for its plants, sensors and timing.
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
    tables = []
    for place in places:
        position = working_place(config.plant, place)
        reference = np.full(round((KICK + SETTLING + JUDGED) / period) + 1, position)
        kicked = reference.copy()
        kicked[round(0.1 / period) : round((0.1 + KICK) / period)] += KICK_SHARE * abs(working_place(config.plant, 1.0))
        still, noisy = own_reference(noiseless(config), kicked), own_reference(config, reference)
        for name, controller in controllers.items():
            sweep = run_sweep(still, controller, leaks, plants, first_seed)
            resting = run_sweep(noisy, controller, leaks, plants, first_seed).rollout
            cycles = [find_limit_cycle(row, period, floor) for row in sweep.rollout.position[:, -judged:]]
            sustained = np.array([cycle.sustained for cycle in cycles])
            held = resting.position[:, -judged:].astype(np.float64)
            spool = resting.spool[:, -judged:].astype(np.float64)
            columns = {
                "place_mm": 1e3 * position,
                "limit_cycle": sustained,
                "amplitude_um": [1e6 * cycle.amplitude for cycle in cycles],
                "frequency_hz": np.where(sustained, [cycle.frequency for cycle in cycles], np.nan),
                "unrest_um": 1e6 * held.std(axis=1),
                "offset_um": 1e6 * np.abs(held.mean(axis=1) + resting.position_bias - position),
                "valve_travel_per_s": np.abs(np.diff(spool, axis=1)).sum(axis=1) / JUDGED,
                "failed": np.maximum(sweep.rollout.failed_at, resting.failed_at) >= 0,
            }
            tables.append(sweep.table(name, **columns))
    return pd.concat(tables, ignore_index=True)
