"""PID with anti-windup, derivative filter and velocity feed-forward; works on one axis or on many at once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from agents.controllers.base import Floats, ObservationLayout, as_batch
from hydro_env.files import Group, read_yaml, validate, write_yaml


class PIDGains(Group):
    """Gains of :class:`PID`; the command is in parts of 10 V, lengths in m, times in s."""

    proportional: float = Field(20.0, ge=0.0, le=1e4, description="1/m")
    integral: float = Field(40.0, ge=0.0, le=1e5, description="1/(m s)")
    derivative: float = Field(0.0, ge=0.0, le=1e3, description="s/m, on the error of the speed")
    derivative_filter_time: float = Field(0.005, ge=0.0, le=1.0, description="s, first-order")
    feedforward_extending: float = Field(6.0, ge=0.0, le=1e3, description="s/m: command per reference speed")
    feedforward_retracting: float = Field(8.0, ge=0.0, le=1e3, description="s/m")
    feedforward_lead: float = Field(0.008, ge=0.0, le=0.1, description="s: lead of the reference speed")
    reference_lead: float = Field(0.0, ge=0.0, le=0.1, description="s: lead of the reference position")
    anti_windup_time: float = Field(0.05, gt=0.0, le=10.0, description="s, back-calculation while saturated")

    @classmethod
    def from_yaml(cls, path: str | Path) -> PIDGains:
        """Read gains from YAML.

        Raises:
            ConfigurationError: unreadable file, unknown key or impossible value.
        """
        return validate(cls, read_yaml(path), str(path))

    def to_yaml(self, path: str | Path) -> None:
        """Write the gains as YAML."""
        write_yaml(path, self.model_dump())


@dataclass
class PIDState:
    """Memory of the controller, each (N,)."""

    integral: NDArray[np.float64]
    velocity: NDArray[np.float64]
    position: NDArray[np.float64]


class PID:
    """u = K_p e + K_i ∫e dt + K_d (ẋ_ref − ẋ) + K_ff ẋ_ref, limited to ±1.

    The preview gives e and ẋ_ref with a lead that compensates latency and valve. The derivative acts on the filtered
    difference of the measured position. While the command saturates, back-calculation unwinds the integral. The start
    is bumpless: the integral takes over the command that holds the axis.

    Args:
        gains: one set, or arrays (N,) of each gain through ``PIDGains.model_construct``, for tuning.
        layout: of the observations.
    """

    def __init__(self, gains: PIDGains, layout: ObservationLayout) -> None:
        self.gains = gains
        self.layout = layout
        self._column = {name: layout.index(name) for name in ("tracking_error", "position", "previous_command")}
        self._times = np.array([0.0, *layout.preview_times])
        self._middles = 0.5 * (self._times[1:] + self._times[:-1])

    def predict(
        self,
        observation: Floats,
        state: PIDState | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], PIDState]:
        """Commands for the observations; see :class:`~agents.controllers.base.Controller`."""
        del deterministic
        batch, single = as_batch(observation)
        g, period = self.gains, self.layout.control_period
        error = self.layout.si(batch, "tracking_error")
        position = self.layout.si(batch, "position")
        command_before = self.layout.si(batch, "previous_command")
        ahead = np.concatenate([np.zeros((len(batch), 1)), self.layout.previews(batch)], axis=1)
        if state is None:
            state = PIDState(command_before.copy(), np.zeros(len(batch)), position.copy())
        elif episode_start is not None and np.any(episode_start):
            started = np.asarray(episode_start, dtype=np.bool_)
            state = PIDState(
                np.where(started, command_before, state.integral),
                np.where(started, 0.0, state.velocity),
                np.where(started, position, state.position),
            )

        speeds = np.diff(ahead, axis=1) / np.diff(self._times)
        reference_speed = _interpolate(g.feedforward_lead, self._middles, speeds)
        error = error + _interpolate(g.reference_lead, self._times, ahead)
        blend = period / (period + g.derivative_filter_time)
        velocity = state.velocity + blend * ((position - state.position) / period - state.velocity)
        feedforward = np.where(reference_speed > 0.0, g.feedforward_extending, g.feedforward_retracting)
        integral = state.integral + g.integral * period * error
        wanted = (
            g.proportional * error
            + integral
            + g.derivative * (reference_speed - velocity)
            + feedforward * reference_speed
        )
        command = np.clip(wanted, -1.0, 1.0)
        integral = integral + (command - wanted) * np.minimum(period / np.asarray(g.anti_windup_time), 1.0)
        action = command.astype(np.float32)[:, None]
        return (action[0] if single else action), PIDState(integral, velocity, position)


def _interpolate(time: Any, times: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Each row of ``values`` (N, times) at ``time`` (one, or one per row), interpolated; constant beyond the ends."""
    result: NDArray[np.float64]
    if np.ndim(time) == 0:  # one set of gains for all axes needs only two columns
        one = min(max(float(time), float(times[0])), float(times[-1]))
        column = min(max(int(np.searchsorted(times, one)), 1), len(times) - 1)
        weight = (one - times[column - 1]) / (times[column] - times[column - 1])
        result = values[:, column - 1] * (1.0 - weight) + values[:, column] * weight
        return result
    at = np.clip(np.asarray(time, dtype=np.float64), times[0], times[-1])
    right = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    share = (at - times[right - 1]) / (times[right] - times[right - 1])
    rows = np.arange(len(values))
    result = values[rows, right - 1] * (1.0 - share) + values[rows, right] * share
    return result
