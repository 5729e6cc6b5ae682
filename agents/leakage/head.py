"""The leakage head: it estimates probability and size of a leak from two seconds of observations.

It works under any controller, because it reads only observations. ``MonitoredController`` attaches it to one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor, nn

from agents.controllers.base import Controller, Floats, ObservationLayout, as_batch
from agents.running.weights import StoredLayout, load_weights, require, save_weights
from hydro_env import ConfigurationError
from hydro_env.files import validate

KIND = "leakage head"
SIGNALS = ("position", "pressure_a", "pressure_b", "spool_position", "previous_command")
"""Measured signals that the head reads, in this order."""

N_CHANNELS = 18

SHORTEST_WINDOW = 56
"""Number of observations for which the last convolution has one output."""

LONGEST_WINDOW, LARGEST_WIDTH = 1_000_000, 1024
"""Largest numbers of observations and of channels of a convolution; more must be a mistake."""


class LeakageEstimate(NamedTuple):
    """Estimate of the head, each (N,); NaN until a whole window of observations is known."""

    probability: NDArray[np.float64]  # of a leak, 0 to 1
    flow_lpm: NDArray[np.float64]  # l/min at 100 bar


def channels(signals: Tensor) -> Tensor:
    """Input channels (N, 18, T) of the network from SIGNALS (N, 5, T) in the scales of the observation.

    Besides the signals these are the terms of the flow balance of each chamber (12), (13): the speed, the pressure
    rates, and the products of spool and pressures that make up the valve flows. A leak is the rest of this balance.
    """
    position, pressure_a, pressure_b, spool, command = signals.unbind(1)

    def rate(values: Tensor) -> Tensor:
        return torch.diff(values, dim=1, prepend=values[:, :1])

    size = spool.abs()
    rows = [
        position,
        pressure_a,
        pressure_b,
        spool,
        command,
        rate(position),
        rate(pressure_a),
        rate(pressure_b),
        pressure_a - pressure_b,
        spool * pressure_a,
        spool * pressure_b,
        size,
        size * pressure_a,
        size * pressure_b,
        spool * torch.sqrt(pressure_a.clamp(min=0.0)),
        spool * torch.sqrt(pressure_b.clamp(min=0.0)),
        (size + 0.02).log(),
        rate(spool),
    ]
    return torch.stack(rows, dim=1)


class LeakageNetwork(nn.Module):
    """Strided convolutions over time, pooled by mean and spread, then two outputs: logit and log10 of the flow."""

    mean: Tensor
    scale: Tensor

    def __init__(self, width: int = 48) -> None:
        super().__init__()
        self.width = width
        self.register_buffer("mean", torch.zeros(1, N_CHANNELS, 1))
        self.register_buffer("scale", torch.ones(1, N_CHANNELS, 1))
        self.convolutions = nn.Sequential(
            nn.Conv1d(N_CHANNELS, width, 8, stride=4),
            nn.ReLU(),
            nn.Conv1d(width, width, 5, stride=2),
            nn.ReLU(),
            nn.Conv1d(width, 2 * width, 5, stride=2),
            nn.ReLU(),
        )
        self.output = nn.Sequential(
            nn.Linear(4 * width, 128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU(), nn.Linear(64, 2)
        )

    def forward(self, signals: Tensor) -> Tensor:
        """(N, 2): logit of a leak, log10 of the flow in l/min at 100 bar, from SIGNALS (N, 5, T)."""
        inputs = (channels(signals) - self.mean) * self.scale
        hidden = self.convolutions(inputs)
        pooled = torch.cat([hidden.mean(dim=2), (hidden.var(dim=2, correction=0) + 1e-6).sqrt()], dim=1)
        result: Tensor = self.output(pooled)
        return result


@dataclass(frozen=True)
class HeadSettings:
    """Settings of inference besides the weights."""

    layout: ObservationLayout
    window: int  # observations
    threshold: float  # probability above which a leak is flagged: 1 % false alarms on validation plants
    training: dict[str, Any]


class HeadState(NamedTuple):
    """Memory of the head; no call changes its argument."""

    history: tuple[NDArray[np.float32], ...]
    """SIGNALS (N, 5) of the last observations, at most a window of them, newest last."""

    seen: NDArray[np.int64]
    """Observations since the start of each axis' episode, (N,)."""


class _StoredHead(StoredLayout):
    """The JSON beside the weights of a head."""

    signals: tuple[str, ...]
    window: int = Field(ge=SHORTEST_WINDOW, le=LONGEST_WINDOW)
    threshold: float = Field(ge=0.0, le=1.0)
    width: int = Field(ge=1, le=LARGEST_WIDTH)
    training: dict[str, Any]


class LeakageHead:
    """The trained network and its settings.

    ``predict`` processes one step at a time, with the signature of a controller; ``estimate`` takes whole windows.
    """

    def __init__(self, network: LeakageNetwork, settings: HeadSettings) -> None:
        self.network = network.eval()
        self.settings = settings
        self.columns = np.array([settings.layout.index(name) for name in SIGNALS])

    def predict(
        self,
        observation: Floats,
        state: HeadState | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float64], HeadState]:
        """Probability of a leak and its size in l/min at 100 bar, (2,) or (N, 2), and the memory for the next call.

        NaN until a whole window of observations is known. The arguments are those of a controller
        (:class:`~agents.controllers.base.Controller`).
        """
        del deterministic
        batch, single = as_batch(observation)
        state = self.remember(batch, state, episode_start)
        estimates = np.column_stack(self.estimate_remembered(state))
        return (estimates[0] if single else estimates), state

    def remember(
        self, observation: Floats, state: HeadState | None, episode_start: NDArray[np.bool_] | None = None
    ) -> HeadState:
        """Add observations (N, n) to the memory without running the network."""
        history, seen = state if state is not None else ((), np.zeros(len(observation), dtype=np.int64))
        if episode_start is not None:
            seen = np.where(episode_start, 0, seen)
        signals = np.asarray(observation[:, self.columns], dtype=np.float32)
        return HeadState((*history, signals)[-self.settings.window :], seen + 1)

    def estimate_remembered(self, state: HeadState) -> LeakageEstimate:
        """Probability and size of a leak from the stored windows (N,); NaN for an incomplete window."""
        window, count = self.settings.window, len(state.seen)
        full = state.seen >= window
        probability, flow = np.full(count, np.nan), np.full(count, np.nan)
        if full.any():
            signals = np.concatenate(state.history).reshape(window, count, len(SIGNALS))
            probability[full], flow[full] = self.estimate_signals(signals[:, full].transpose(1, 2, 0))
        return LeakageEstimate(probability, flow)

    def estimate(self, history: Floats) -> LeakageEstimate:
        """Probability and size of a leak.

        Args:
            history: observations (N, window, n) or (window, n), oldest first.

        Raises:
            ConfigurationError: the history has another shape.
        """
        array = np.asarray(history)
        if array.ndim == 2:
            array = array[None]
        wanted = (self.settings.window, len(self.settings.layout.names))
        if array.ndim != 3 or array.shape[1:] != wanted:
            raise ConfigurationError(
                f"leakage head: history has shape {np.shape(history)}: must be (N, {wanted[0]}, {wanted[1]})"
            )
        return self.estimate_signals(array[:, :, self.columns].transpose(0, 2, 1))

    def estimate_signals(self, signals: NDArray[Any], batch: int = 2048) -> LeakageEstimate:
        """Probability and size of a leak from SIGNALS, (N, 5, window)."""
        outputs = []
        with torch.no_grad():
            for first in range(0, len(signals), batch):
                part = torch.from_numpy(np.ascontiguousarray(signals[first : first + batch], dtype=np.float32))
                outputs.append(self.network(part).numpy())
        values = np.concatenate(outputs).astype(np.float64)
        return LeakageEstimate(1.0 / (1.0 + np.exp(-values[:, 0])), 10.0 ** np.clip(values[:, 1], -4.0, 2.0))

    def save(self, path: str | Path) -> Path:
        """Write weights and settings; see :func:`agents.running.weights.save_weights`."""
        settings = {
            **self.settings.layout.describe(),
            "signals": list(SIGNALS),
            "window": self.settings.window,
            "threshold": self.settings.threshold,
            "width": self.network.width,
            "training": self.settings.training,
        }
        tensors = {name: value.detach().cpu().numpy() for name, value in self.network.state_dict().items()}
        return save_weights(path, KIND, tensors, settings)

    @classmethod
    def load(cls, path: str | Path) -> LeakageHead:
        """Read what ``save`` wrote.

        Raises:
            ConfigurationError: missing, damaged or foreign files.
        """
        tensors, settings = load_weights(path, KIND)
        stored = validate(_StoredHead, settings, str(path))
        if stored.signals != SIGNALS:
            raise ConfigurationError(f"{path}: was trained on other signals than this version reads")
        bias = tensors.get("convolutions.0.bias")
        if bias is None or bias.shape != (stored.width,):  # checked before a network of that width takes memory
            raise ConfigurationError(f"{path}: width = {stored.width}: its tensors are of another network")
        network = LeakageNetwork(stored.width)
        require(tensors, {name: value.numpy() for name, value in network.state_dict().items()}, path)
        network.load_state_dict({name: torch.from_numpy(tensors[name].copy()) for name in network.state_dict()})
        try:
            return cls(network, HeadSettings(stored.layout, stored.window, stored.threshold, stored.training))
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from None


@dataclass
class MonitorState:
    """Memory of a monitored controller: the controller's own, and the head's."""

    controller: Any
    head: HeadState


class MonitoredController:
    """Any controller with the leakage head attached; its commands are those of the controller.

    ``estimate(state)`` runs the head on the last window of observations of each axis.
    """

    def __init__(self, controller: Controller, head: LeakageHead) -> None:
        self.controller = controller
        self.head = head

    def predict(
        self,
        observation: Floats,
        state: MonitorState | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], MonitorState]:
        """The controller's commands; the state also stores the observations for the head."""
        batch, single = as_batch(observation)
        inner, watching = (state.controller, state.head) if state is not None else (None, None)
        action, inner = self.controller.predict(batch, inner, episode_start, deterministic)
        watching = self.head.remember(batch, watching, episode_start)
        return (action[0] if single else action), MonitorState(inner, watching)

    def estimate(self, state: MonitorState) -> LeakageEstimate:
        """Probability and size of a leak on each axis (N,); NaN until a whole window is known."""
        return self.head.estimate_remembered(state.head)
