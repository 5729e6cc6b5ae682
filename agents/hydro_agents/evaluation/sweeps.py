"""The skeleton of all experiments: controllers on the same plants at several leaks; with fits of sines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, Observation
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_env import TaskConfig
from hydro_env.task.signals import observation_layout
from hydro_env.types import Floats

LEAKS = (0.01, 1.0, 4.0)  # l/min at 100 bar: a tight seal, the bound between moderate and severe, a severe leak


class Run(NamedTuple):
    """What every controller does in a step of an experiment, on the same plants at every leak."""

    tasks: tuple[TaskConfig, ...]  # the controller runs each of them
    measure: Callable[..., Mapping[str, Any]]  # of the rollouts: further columns of the table, each (N,) or one value
    hidden_preview: bool = False


class Experiment(NamedTuple):
    """An experiment with a controller in the loop: a list of runs, as rows of one table."""

    runs: Callable[..., Iterable[Run]]  # from the task and further arguments
    leaks: Sequence[float] = LEAKS  # l/min at 100 bar
    plants: int = 4
    finish: Callable[[pd.DataFrame], pd.DataFrame] | None = None  # completes the table

    def __call__(
        self,
        config: TaskConfig,
        controllers: Mapping[str, Controller],
        leaks: Sequence[float] | None = None,
        plants: int | None = None,
        first_seed: int = EXPERIMENT_AXES.first,
        **options: Any,
    ) -> pd.DataFrame:
        """Run every controller on the same plants at every leak.

        Args:
            config: the task, for its plants, sensors and timing.
            controllers: by name.
            leaks: l/min at 100 bar; default: those of the experiment.
            plants: number of plants, drawn; default: that of the experiment.
            first_seed: seed of the first plant.
            options: further arguments of ``runs``.

        Returns:
            One row per run, controller, leak and plant: controller, leakage_flow_lpm, seed, and the columns of the
            experiment.

        Raises:
            ControllerError: a controller raises an exception or returns no finite commands.
        """
        levels, count = leaks or self.leaks, plants or self.plants
        cases = Cases(np.tile(np.arange(first_seed, first_seed + count), len(levels)), np.repeat(levels, count))
        tables = []
        for run in self.runs(config, **options):
            for name, controller in controllers.items():
                acting = HiddenPreview(controller, config) if run.hidden_preview else controller
                found = run.measure(*(run_cases(task, acting, cases) for task in run.tasks))
                known = {"leakage_flow_lpm": cases.leakage_flow_lpm, "seed": cases.seeds}
                tables.append(pd.DataFrame({"controller": name, **known, **found}))
        table = pd.concat(tables, ignore_index=True)
        return table if self.finish is None else self.finish(table)


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
        names = observation_layout(config)[0]
        self.columns = [column for column, name in enumerate(names) if name.startswith("reference_preview_")]

    def predict(
        self, observation: Observation, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], Any]:
        """Commands of the controller; see :class:`~hydro_agents.controllers.base.Controller`."""
        shown = np.array(observation)
        shown[..., self.columns] = 0.0
        return self.controller.predict(shown, state, episode_start, deterministic)
