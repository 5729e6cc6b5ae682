"""Inputs of the policy network: observation, command of the controller that it corrects, short history of signals.

Leakage, stiffness of the oil, mass and friction are hidden, but they affect the recent past of pressures, spool and
error. Training and inference use the same class.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.controllers.base import ClassicalController, Floats, ObservationLayout, rows
from agents.controllers.registry import kind_of
from hydro_env import TaskConfig

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


FEATURE_LIMIT = 50.0
"""Inputs of the policy are limited to ± this value."""


class FeatureState(NamedTuple):
    """Memory of N axes; no call changes its argument."""

    base: Any
    """Memory of the controller that the policy corrects; ``None`` without one."""

    ring: NDArray[np.float32]
    """Ring buffer of recent signals (N, length, signals); the oldest is at ``slot``."""

    slot: int
    """Index for the next signals."""

    base_command: NDArray[np.float32]
    """Command of the corrected controller at the last call, (N, 1)."""

    def rows(self, axes: NDArray[np.int64]) -> FeatureState:
        """The memory of some axes."""
        base = rows(self.base, axes) if self.base is not None else None
        return FeatureState(base, self.ring[axes], self.slot, self.base_command[axes])


class PolicyFeatures:
    """Turns observations into the inputs of the policy, and its outputs into commands.

    Args:
        config: the task.
        base: the controller that the policy corrects (residual form), or ``None`` (the policy acts on its own).
        residual_scale: command per 1 of the policy's output in the residual form.
    """

    def __init__(
        self, config: TaskConfig, base: ClassicalController | None = None, residual_scale: float = 0.25
    ) -> None:
        self.config = config
        self.layout = layout = ObservationLayout.of(config)
        self.base = base
        self.residual_scale = residual_scale if base is not None else 1.0
        self._columns = np.array([layout.index(name) for name in HISTORY_SIGNALS])
        self._lags = np.array(HISTORY_LAGS)
        self._length = max(HISTORY_LAGS) + 1
        self.size = len(layout.names) + (1 if base is not None else 0) + len(HISTORY_SIGNALS) * len(HISTORY_LAGS)

    def __call__(
        self, observation: Floats, state: FeatureState | None, episode_start: NDArray[np.bool_] | None
    ) -> tuple[NDArray[np.float32], FeatureState]:
        """Inputs (N, size) for a batch of observations (N, n), and the new memory.

        The history consists of the changes since each past sample. The first observation of an episode stands for the
        time before it.
        """
        signals = np.asarray(observation[:, self._columns], dtype=np.float32)
        if state is None:
            ring = np.repeat(signals[:, None], self._length, axis=1)
            state = FeatureState(None, ring, 0, np.zeros((len(signals), 1), dtype=np.float32))
        ring = state.ring.copy()
        if episode_start is not None and np.any(episode_start):
            started = np.flatnonzero(episode_start)
            ring[started] = signals[started, None]
        ring[:, state.slot] = signals
        past = ring[:, (state.slot - self._lags) % self._length].reshape(len(signals), -1)
        changes = np.tile(signals, len(HISTORY_LAGS)) - past
        state = state._replace(ring=ring, slot=(state.slot + 1) % self._length)
        inputs = np.asarray(observation, dtype=np.float32)
        if self.base is None:
            return np.concatenate([inputs, changes], axis=1), state
        command, memory = self.base.predict(observation, state.base, episode_start)
        return np.concatenate([inputs, command, changes], axis=1), state._replace(base=memory, base_command=command)

    def command(self, output: Floats, state: FeatureState) -> NDArray[np.float32]:
        """Command in [−1, 1] for the outputs of the policy (N, 1)."""
        bounded = np.clip(np.asarray(output, dtype=np.float32), -1.0, 1.0)
        if self.base is None:
            return bounded
        command: NDArray[np.float32] = np.clip(
            state.base_command + np.float32(self.residual_scale) * bounded, -1.0, 1.0
        ).astype(np.float32)
        return command

    def describe(self) -> dict[str, Any]:
        """All that is needed to build this again (JSON)."""
        return {
            "task": self.config.model_dump(mode="json"),
            "base": None
            if self.base is None
            else {"kind": kind_of(self.base), "settings": self.base.gains.model_dump(mode="json")},
            "residual_scale": self.residual_scale,
            "history_signals": list(HISTORY_SIGNALS),
            "history_lags": list(HISTORY_LAGS),
        }
