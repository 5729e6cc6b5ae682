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
    "worst": 2,
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


class Broken:
    """Returns NaN on one axis where the latency is 4 ms, which it notices by its own count of calls."""

    def __init__(self, answer=np.nan, after=2):
        self.answer, self.after = answer, after

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        step = 0 if state is None else state
        command = np.zeros((len(observation), 1))
        if step >= self.after:
            command[-1] = self.answer
        return command, step + 1


def _error_column():
    from hydro_env import ServoHydraulicEnv

    return ServoHydraulicEnv(TASK).observation_names.index("tracking_error")


ERROR = _error_column()
