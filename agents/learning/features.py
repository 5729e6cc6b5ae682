"""What the policy network sees: the observation, the PID's command, and a short history of signals.

Leakage, stiffness of the oil, mass and friction are hidden; in the recent past of pressures, spool and error they
show. The same class serves training and inference, so that they cannot differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.controllers.base import Floats, ObservationLayout
from agents.controllers.pid import PID, PIDGains, PIDState

HISTORY_SIGNALS = (
    "position",
    "velocity_estimate",
    "pressure_a",
    "pressure_b",
    "spool_position",
    "previous_command",
    "tracking_error",
)
HISTORY_LAGS = (1, 2, 3, 5, 8, 12, 18, 26, 36)
"""Control periods back."""


@dataclass
class FeatureState:
    """Memory: the PID's, and a ring of recent signals (N, length, signals) with its next slot."""

    pid: PIDState | None
    ring: NDArray[np.float32]
    slot: int
    base_command: NDArray[np.float32]  # (N, 1), of the PID at the last call


class PolicyFeatures:
    """Turns observations into the inputs of the policy, and its outputs into commands.

    Args:
        layout: of the observations.
        gains: of the PID that the policy corrects (residual form), or ``None`` (the policy acts on its own).
        residual_scale: command per 1 of the policy's output in the residual form.
    """

    def __init__(self, layout: ObservationLayout, gains: PIDGains | None, residual_scale: float = 0.25) -> None:
        self.layout = layout
        self.gains = gains
        self.residual_scale = residual_scale if gains is not None else 1.0
        self.pid = PID(gains, layout) if gains is not None else None
        self._columns = np.array([layout.index(name) for name in HISTORY_SIGNALS])
        self._lags = np.array(HISTORY_LAGS)
        self._length = int(self._lags.max()) + 1
        self.size = len(layout.names) + (1 if self.pid else 0) + len(HISTORY_SIGNALS) * len(HISTORY_LAGS)

    def __call__(
        self, observation: Floats, state: FeatureState | None, episode_start: NDArray[np.bool_] | None
    ) -> tuple[NDArray[np.float32], FeatureState]:
        """Inputs (N, size) for a batch of observations (N, n), and the new memory.

        The history holds differences to the present, so that it tells what changed; before the start of an episode
        the first observation counts as the past.
        """
        signals = np.asarray(observation[:, self._columns], dtype=np.float32)
        if state is None:
            ring = np.repeat(signals[:, None], self._length, axis=1)
            state = FeatureState(None, ring, 0, np.zeros((len(signals), 1), dtype=np.float32))
        elif episode_start is not None and np.any(episode_start):
            started = np.flatnonzero(episode_start)
            state.ring[started] = signals[started, None]
        state.ring[:, state.slot] = signals
        past = state.ring[:, (state.slot - self._lags) % self._length]
        past = (signals[:, None] - past).reshape(len(signals), -1)
        parts = [np.asarray(observation, dtype=np.float32)]
        memory = state.pid
        if self.pid is not None:
            base, memory = self.pid.predict(observation, state.pid, episode_start)
            parts.append(base)
            state.base_command = base
        parts.append(past)
        slot = (state.slot + 1) % self._length
        return np.concatenate(parts, axis=1), FeatureState(memory, state.ring, slot, state.base_command)

    def command(self, output: Floats, state: FeatureState) -> NDArray[np.float32]:
        """Command in [−1, 1] for the outputs of the policy (N, 1)."""
        bounded = np.clip(np.asarray(output, dtype=np.float32), -1.0, 1.0)
        if self.pid is None:
            return bounded
        command: NDArray[np.float32] = np.clip(
            state.base_command + np.float32(self.residual_scale) * bounded, -1.0, 1.0
        ).astype(np.float32)
        return command

    def describe(self) -> dict[str, Any]:
        """All that is needed to build this again (JSON)."""
        return {
            "observation_names": list(self.layout.names),
            "observation_scale": list(self.layout.scale),
            "control_period": self.layout.control_period,
            "pid_gains": self.gains.model_dump() if self.gains is not None else None,
            "residual_scale": self.residual_scale,
            "history_signals": list(HISTORY_SIGNALS),
            "history_lags": list(HISTORY_LAGS),
        }
