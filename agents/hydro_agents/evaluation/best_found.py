"""The best found: a predictive search on the simulator itself that knows the plant.

It estimates how much better than a given controller any controller could be. It is not a controller itself, because no
rig can measure the true plant.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.evaluation.prediction import (
    Prediction,
    bounded_least_squares,
    continued,
    random_changes,
    true_schedule,
)
from hydro_agents.evaluation.state_filter import StateFilter
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.axes import Axes
from hydro_env.files import Group, validate
from hydro_env.task.signals import POSITION
from hydro_env.types import Floats

Told = Literal["truth", "measured"]


class BoundSettings(Group):
    """Size of the search for the best commands."""

    horizon: int = Field(20, ge=2, le=200, description="control periods that are planned ahead")
    iterations: int = Field(2, ge=0, le=50, description="Gauss-Newton steps per control period")
    samples: int = Field(8, ge=0, le=10_000, description="random changes of the plan tried in each iteration")
    preview: int | None = Field(
        None, ge=0, le=1000, description="control periods of the reference that are known; default: the task's preview"
    )
    aim: Literal["axis", "sensor"] = Field(
        "sensor",
        description="which position follows the reference: the true one, or the one that the biased sensor reads",
    )
    threads: int | None = Field(None, ge=1, le=1024, description="default: one per core; does not change results")


EFFORT = 2e-7  # m; cost of a change of the command by 1, squared

EVEN_ERRORS = (20e-6, 200e-6, 2e-3, 1.0)
"""m; one Gauss–Newton step for each of these limits: its cost is quadratic below the limit, linear above."""

STEP_LENGTHS = (1.0, 0.4)  # fractions of each Gauss–Newton step that are tried
CHANGE_SIZES = (2.0, 0.5, 0.1, 0.02)  # largest random changes of the plan, as a fraction of 10 V


def best_found(
    config: TaskConfig,
    cases: Cases,
    told: Told = "truth",
    settings: BoundSettings | dict[str, Any] | None = None,
    chunk: int = 64,
) -> Rollout:
    """Run every case under the best commands that the search finds in each control period.

    The search knows the plant of the episode, its leak and its forces, present and future, and the reference within the
    task's preview. With ``told="truth"`` it also knows the state; with ``told="measured"`` it estimates the state from
    the measured signals (:class:`~hydro_agents.evaluation.state_filter.StateFilter`), as a controller must.

    Args:
        config: the task.
        cases: the episodes. A case's result depends on neither the others nor the chunk.
        told: ``"truth"`` or ``"measured"``.
        settings: :class:`BoundSettings` or its fields.
        chunk: cases that run together.

    Raises:
        ConfigurationError: impossible settings.
    """
    if told not in ("truth", "measured"):
        raise ConfigurationError(f"best found: told = {told!r}: must be 'truth' or 'measured'")
    if not isinstance(settings, BoundSettings):
        settings = validate(BoundSettings, settings or {}, "best found")
    searcher = BestFound(config, told, settings)
    try:
        return run_cases(config, searcher, cases, chunk=chunk)
    finally:
        searcher.close()


class BestFound:
    """Plans the commands of N axes in each control period; :func:`~hydro_agents.running.cases.run_cases` runs it.

    Args:
        config: the task.
        told: ``"truth"`` or ``"measured"``.
        settings: size of the search.
    """

    def __init__(self, config: TaskConfig, told: Told, settings: BoundSettings) -> None:
        self.config = config
        self.told = told
        self.settings = settings
        self._known = max(config.preview_samples, default=0) if settings.preview is None else settings.preview
        self._prediction: Prediction | None = None

    def begin(self, axes: Axes) -> None:
        """Prepare for the episodes of the axes, which have just been reset."""
        self.close()
        config, settings = self.config, self.settings
        plants, latency = axes.coefficient.copy(), axes.column("latency").copy()
        schedule = true_schedule(config, axes, config.steps + settings.horizon)
        self._axes = axes
        self._prediction = Prediction(config, plants, latency, schedule, settings.threads)
        # A measured state is in the frame of the sensor already.
        biased = settings.aim == "sensor" and config.sensors.enabled and self.told == "truth"
        offset = axes.column("bias")[:, POSITION] if biased else 0.0
        self._target = axes.reference - np.reshape(offset, (-1, 1))
        self._plan = np.repeat(axes.column("command")[:, None], settings.horizon, axis=1)
        self._generator = np.random.default_rng(0)
        self._filter = StateFilter(config, axes) if self.told == "measured" else None

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], None]:
        """The first command of the plan, (N, 1); it reads the axes themselves, not the observation."""
        del observation, state, episode_start, deterministic
        prediction, settings = self._prediction, self.settings
        if prediction is None:
            raise ConfigurationError("best found: reads the true states of the axes; run it with run_cases")
        axes = self._axes
        step = int(axes.column("step").max())
        now, before = axes.state.copy(), axes.column("command").copy()
        if self._filter is not None:
            now = self._filter.updated(axes, prediction)
        target = continued(self._target, step, self._known, settings.horizon)
        plan = np.concatenate([self._plan[:, 1:], self._plan[:, -1:]], axis=1)
        for _ in range(max(settings.iterations, 1)):
            tried = self._candidates(now, before, plan, target, step)
            positions = prediction.positions(now, before, tried, step)
            cost = np.abs(target[:, None, :] - positions).mean(axis=2)
            changes = np.diff(tried, axis=2, prepend=np.broadcast_to(before[:, None, None], (*tried.shape[:2], 1)))
            cost += EFFORT * (changes**2).mean(axis=2)
            plan = tried[np.arange(len(tried)), np.argmin(cost, axis=1)]
        self._plan = plan
        return plan[:, :1].astype(np.float32), None

    def close(self) -> None:
        """Stop the worker threads."""
        if self._prediction is not None:
            self._prediction.close()

    def _candidates(self, now: Floats, before: Floats, plan: Floats, target: Floats, step: int) -> Floats:
        """Candidate sequences of commands, (N, M, H); the first is the present plan."""
        settings = self.settings
        assert self._prediction is not None
        tried = [plan]
        if settings.iterations > 0:
            positions, jacobian = self._prediction.sensitivities(now, before, plan, step)
            error = target - positions
            for even in EVEN_ERRORS:
                weight = 1.0 / np.maximum(np.abs(error), even)
                found = bounded_least_squares(jacobian, error, weight, plan, before, EFFORT)
                tried += [plan + length * (found - plan) for length in STEP_LENGTHS]
        changes = random_changes(self._generator, settings.samples, settings.horizon, CHANGE_SIZES)
        random = np.clip(plan[:, None, :] + changes, -1.0, 1.0)
        return np.concatenate([np.stack(tried, axis=1), random], axis=1)
