"""Settings of the leakage head's training, apart from its windows: a study reads them also where it trains none."""

from __future__ import annotations

import math

from pydantic import ConfigDict, Field

from hydro_agents.detection.head import LARGEST_WIDTH, SHORTEST_WINDOW, check_sensors
from hydro_agents.running.seeds import THRESHOLDS
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.task.configuration import LEAKAGE_LIMIT
from hydro_env.task.law import RigLaw

RISE = 0.05  # part of the training during which the learning rate rises


class HeadTrainingSettings(Group):
    """Settings of the training; ``configs/agents/leakage_head.yaml`` holds those of the studies."""

    model_config = ConfigDict(allow_inf_nan=False)

    law: RigLaw | None = Field(
        None, description="of the rigs of the training, each for a few runs; none: the task's rig"
    )
    episodes: int = Field(6_000, ge=20, le=250_000, description="training runs, over all kinds of operation")
    validation_episodes: int = Field(2_000, ge=20, le=THRESHOLDS.count, description="for thresholds and intervals")
    windows: int = Field(3, ge=1, le=100, description="windows from each run")
    longest: float = Field(4.0, ge=1.0, le=100.0, description="longest window, in episodes of the task")
    healthy_share: float = Field(0.5, gt=0.0, lt=1.0)
    fault_share: float = Field(0.45, ge=0.0, le=1.0, description="share of runs with a fault other than a leak")
    changing_share: float = Field(0.3, ge=0.0, le=1.0, description="runs whose leak begins or grows within the window")
    orifice_share: float = Field(0.06, ge=0.0, le=1.0, description="share of runs with a turbulent leak (orifice)")
    disturbed_share: float = Field(0.15, ge=0.0, le=1.0, description="share of runs with a disturbance")
    lowest_healthy_flow: float = Field(
        0.003, gt=0.0, le=LEAKAGE_LIMIT, description="l/min at 100 bar on the paper's rig; grows with the valve's flow"
    )
    highest_flow: float = Field(5.0, gt=0.0, le=LEAKAGE_LIMIT, description="as well")
    epochs: int = Field(20, ge=0, le=100_000, description="0: a start alone gets new thresholds and intervals")
    batch: int = Field(256, ge=1, le=1_000_000)
    learning_rate: float = Field(3e-3, gt=0.0, le=1.0)
    weight_decay: float = Field(1e-3, ge=0.0, le=1.0)
    size_weight: float = Field(4.0, ge=0.0, le=1e3, description="weight of the size's error relative to the classes")
    dropout: float = Field(0.0, ge=0.0, lt=1.0, description="share of hidden units that are left out in training")
    width: int = Field(128, ge=2, le=LARGEST_WIDTH)
    start: str | None = Field(
        None, description="weights of a head of the same inputs and width to begin with, a path without its ending"
    )

    def check(self, config: TaskConfig) -> None:
        """Check that the training leaks and the window suit a task.

        Raises:
            ConfigurationError: a bound lies on the wrong side of the task's bound, an episode is too short, or the rig
                lacks a sensor.
        """
        check_sensors(config)
        healthy, faulty = config.leakage.class_bounds[0], config.leakage.faulty_range[0]
        wrong = ""
        if config.steps < SHORTEST_WINDOW:
            wrong = f"an episode of {config.steps} control periods is its shortest window: at least {SHORTEST_WINDOW}"
        elif self.lowest_healthy_flow >= healthy:
            wrong = f"lowest_healthy_flow: must be below the task's leakage.class_bounds[0] = {healthy:g} l/min"
        elif self.highest_flow <= faulty:
            wrong = f"highest_flow: must be above the task's leakage.faulty_range[0] = {faulty:g} l/min"
        elif self.changing_share + self.orifice_share + self.disturbed_share > 1.0:
            wrong = "changing_share, orifice_share and disturbed_share: must be at most 1 together"
        elif self.epochs == 0 and self.start is None:
            wrong = "epochs = 0: needs a start, whose thresholds and intervals are set again"
        if wrong:
            raise ConfigurationError(f"leakage_head: {wrong}")

    def learning_rate_at(self, share: float) -> float:
        """Learning rate when a share (0 to 1) of the training is done: a rise, then a cosine down to nearly zero."""
        factor = min(share / RISE, 1.0) * 0.5 * (1.0 + math.cos(math.pi * share))
        return self.learning_rate * max(factor, 1e-3)

    def longest_window(self, config: TaskConfig) -> int:
        """Samples of the longest window."""
        return round(self.longest * config.steps)
