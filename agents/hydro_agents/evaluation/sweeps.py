"""The skeleton of all experiments: a controller on the same plants at several leaks; with fits of sines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, Observation
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_env import TaskConfig
from hydro_env.task.signals import observation_layout
from hydro_env.types import Floats

LEAKS = (0.01, 1.0, 4.0)  # l/min at 100 bar: a tight seal, the bound between moderate and severe, a severe leak


Play = Callable[..., Rollout]
"""Runs the controller of an experiment in a task; with ``hidden=True`` it does not see the preview."""


class Experiment(NamedTuple):
    """An experiment with a controller in the loop, on the same plants at every leak."""

    steps: Callable[[TaskConfig, Play], Iterable[Mapping[str, Any]]]  # columns of each step, each (N,) or one value
    leaks: Sequence[float] = LEAKS  # l/min at 100 bar
    plants: int = 4

    def __call__(self, config: TaskConfig, controller: Controller) -> pd.DataFrame:
        """Run the controller on the same plants at every leak.

        Args:
            config: the task, for its plants, sensors and timing.
            controller: the controller.

        Returns:
            One row per step, leak and plant: leakage_flow_lpm, seed, and the columns of the experiment.

        Raises:
            ControllerError: the controller raises an exception or returns no finite commands.
        """
        seeds, leaks = EXPERIMENT_AXES.take(self.plants), np.repeat(self.leaks, self.plants)
        cases = Cases(np.tile(seeds, len(self.leaks)), leaks)

        def play(task: TaskConfig, hidden: bool = False) -> Rollout:
            return run_cases(task, HiddenPreview(controller, config) if hidden else controller, cases)

        known = {"leakage_flow_lpm": leaks, "seed": cases.seeds}
        return pd.concat([pd.DataFrame({**known, **step}) for step in self.steps(config, play)], ignore_index=True)


def sine_fit(values: Observation, time: Floats, frequency: float) -> tuple[NDArray[np.complex128], Floats]:
    """Least-squares fit of offset + drift · t + Re(amplitude · exp(j 2π f t)) to rows of samples.

    Args:
        values: (N, T).
        time: (T,), s.
        frequency: Hz.

    Returns:
        Complex amplitudes (N,), and the root mean square of the residual (N,).
    """
    angle = 2.0 * np.pi * frequency * time
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(time), time - time.mean()], axis=1)
    rows = np.asarray(values, dtype=np.float64)
    fit, *_ = np.linalg.lstsq(basis, rows.T, rcond=None)
    rest: Floats = np.sqrt(np.mean((rows - (basis @ fit).T) ** 2, axis=1))
    return fit[0] - 1j * fit[1], rest


class HiddenPreview:
    """A controller without preview: each previewed value equals the present reference."""

    def __init__(self, controller: Controller, config: TaskConfig) -> None:
        self.controller = controller
        self.hidden = [name.startswith("reference_preview_") for name in observation_layout(config)[0]]

    def predict(
        self, observation: Observation, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], Any]:
        """Commands of the controller; see :class:`~hydro_agents.controllers.base.Controller`."""
        return self.controller.predict(
            np.where(self.hidden, 0.0, observation).astype(observation.dtype), state, episode_start, deterministic
        )
