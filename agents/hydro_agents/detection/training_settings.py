"""Settings of the leakage head's training, apart from its windows: a study reads them also where it trains none."""

import math

from pydantic import ConfigDict, Field

from hydro_agents.detection.head import LARGEST_WIDTH, SHORTEST_WINDOW, check_sensors
from hydro_agents.running.seeds import THRESHOLDS
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.task.law import RigLaw

RISE = 0.05  # part of the training during which the learning rate rises

LEAST_LEAK, LARGEST_LEAK = 0.003, 5.0  # l/min at 100 bar on the paper's rig; they grow with the valve's flow


class HeadTrainingSettings(Group):
    """Settings of the training; ``configs/agents/leakage_head.yaml`` holds those of the studies."""

    model_config = ConfigDict(allow_inf_nan=False)

    law: RigLaw | None = None  # of the rigs of the training, each for a few runs; none: the task's
    episodes: int = Field(6_000, ge=20, le=250_000)  # training runs, over all kinds of operation
    validation_episodes: int = Field(2_000, ge=20, le=THRESHOLDS.count)  # for thresholds and intervals
    longest: float = Field(4.0, ge=1.0, le=100.0)  # longest window, in episodes of the task
    fault_share: float = Field(0.45, ge=0.0, le=1.0)  # share of runs with a fault other than a leak
    epochs: int = Field(20, ge=1, le=100_000)
    batch: int = Field(256, ge=1, le=1_000_000)
    learning_rate: float = Field(3e-3, gt=0.0, le=1.0)
    dropout: float = Field(0.0, ge=0.0, lt=1.0)  # share of hidden units that are left out in training
    width: int = Field(128, ge=2, le=LARGEST_WIDTH)

    def check(self, config: TaskConfig) -> None:
        """Check that the training leaks and the window suit a task.

        Raises:
            ConfigurationError: a bound lies on the wrong side of the task's bound, an episode is too short, or the rig
                lacks a sensor.
        """
        check_sensors(config)
        healthy, faulty = config.leakage.class_bounds[0], config.leakage.faulty_range[0]
        if config.steps < SHORTEST_WINDOW:
            window = f"an episode of {config.steps} control periods is its shortest window"
            raise ConfigurationError(f"leakage_head: {window}: at least {SHORTEST_WINDOW}")
        if not (healthy > LEAST_LEAK and faulty < LARGEST_LEAK):
            raise ConfigurationError(
                f"leakage_head: trains on leaks of {LEAST_LEAK:g} to {LARGEST_LEAK:g} l/min: the task's "
                f"leakage.class_bounds[0] = {healthy:g} and faulty_range[0] = {faulty:g} must lie within"
            )

    def learning_rate_at(self, share: float) -> float:
        """Learning rate when a share (0 to 1) of the training is done: a rise, then a cosine down to nearly zero."""
        factor = min(share / RISE, 1.0) * 0.5 * (1.0 + math.cos(math.pi * share))
        return self.learning_rate * max(factor, 1e-3)

    def longest_window(self, config: TaskConfig) -> int:
        """Samples of the longest window."""
        return round(self.longest * config.steps)
