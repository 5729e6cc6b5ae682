"""MPC, model predictive control: every period an optimal move within the limits of the valve.

Sources: Rawlings, Mayne & Diehl, *Model Predictive Control* (2017), chapters 1 and 2: condensed quadratic program, cost
to go as terminal cost. Boyd et al., *Distributed optimization and statistical learning via the alternating direction
method of multipliers*, Foundations and Trends in Machine Learning 3(1), 2011, sections 3.4 and 5.2. Pannocchia &
Rawlings, *Disturbance models for offset-free model-predictive control*, AIChE Journal 49(2), 2003.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from pydantic import Field

from hydro_agents.controllers.base import surely_zero
from hydro_agents.controllers.flow_model import Flow
from hydro_agents.controllers.lqg import (
    ACCELERATION,
    FLOW,
    LQG,
    POSITION,
    SPEED,
    KalmanGains,
    TrackingProblem,
    tracking_problem,
)
from hydro_agents.controllers.observer_feedback import ObserverState
from hydro_env import TaskConfig
from hydro_env.types import Floats

RELAXATION = 1.7
"""Over-relaxation of the alternating directions; 1.5 to 1.8 are usual."""


class MPCGains(KalmanGains):
    """Gains of :class:`MPC`."""

    horizon: float = Field(
        6.0, gt=0.0, le=100.0, description="1; least horizon, in lags of the rig; a longer preview replaces it"
    )


class MPC(LQG):
    """The commands of the horizon that minimise the cost of :class:`LQG` within the limits of the valve.

    The model is the linearised rig of the data sheet; the valve law at the measured pressures turns openings into
    speeds, and so the limits ±1 of the opening into limits of the speed. The Kalman filter of :class:`LQG` estimates
    state and disturbances, which are taken to last. The reference is known within the preview, jumps included; beyond
    it continues at its last speed. The terminal cost is the cost to go without limits: while no limit acts, the
    commands are those of :class:`LQG`, for any horizon.

    Raises:
        ConfigurationError: the Riccati equations have no solution for these gains.
    """

    def __init__(self, gains: MPCGains, config: TaskConfig) -> None:
        super().__init__(gains, config)
        periods = math.ceil(gains.horizon * self.lag / config.control_period)
        self._beyond = max(periods - self.preview.horizon, 0)
        problem = tracking_problem(self.model, self.weight, self.size, self.full_speed)
        self._program = condensed(problem, self.preview.horizon + self._beyond)

    def wanted(self, now: ObserverState, flow: Flow, leak: Floats) -> Floats:
        """See :meth:`~hydro_agents.controllers.observer_feedback.ObserverFeedback.wanted`."""
        estimate, disturbance = now.estimate, now.estimate[:, FLOW]
        error = estimate[:, [POSITION]] - now.reference[:, [1]]
        motion, valve = estimate[:, [SPEED, ACCELERATION]], self.moving_valve(estimate)
        state = np.concatenate([error, motion, valve, (now.command_before + disturbance)[:, None]], axis=1)
        last = now.reference[:, [-1]] - now.reference[:, [-2]]
        last = np.where(np.abs(last) > self.jump, 0.0, last)  # no axis can follow a jump, and it does not go on
        ahead = now.reference[:, 2:] - now.reference[:, [1]]
        end = now.reference[:, [-1]] - now.reference[:, [1]]
        beyond = end + last * np.arange(1.0, self._beyond + 1)
        known = np.concatenate([state, ahead, beyond, last], axis=1)
        ones = np.ones_like(leak)
        low, high = (self.flow.speed(end * ones, flow) + leak + disturbance for end in (-1.0, 1.0))
        return self._program.first(known, low[:, None], high[:, None]) - disturbance


class Program(NamedTuple):
    """A quadratic program in the speed commands c of the horizon: ½ (c − c*)ᵀ hessian (c − c*), low ≤ c ≤ high."""

    free: Floats  # (known, horizon): c* = known @ free, the commands without limits
    hessian: Floats  # (horizon, horizon)
    penalty: float
    inverse: Floats  # (horizon, horizon), of hessian + penalty
    iterations: int

    def first(self, known: Floats, low: Floats, high: Floats) -> Floats:
        """The first command of the optimum, m/s, (N,), by alternating directions.

        Args:
            known: state with the last command, reference from 1 to ``horizon`` periods ahead, last step of the
                reference, (N, known), in SI units and relative to the present reference.
            low: lower limit of the commands, m/s, (N, 1).
            high: upper limit, m/s, (N, 1).
        """
        free = known @ self.free
        bounded: Floats = np.clip(free, low, high)
        if surely_zero(free - bounded):
            return bounded[:, 0]
        pull, sums = free @ self.hessian, np.zeros_like(free)
        for _ in range(self.iterations):
            best = (pull + self.penalty * (bounded - sums)) @ self.inverse
            relaxed = RELAXATION * best + (1.0 - RELAXATION) * bounded + sums
            bounded = np.clip(relaxed, low, high)
            sums = relaxed - bounded
        return bounded[:, 0]


def condensed(problem: TrackingProblem, horizon: int) -> Program:
    """The program of a horizon in periods, with the optimal cost to go after it.

    With the states z of :class:`~hydro_agents.controllers.lqg.TrackingProblem` and the changes Δ of the command as
    unknowns, z[k] = transitionᵏ z[0] + Σ transitionᵏ⁻¹⁻ʲ drive Δ[j]. The cost to go for a reference r[k] that
    continues from the end of the horizon at its last step s is zᵀ cost z − 2 zᵀ (at_end r + at_step s).
    """
    size, a, drive, position, cost = problem
    shared = drive / (1.0 + drive @ cost @ drive)
    closed = a - np.outer(drive, shared @ cost @ a)
    weight = position[POSITION] / size[POSITION]
    kept = np.linalg.inv(np.eye(len(a)) - closed.T)
    at_end = kept @ position * weight  # Σ closedᵀʲ position
    at_step = kept @ closed.T @ at_end  # Σ j closedᵀʲ position

    powers = [np.linalg.matrix_power(a, k) for k in range(horizon + 1)]
    hessian, slope = np.eye(horizon), np.zeros((len(a) + horizon + 1, horizon))
    for k in range(1, horizon + 1):
        effect = np.zeros((len(a), horizon))  # of the changes on z[k]
        effect[:, :k] = np.stack([powers[k - 1 - j] @ drive for j in range(k)], axis=1)
        if k < horizon:
            row = position @ effect
            hessian += np.outer(row, row)
            slope[: len(a)] += np.outer(powers[k].T @ position, row)
            slope[len(a) + k - 1] -= weight * row
        else:
            hessian += effect.T @ cost @ effect
            slope[: len(a)] += powers[k].T @ cost @ effect
            slope[-2] -= at_end @ effect
            slope[-1] -= at_step @ effect
    slope[: len(a)] /= size[:, None]
    differences = np.eye(horizon) - np.eye(horizon, k=-1)
    free = -slope @ np.linalg.inv(hessian) @ np.linalg.inv(differences).T
    free[len(a) - 1] += 1.0  # the commands change from the last one
    hessian = differences.T @ hessian @ differences
    least, most = np.linalg.eigvalsh(hessian)[[0, -1]]
    penalty = math.sqrt(least * most)
    inverse = np.asarray(np.linalg.inv(hessian + penalty * np.eye(horizon)), dtype=np.float64)
    return Program(free, hessian, penalty, inverse, 10 + math.ceil(4.0 * math.sqrt(most / least)))
