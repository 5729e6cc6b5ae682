"""A recording of a simulated axis for tests: time (n,), s, and signals (5, n), SI."""

from functools import cache

import numpy as np

from hydro_agents.learning.opponents import shipped
from hydro_agents.recordings.recording import Recording, read_recording
from hydro_agents.recordings.simulated import record_axis
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config

SEED = VALIDATION_SEEDS.start + 5


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
