"""Recordings for tests: of a simulated axis, time (n,), s, and signals (5, n), SI; and of a real ram."""

from functools import cache
from pathlib import Path

import numpy as np

from hydro_agents.learning.loading import shipped
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.simulated import record_axis

SEED = VALIDATION_SEEDS.start + 5

RAM = Path(__file__).parent / "recorded_elsewhere" / "mbari_ram.csv"
RAM_RIG = RAM.with_suffix(".yaml")
PUMP = -0.30 * 16.387064e-3  # l per revolution; the sign is that of the flow into the upper chamber
RAM_COLUMNS = {
    "time": "time",
    "command": {"column": "pump", "unit": "1", "gain": 1e-4},
    "position": {"column": "position", "unit": "mm", "offset": -1000.0},
    "pressure_a": "upper",
    "pressure_b": "lower",
    "flow": {"column": "pump", "unit": "l/min", "gain": PUMP},
}


def recorded_file(path, config=None, leakage=0.01, family="sine", faults=None, seed=SEED, duration=6.0):
    """Record an axis under the shipped PID."""
    config = task_config(config, episode_duration=duration)
    return record_axis(path, config, shipped("pid", config), seed, leakage, family, faults, note="a test")


@cache
def healthy(folder) -> Recording:
    """A healthy axis, 6 s of a sine."""
    recorded_file(folder / "healthy.csv")
    return read_recording(folder / "healthy.csv")


def changed(recording, time=None, signals=None, units=None):
    """The recording with other time stamps or signals."""
    return Recording(
        "changed",
        recording.time if time is None else np.asarray(time),
        recording.signals if signals is None else np.asarray(signals),
        units or recording.units,
        [],
    )


CONFIG = TaskConfig()
