"""Changes of a task that experiments share: constant conditions, a given reference, no noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import CHANNELS


def steady(config: TaskConfig) -> TaskConfig:
    """The task with leak, faults and external force constant during an episode."""
    return task_config(
        config,
        disturbance={"kind": "none"},
        leakage={"schedule": "constant"},
        faults={kind: {"schedule": "constant"} for kind in type(config.faults).model_fields},
    )


def own_reference(config: TaskConfig, reference: NDArray[np.float64]) -> TaskConfig:
    """The :func:`steady` task with a given reference (T + 1,), m, one value per period from the start."""
    return task_config(
        steady(config),
        episode_duration=(len(reference) - 1) * config.control_period,
        references={"user": [float(value) for value in reference], "weights": {"user": 1.0}},
    )


def noiseless(config: TaskConfig) -> TaskConfig:
    """The task without sensor noise; the sensors keep their bias and 16-bit steps."""
    return task_config(config, sensors={channel: {"noise": 0.0} for channel in CHANNELS})
