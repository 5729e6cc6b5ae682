"""LQG with preview: linear-quadratic state feedback on the estimate of a Kalman filter.

Sources: Anderson & Moore, *Optimal Control: Linear Quadratic Methods* (1990). Tomizuka, *Optimal continuous finite
preview problem*, IEEE Transactions on Automatic Control 20(3), 1975: a gain on every sample of the preview. Pannocchia
& Rawlings, *Disturbance models for offset-free model-predictive control*, AIChE Journal 49(2), 2003: integral action
from one estimated disturbance for each measured signal.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_are

from hydro_agents.controllers.base import gain
from hydro_agents.controllers.observer_feedback import (
    ObserverFeedback,
    ObserverFeedbackGains,
    SampledModel,
    sampled,
)
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.types import Floats

TAIL = 400
"""Periods after which the effect of the reference on a command has died away."""

SPOOL_OFFSET_DRIFT = 1e-3
"""1/√s; drift of the offset of the measured spool, as a fraction of full opening."""

POSITION, SPEED, ACCELERATION, FLOW, FORCE, SPOOL_OFFSET = 0, 1, 2, 6, 7, 8
VALVE = slice(3, 6)
"""Places of the states: position, speed, acceleration; spool, its speed, current, as speeds of the axis; disturbances
of flow (m/s) and force (m/s²), offset of the measured spool (m/s)."""

REGULATED = 6
"""States that the regulator feeds back; all but the disturbances."""


class LQGGains(ObserverFeedbackGains):
    """Gains of :class:`LQG`: regulator and Kalman filter, relative to the rig; drifts are those of random walks."""

    bandwidth: float = gain(0.9, (0.1, 10.0), "1", "of the regulator, per lag of the rig", low=1e-3, logarithmic=True)
    damping: float = gain(0.1, (0.02, 1.5), "1", "damping ratio of mass and oil", low=1e-3, logarithmic=True)
    acceleration_noise: float = gain(
        0.2, (0.01, 10.0), "1/√s", "of full speed × hydraulic frequency", low=1e-6, logarithmic=True
    )
    flow_drift: float = gain(0.06, (0.001, 10.0), "1/√s", "of full speed", low=1e-6, logarithmic=True)
    force_drift: float = gain(
        0.04, (0.001, 10.0), "1/√s", "of full speed × hydraulic frequency", low=1e-6, logarithmic=True
    )
    valve_noise: float = gain(0.04, (0.001, 10.0), "1/√s", "of full opening", low=1e-6, logarithmic=True)


class LQG(ObserverFeedback):
    """State feedback, Kalman filter and optimal preview on the linearised nominal rig; see :class:`ObserverFeedback`.

    The linearisation is reduced to position, speed, acceleration and valve. The Kalman filter reads position, force of
    the oil and spool. The regulator minimises Σ (position − reference)² + (change of the speed command)² (T ω²)⁻²; ω is
    its bandwidth. The reference is known within the preview; beyond it, it continues at its last speed.

    Raises:
        ConfigurationError: the Riccati equations have no solution for these gains.
    """

    disturbance = FLOW

    def __init__(self, gains: LQGGains, config: TaskConfig) -> None:
        super().__init__(gains, config)
        c, frequency, period = plant_coefficients(config.plant), self.frequency, config.control_period
        self._mass, self._spring = 1.0 / c.inverse_mass, c.spring_stiffness
        self._valve_at_rest = -np.linalg.solve(self.valve, self.drive)  # per command

        a, b, outputs = np.zeros((9, 9)), np.zeros(9), np.zeros((3, 9))
        a[POSITION, SPEED] = a[SPEED, ACCELERATION] = 1.0
        a[ACCELERATION, [SPEED, ACCELERATION]] = -(frequency**2), -2.0 * gains.damping * frequency
        a[ACCELERATION, [VALVE.start, FLOW]] = frequency**2
        a[VALVE, VALVE], b[VALVE] = self.valve, self.drive
        outputs[0, POSITION] = outputs[2, VALVE.start] = outputs[2, SPOOL_OFFSET] = 1.0
        outputs[1, [POSITION, SPEED, ACCELERATION, FORCE]] = (
            c.spring_stiffness,
            c.viscous_damping,
            self._mass,
            self._mass,
        )
        self.model = sampled(a, b, outputs, config)

        full, fast = self.full_speed, max(1.0, float(np.sqrt(abs(self.valve[1, 0]))))
        size = full * np.array(
            [self.delay, 1.0, frequency, 1.0, fast, abs(self._valve_at_rest[2]), 1.0, frequency, 1.0]
        )
        drift = np.zeros(9)
        drift[[ACCELERATION, VALVE.start, FLOW, FORCE, SPOOL_OFFSET]] = (
            gains.acceleration_noise * frequency,
            gains.valve_noise,
            gains.flow_drift,
            gains.force_drift * frequency,
            SPOOL_OFFSET_DRIFT,
        )
        sensors = config.sensors
        oil = np.hypot(c.area_a * sensors.pressure_a.noise, c.area_b * sensors.pressure_b.noise)
        noise = np.array([sensors.position.noise, oil, sensors.spool_position.noise * full])
        noise = np.maximum(noise, 1e-6 * full * np.array([self.delay, frequency * self._mass, 1.0]))
        weight = (gains.bandwidth / self.lag) ** 2 * period
        try:
            self.correction = kalman_gain(self.model, full * np.sqrt(period) * drift, noise, size)
            self.feedback, preview = regulator(self.model, weight, size[:REGULATED], full)
        except np.linalg.LinAlgError as error:
            raise ConfigurationError(f"lqg: no regulator or Kalman filter for these gains: {error}") from None
        # A step of the reference moves all later samples; the last known step repeats without end.
        later, horizon = np.cumsum(preview[::-1])[::-1], self.preview.horizon
        self._preview = np.append(0.0, later[:horizon])
        self._preview[-1] += later[horizon:].sum()

    def following(self, measured: Floats, command: Floats, speed: Floats) -> Floats:
        """See :meth:`ObserverFeedback.following`."""
        estimate = np.zeros_like(measured, shape=(len(measured), 9))
        estimate[:, POSITION] = measured[:, 0]
        estimate[:, VALVE] = command[:, None] * self._valve_at_rest
        estimate[:, SPEED] = speed
        estimate[:, FLOW] = speed - command
        estimate[:, FORCE] = (measured[:, 1] - self._spring * measured[:, 0]) / self._mass
        estimate[:, SPOOL_OFFSET] = measured[:, 2] - command
        return estimate

    def speed(self, estimate: Floats, error: Floats, command: Floats, steps: Floats) -> Floats:
        """See :meth:`ObserverFeedback.speed`."""
        k, disturbance = self.feedback, estimate[:, FLOW]
        motion = error * k[POSITION] + estimate[:, [SPEED, ACCELERATION]] @ k[[SPEED, ACCELERATION]]
        # The regulator has no disturbance states: it sees the valve opening that moves the axis.
        motion += (estimate[:, VALVE] + estimate[:, [FLOW]] * self._valve_at_rest) @ k[VALVE]
        speed: Floats = command + steps @ self._preview - motion - k[-1] * (command + disturbance)
        return speed


def kalman_gain(model: SampledModel, drift: Floats, noise: Floats, size: Floats) -> Floats:
    """Stationary gain of the Kalman filter on the innovations of the measured signals, (n, m).

    Args:
        model: n states, m measured signals.
        drift: standard deviation of the random change of each state in a period, (n,).
        noise: standard deviation of each measured signal, (m,).
        size: typical size of each state, (n,); scales the Riccati equation.
    """
    transition, outputs = model.transition * size / size[:, None], model.outputs * size / noise[:, None]
    covariance = solve_discrete_are(transition.T, outputs.T, np.diag((drift / size) ** 2), np.eye(len(noise)))
    innovation = outputs @ covariance @ outputs.T + np.eye(len(noise))
    k: Floats = size[:, None] * np.linalg.solve(innovation, outputs @ covariance).T / noise
    return k


def regulator(model: SampledModel, weight: float, size: Floats, full: float) -> tuple[Floats, Floats]:
    """Gains that minimise Σ (weight · (position − reference))² + (change of the command)².

    States and last command are z, scaled by their sizes: z[k+1] = transition z[k] + drive · change[k]. Without a
    reference the cost to go is zᵀ cost z.

    Args:
        model: its first states are fed back.
        weight: 1/s.
        size: typical size of each state fed back, (n,).
        full: typical command.

    Returns:
        Gains on states and last command, (n + 1,), and on the reference 1, 2, … :data:`TAIL` periods ahead, (TAIL,).
    """
    n = len(size)
    transition = np.eye(n + 1)
    transition[:n, :n] = model.transition[:n, :n]
    transition[:n, n] = (model.input_old + model.input_new)[:n]
    size = np.append(size, full)
    transition = transition * size / size[:, None]
    drive = np.append(model.input_new[:n], 1.0) / size
    position = np.zeros(n + 1)
    position[POSITION] = weight * size[POSITION]
    cost = solve_discrete_are(transition, drive[:, None], np.outer(position, position), np.eye(1))
    shared = drive / (1.0 + drive @ cost @ drive)
    feedback = shared @ cost @ transition
    closed = transition - np.outer(drive, feedback)
    preview = np.empty(TAIL)
    for period in range(TAIL):
        preview[period] = weight * (shared @ position)
        shared = closed @ shared
    return feedback / size, preview
