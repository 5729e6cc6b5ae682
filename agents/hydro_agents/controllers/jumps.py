"""Jumps of the reference, which no axis can follow: the axis sets off before a jump, and brakes towards its end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import surely_zero
from hydro_agents.controllers.flow_model import FlowModel

Array = NDArray[np.float64]


class Jumps:
    """Removes jumps from the reference, and decides for which of them the axis must already move; for N axes.

    An axis sets off ``delay`` before a jump, and earlier by ``share`` of half the time that the jump takes at full
    speed: with ``share = 1`` it is half-way when the reference jumps.

    Args:
        model: the flow of the valve.
        largest: m; a larger change of the reference in a period is a jump.
        delay: s.
        share: 1.
        times: s from now to each future sample of the reference, (horizon,).
    """

    def __init__(self, model: FlowModel, largest: float, delay: float, share: float, times: Array) -> None:
        self._model, self._largest = model, largest
        self._delay, self._half_share, self._times = delay, 0.5 * share, times

    def split(self, reference: Array) -> tuple[Array, Array]:
        """Steps without jumps, and the jumps alone, of a reference (N, horizon + 2) in m, each (N, horizon + 1)."""
        steps = np.diff(reference, axis=1)
        jumps = np.where(np.abs(steps) > self._largest, steps, 0.0)
        return steps - jumps, jumps

    def begun(self, jumps: Array, force: Array, supply: Array) -> Array:
        """Sum of the jumps ahead for which the axis moves already, m, (N,).

        Args:
            jumps: of :meth:`split`, (N, horizon + 1).
            force: of the oil on the piston, N, (N,).
            supply: pressure, Pa, (N,).
        """
        if surely_zero(jumps):
            return np.zeros(len(jumps))
        ahead = jumps[:, 1:]
        out, back = self._model.full_speeds(force, supply)
        full = np.where(ahead > 0.0, out[:, None], back[:, None])
        early = self._half_share * np.abs(ahead) / full + self._delay
        total: Array = np.where(early >= self._times, ahead, 0.0).sum(axis=1)
        return total


def braked(error: Array, near: float) -> Array:
    """The error if it is small; beyond ``near`` its square root, because an axis brakes at constant deceleration.

    The reduced error and its slope are continuous at ``near`` (m).
    """
    size = np.abs(error)
    root = np.sqrt(near * np.maximum(2.0 * size - near, near))
    return np.where(size > near, np.copysign(root, error), error)
