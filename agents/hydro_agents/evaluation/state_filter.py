"""The state of axes whose plant is known, from their measured signals: an extended Kalman filter."""

from __future__ import annotations

import numpy as np

from hydro_agents.evaluation.prediction import Prediction
from hydro_env import TaskConfig
from hydro_env.axes import Axes
from hydro_env.plant.states import N_STATES, STATE_NAMES, TYPICAL_SIZE
from hydro_env.task.sensors import CHANNELS, SENSOR_COLUMNS, SENSORS
from hydro_env.task.settings import settings_of
from hydro_env.types import Floats

MODEL_ERROR = 1e-5
"""Error of the state per control period that the filter allows for, in typical sizes: kinks are not linear."""

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
        self._noise = np.square(spread) + 1e-12 * np.square(TYPICAL_SIZE[[STATE_NAMES.index(name) for name in SENSORS]])
        offsets = len(SENSORS) - 1  # of all but the position
        self._size = N_STATES + offsets
        self._model = np.diag(np.concatenate([np.square(MODEL_ERROR * TYPICAL_SIZE), np.zeros(offsets)]))
        start = np.concatenate([np.square(1e-3 * TYPICAL_SIZE), np.square(bias[1:]) / 3.0])  # offsets are uniform
        self._covariance = np.tile(np.diag(start), (axes.count, 1, 1))
        self._state = axes.state.copy()
        self._offset = np.zeros((axes.count, offsets))
        if not exact:
            self._state[:, STATE_NAMES.index("position")] += axes.column("bias")[:, CHANNELS.index("position")]
        self._sensed = self._pressures()
        self._command: Floats | None = None
        # Readings per state and offset.
        self._reading = np.zeros((len(SENSORS), self._size))
        self._reading[np.arange(len(SENSORS)), [STATE_NAMES.index(name) for name in SENSORS]] = 1.0
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
        expected = self._state[:, [STATE_NAMES.index(name) for name in SENSORS]]
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
        return self._state[:, [STATE_NAMES.index("pressure_a"), STATE_NAMES.index("pressure_b")]]
