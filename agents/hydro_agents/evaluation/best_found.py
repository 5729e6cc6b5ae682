"""The best found: a predictive search on the simulator itself that knows the plant.

It estimates how much better than a given controller any controller could be. It is not a controller itself, because no
rig can measure the true plant.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.evaluation.prediction import (
    Prediction,
    bounded_least_squares,
    continued,
    random_changes,
    true_schedule,
)
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.axes import Axes
from hydro_env.plant.states import N_STATES, STATE_NAMES, TYPICAL_SIZE
from hydro_env.task.paces import within_a_period
from hydro_env.task.sensors import SENSOR_COLUMNS, SENSORS
from hydro_env.task.settings import settings_of
from hydro_env.task.signals import POSITION
from hydro_env.types import Floats

HORIZON = 20  # control periods that are planned ahead
ITERATIONS = 2  # improvements of the plan in each control period
SAMPLES = 8  # random changes of the plan that are tried in each iteration
EFFORT = 2e-7  # m; cost of a change of the command by 1, squared
EVEN_ERRORS = (20e-6, 200e-6, 2e-3, 1.0)
"""m; one Gauss–Newton step for each of these limits: its cost is quadratic below the limit, linear above."""

STEP_LENGTHS = (1.0, 0.4)  # fractions of each Gauss–Newton step that are tried
CHANGE_SIZES = (2.0, 0.5, 0.1, 0.02)  # largest random changes of the plan, as a fraction of 10 V


def best_found(config: TaskConfig, cases: Cases, measured: bool = False) -> Rollout:
    """Run every case under the best commands that the search finds in each control period.

    A case's result does not depend on the others.
    """
    return run_cases(config, BestFound(config, measured), cases)


class BestFound:
    """Plans the commands of N axes in each control period; :func:`~hydro_agents.running.cases.run_cases` runs it.

    The search knows the plant of the episode, its leak and its forces, present and future, and the reference within the
    task's preview. It also knows the true state, or estimates the state from the measured signals
    (:class:`StateFilter`), as a controller must. The position that the biased
    sensor reads follows the reference.

    Args:
        config: the task.
        measured: whether the state is estimated.
    """

    def __init__(self, config: TaskConfig, measured: bool = False) -> None:
        self.config = config
        self.measured = measured
        self._axes: Axes | None = None

    def begin(self, axes: Axes) -> None:
        """Prepare for the episodes of the axes, which have just been reset."""
        config = self.config
        plants, latency = axes.coefficient.copy(), axes.column("latency").copy()
        within_a_period(float(latency.max()), config, "best found")
        self._axes = axes
        self._prediction = Prediction(config, plants, latency, true_schedule(config, axes, config.steps + HORIZON))
        # A measured state is in the frame of the sensor already.
        biased = config.sensors.enabled and not self.measured
        offset = axes.column("bias")[:, POSITION] if biased else 0.0
        self._target = axes.reference - np.reshape(offset, (-1, 1))
        self._plan = np.repeat(axes.column("command")[:, None], HORIZON, axis=1)
        self._generator = np.random.default_rng(0)
        self._filter = StateFilter(config, axes) if self.measured else None

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], None]:
        """The first command of the plan, (N, 1); it reads the axes themselves, not the observation."""
        del observation, state, episode_start, deterministic
        axes = self._axes
        if axes is None:
            raise ConfigurationError("best found: reads the true states of the axes; run it with run_cases")
        step = int(axes.column("step").max())
        now, before = axes.state.copy(), axes.column("command").copy()
        if self._filter is not None:
            now = self._filter.updated(axes, self._prediction)
        target = continued(self._target, step, max(self.config.preview_samples, default=0), HORIZON)
        plan = np.concatenate([self._plan[:, 1:], self._plan[:, -1:]], axis=1)
        for _ in range(ITERATIONS):
            tried = self._candidates(now, before, plan, target, step)
            positions = self._prediction.positions(now, before, tried, step)
            cost = np.abs(target[:, None, :] - positions).mean(axis=2)
            changes = np.diff(tried, axis=2, prepend=np.broadcast_to(before[:, None, None], (*tried.shape[:2], 1)))
            cost += EFFORT * (changes**2).mean(axis=2)
            plan = tried[np.arange(len(tried)), np.argmin(cost, axis=1)]
        self._plan = plan
        return plan[:, :1].astype(np.float32), None

    def _candidates(self, now: Floats, before: Floats, plan: Floats, target: Floats, step: int) -> Floats:
        """Candidate sequences of commands, (N, M, H); the first is the present plan."""
        tried = [plan]
        positions, jacobian = self._prediction.sensitivities(now, before, plan, step)
        error = target - positions
        for even in EVEN_ERRORS:
            weight = 1.0 / np.maximum(np.abs(error), even)
            found = bounded_least_squares(jacobian, error, weight, plan, before, EFFORT)
            tried += [plan + length * (found - plan) for length in STEP_LENGTHS]
        changes = random_changes(self._generator, SAMPLES, HORIZON, CHANGE_SIZES)
        random = np.clip(plan[:, None, :] + changes, -1.0, 1.0)
        return np.concatenate([np.stack(tried, axis=1), random], axis=1)


MODEL_ERROR = 1e-5
"""Error of the state per control period that the filter allows for, in typical sizes: kinks are not linear."""

_MEASURED = [STATE_NAMES.index(name) for name in SENSORS]
ABSENT = 1e12  # standard deviations of a reading that a rig does not have


class StateFilter:
    """Estimates state and sensor offsets of N axes (Gelb 1974, *Applied Optimal Estimation*, section 6.1).

    The plant, its leak, its forces and the commands are known, and so is the state in which an episode begins at rest.
    The position is that of the sensor, whose offset nobody can see.

    Args:
        config: the task.
        axes: at the start of their episodes.
    """

    def __init__(self, config: TaskConfig, axes: Axes) -> None:
        numbers = settings_of(config)[0]
        self._lag, self._decay = float(numbers["pressure_lag"]), float(numbers["pressure_decay"])
        sensors = [getattr(config.sensors, name) for name in SENSORS]
        exact = not config.sensors.enabled
        noise = [0.0 if exact else float(np.hypot(each.noise, each.resolution)) for each in sensors]
        spread = [own if each.fitted else ABSENT for own, each in zip(noise, sensors, strict=True)]
        bias = [0.0 if exact else each.bias for each in sensors]
        self._noise = np.square(spread) + 1e-12 * np.square(TYPICAL_SIZE[_MEASURED])
        offsets = len(SENSORS) - 1  # of all but the position
        self._size = N_STATES + offsets
        self._model = np.diag(np.concatenate([np.square(MODEL_ERROR * TYPICAL_SIZE), np.zeros(offsets)]))
        start = np.concatenate([np.square(1e-3 * TYPICAL_SIZE), np.square(bias[1:]) / 3.0])  # offsets are uniform
        self._covariance = np.tile(np.diag(start), (axes.count, 1, 1))
        self._state = axes.state.copy()
        self._offset = np.zeros((axes.count, offsets))
        if not exact:
            self._state[:, _MEASURED[0]] += axes.column("bias")[:, POSITION]
        self._sensed = self._pressures()
        self._command: Floats | None = None
        # Readings per state and offset.
        self._reading = np.zeros((len(SENSORS), self._size))
        self._reading[np.arange(len(SENSORS)), _MEASURED] = 1.0
        self._reading[np.arange(1, len(SENSORS)), np.arange(N_STATES, self._size)] = 1.0

    def updated(self, axes: Axes, prediction: Prediction) -> Floats:
        """State (N, states) now, from the signals that the axes measure now; called once in each control period."""
        command, step = axes.column("command").copy(), int(axes.column("step").max())
        if self._command is not None:
            old = self._pressures()
            self._state, change = prediction.next_state(self._state, self._command, command, step - 1)
            transition = np.tile(np.eye(self._size), (axes.count, 1, 1))
            transition[:, :N_STATES, :N_STATES] = change
            self._covariance = transition @ self._covariance @ transition.transpose(0, 2, 1) + self._model
            slope = self._lag * (self._pressures() - old)  # of a transducer behind a first-order lag
            self._sensed = self._pressures() - slope + self._decay * (self._sensed - old + slope)
        self._command = command
        self._correct(axes.column("measured")[:, SENSOR_COLUMNS])
        return self._state.copy()

    def _correct(self, measured: Floats) -> None:
        expected = self._state[:, _MEASURED]
        expected[:, 1:3] = self._sensed
        expected[:, 1:] += self._offset
        surprise = np.nan_to_num(measured - expected)
        cross = self._covariance @ self._reading.T
        gain = cross @ np.linalg.inv(self._reading @ cross + np.diag(self._noise))
        change = (gain @ surprise[:, :, None])[..., 0]
        before = self._pressures()
        self._state += change[:, :N_STATES]
        self._offset += change[:, N_STATES:]
        self._sensed += self._pressures() - before
        self._covariance -= gain @ cross.transpose(0, 2, 1)
        self._covariance = 0.5 * (self._covariance + self._covariance.transpose(0, 2, 1))

    def _pressures(self) -> Floats:
        """Pressures of both chambers, (N, 2), Pa."""
        return self._state[:, _MEASURED[1:3]]
