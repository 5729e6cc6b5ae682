"""A small protocol and controllers for its tests."""

import numpy as np

from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_env.folders import config_file

TASK = {"episode_duration": 0.3}
SMALL = {
    "task": TASK,
    "leak_levels": [0.03, 4.0],
    "families": ["step", "sine"],
    "plants": 3,
    "chunk": 5,
    "standstill_plants": 0,
    "conditions": {"plain": {"group": "leak"}, "late": {"task": {"command_latency": 0.004}}},
}


def named(name):
    """A protocol of the project."""
    return RobustnessProtocol.from_yaml(config_file("protocols", name))


def small(**changes):
    return RobustnessProtocol(**{**SMALL, **changes})


class Proportional:
    """Commands in proportion to the error."""

    def __init__(self, gain=30.0):
        self.gain = gain

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return (self.gain * 0.1 * observation[:, [ERROR]]).astype(np.float32), state


def _error_column():
    from hydro_env import ServoHydraulicEnv

    return ServoHydraulicEnv(TASK).observation_names.index("tracking_error")


ERROR = _error_column()
