"""Changes of a task that experiments and standstills share: a reference of their own, sensors without noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import CHANNELS


def own_reference(config: TaskConfig, reference: NDArray[np.float64]) -> TaskConfig:
    """The task with a reference (T + 1,), m, one value per period from the start; leak and force stay constant."""
    return task_config(
        config,
        episode_duration=(len(reference) - 1) * config.control_period,
        references={"user": [float(value) for value in reference], "weights": {"user": 1.0}},
        disturbance={"kind": "none"},
        leakage={"schedule": "constant"},
    )


def noiseless(config: TaskConfig) -> TaskConfig:
    """The task without the noise of the sensors; their bias and 16-bit steps stay."""
    return task_config(config, sensors={channel: {"noise": 0.0} for channel in CHANNELS})
