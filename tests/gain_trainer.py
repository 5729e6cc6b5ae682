"""A proportional controller whose gain is "trained", and controllers that hold still or break."""

import json
from typing import ClassVar

import numpy as np

from hydro_env.files import Group


class Settings(Group):
    gain: float = 3.0
    total_steps: int = 2


class Gain:
    def __init__(self, gain):
        self.gain = gain

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return self.gain * observation[:, -2:-1], state

    def save(self, path):
        path.with_suffix(".json").write_text(json.dumps(self.gain))
        return path


class Trainer:
    """Notes its calls; its fate is to finish, or to be stopped before or after its first checkpoint."""

    settings = Settings
    calls: ClassVar[list] = []
    fate = "finish"

    def train(self, config, settings, *, seed, folder, resume, base, progress):
        self.calls.append({"seed": seed, "resume": resume, "base": base, "steps": settings.total_steps})
        if self.fate == "early":
            raise KeyboardInterrupt
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "checkpoint.json").write_text("{}")
        if self.fate == "late":
            raise KeyboardInterrupt
        return Gain(settings.gain)

    def load(self, path):
        return Gain(json.loads(path.with_suffix(".json").read_text()))


class Still:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return 0.0 * observation[:, :1], state


class Broken:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 1), np.nan), None
