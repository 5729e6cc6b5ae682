"""Fig. 12: start–stop moves at several leaks, in open loop."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_env import equilibrium, simulate
from hydro_env.task.sensors import Sensors
from paper.rig import LEAKS, PLANT, SAMPLE_TIME, START, VOLTAGE, count, simplified, with_leak
from paper.settling import recorded

MOVES = ((0.25, 1.0), (0.45, 0.0), (0.25, 1.0), (0.45, 0.0), (0.5, -1.0), (0.5, 0.0))
"""s and fraction of VOLTAGE: two moves out and one back, each with a stop after it."""

HELD = 0.1  # s; time at the initial position before the first move
FIRST_STOP = 0.35  # s; the first command to stop
SEED = 12


def start_stop_voltage(holding: float) -> NDArray[np.float64]:
    """The commands in V, one per sample; first the one that holds the start."""
    commands = ((HELD, holding), *((duration, share * VOLTAGE) for duration, share in MOVES))
    return np.concatenate([np.full(count(duration), volts) for duration, volts in commands])


def displacement_table() -> pd.DataFrame:
    """Recorded and true displacement over time for each leak; throttle in parallel, open loop.

    ``friction``: whether there is friction. Every run has the same noise and bias.
    """
    parts = []
    for friction in (True, False):
        for leak in LEAKS:
            plant = with_leak(simplified(PLANT, PLANT.friction.model if friction else "none", True), leak, "throttle")
            _, holding = equilibrium(plant, START)
            run = simulate(plant, start_stop_voltage(holding), SAMPLE_TIME, {"position": START})
            signal = recorded(run.position, Sensors().position, np.random.default_rng(SEED))
            columns = {"friction": friction, "leak_lpm": leak, "time_s": run.time, "command_v": run.voltage}
            positions = {"recorded_position_mm": 1e3 * signal, "true_position_mm": 1e3 * run.position}
            parts.append(pd.DataFrame(columns | positions))
    return pd.concat(parts, ignore_index=True)


def displacement_summary(table: pd.DataFrame) -> pd.DataFrame:
    """Per friction and leak: length of the first move, creep in the 0.4 s after it, swing of the true position, mm.

    The creep goes first towards the start (``back_mm``), then away from it (``forth_mm``).
    """
    rows = []
    for (friction, leak), part in table.groupby(["friction", "leak_lpm"]):
        time, true, signal = (part[name].to_numpy() for name in ("time_s", "true_position_mm", "recorded_position_mm"))
        stopped = np.interp(FIRST_STOP + 0.03, time, true)
        late = (time > FIRST_STOP + 0.40) & (time < FIRST_STOP + 0.44)
        early = (time > FIRST_STOP + 0.04) & (time < FIRST_STOP + 0.09)
        creep = true[(time > FIRST_STOP + 0.03) & (time < FIRST_STOP + 0.44)]
        straight = np.polyval(np.polyfit(time[early], true[early], 2), time[early])
        row = {"friction": friction, "leak_lpm": leak, "move_mm": stopped - true[0], "back_mm": stopped - creep.min()}
        row |= {"forth_mm": true[late].mean() - creep.min(), "swing_mm": np.ptp(true[early] - straight)}
        rows.append(row | {"noise_mm": np.std((signal - true)[time < HELD])})
    return pd.DataFrame(rows)
