"""ADRC, active disturbance rejection control: an observer estimates the total disturbance, feedback cancels it.

Sources: Han, *From PID to active disturbance rejection control*, IEEE Transactions on Industrial Electronics 56(3),
2009. Gao, *Scaling and bandwidth-parameterization based controller tuning*, American Control Conference 2003: one
bandwidth for the observer, one for the controller. Miklosovic, Radke & Gao, *Discrete implementation and
generalization of the extended state observer*, ACC 2006. Yao, Jiao & Ma, *Extended-state-observer-based output feedback
nonlinear robust control of hydraulic systems with backstepping*, IEEE Transactions on Industrial Electronics 61(11),
2014.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydro_agents.controllers.base import gain
from hydro_agents.controllers.observer_feedback import ObserverFeedback, ObserverFeedbackGains, sampled
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.types import Floats


class ADRCGains(ObserverFeedbackGains):
    """Gains of :class:`ADRC`, relative to the rig."""

    controller_bandwidth: float = gain(1.2, (0.1, 5.0), "1", "ω_c, per lag of the rig", low=1e-3, logarithmic=True)
    observer_bandwidth: float = gain(0.4, (0.1, 10.0), "1", "ω_o, per lag of the rig", low=1e-3, logarithmic=True)
    speed_lag: float = gain(
        0.6, (0.1, 2.0), "1", "time constant τ from command to speed, in lags of the rig", low=0.01, logarithmic=True
    )
    lead: float = gain(1.3, (0.0, 3.0), "1", "of the reference speed, in delays", high=100.0)


class ADRC(ObserverFeedback):
    """Speed dv/dt = (u − v)/τ + f, f the total disturbance; see :class:`ObserverFeedback`.

    The three-state extended state observer estimates position, speed and τ f (m/s) from the measured position; all its
    poles lie at exp(−ω_o T). Feedback of position, speed and last command places two poles at exp(−ω_c T) and one at 0.
    The reference speed is fed forward, with a lead.
    """

    disturbance = 2

    def __init__(self, gains: ADRCGains, config: TaskConfig) -> None:
        super().__init__(gains, config)
        rate = 1.0 / (gains.speed_lag * self.lag)
        a = np.array([[0.0, 1.0, 0.0], [0.0, -rate, rate], [0.0, 0.0, 0.0]])
        b = np.array([0.0, rate, 0.0])
        position = np.array([[1.0, 0.0, 0.0]])
        self.model = sampled(a, b, position, config)
        self.correction = self._observer(gains.observer_bandwidth)
        self.feedback = self._feedback(gains.controller_bandwidth)
        lead = gains.lead * self.delay / config.control_period
        self._reference_speeds = self._speeds_at((0.0, lead - 1.0, lead))

    def _observer(self, bandwidth: float) -> Floats:
        """Gain of the observer, (3, 1)."""
        model, pole = self.model, self._pole(bandwidth)
        observed = (model.outputs @ model.transition)[0]
        return placed(model.transition.T, observed, [pole] * 3)[:, None]

    def _feedback(self, bandwidth: float) -> Floats:
        """Gains of the feedback, (3,). The last command is a state, because it acts until the latency is over."""
        model, pole = self.model, self._pole(bandwidth)
        transition = np.zeros((3, 3))
        transition[:2, :2] = model.transition[:2, :2]
        transition[:2, 2] = model.input_old[:2]
        return placed(transition, np.append(model.input_new[:2], 1.0), [pole, pole, 0.0])

    def _pole(self, bandwidth: float) -> float:
        """The pole of a bandwidth, which is per lag of the rig."""
        return float(np.exp(-self.config.control_period * bandwidth / self.lag))

    def _speeds_at(self, times: Sequence[float]) -> Floats:
        """Matrix from the steps of the reference to its speeds at some times, in control periods from now."""
        middles = np.arange(-0.5, self.preview.horizon)
        shares = []
        for time in times:
            shares.append([np.interp(time, middles, step) for step in np.eye(len(middles))])
        return np.array(shares).T / self.config.control_period

    def following(self, measured: Floats, command: Floats, speed: Floats) -> Floats:
        """See :meth:`ObserverFeedback.following`."""
        return np.stack([measured[:, 0], speed, speed - command], axis=1)

    def speed(self, estimate: Floats, error: Floats, command: Floats, steps: Floats) -> Floats:
        """See :meth:`ObserverFeedback.speed`."""
        present, last, leading = (steps @ self._reference_speeds).T
        disturbance, k = estimate[:, self.disturbance], self.feedback
        deviation = command + disturbance - last
        speed: Floats = leading - disturbance - k[0] * error - k[1] * (estimate[:, 1] - present) - k[2] * deviation
        return speed


def placed(a: Floats, b: Floats, poles: Sequence[float]) -> Floats:
    """Gain k, (n,), that places the poles of a − b kᵀ (Ackermann 1972)."""
    controllability = np.column_stack([np.linalg.matrix_power(a, power) @ b for power in range(len(b))])
    polynomial = np.eye(len(b))
    for pole in poles:
        polynomial = polynomial @ (a - pole * np.eye(len(b)))
    try:
        k: Floats = np.linalg.solve(controllability.T, np.eye(len(b))[-1]) @ polynomial
    except np.linalg.LinAlgError:
        raise ConfigurationError("adrc: no feedback or observer for these gains: speed_lag is too short") from None
    return k
