"""Operations of the axes of the protocol: those of the head's training, and unseen ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, Floats, ObservationLayout, as_batch
from hydro_agents.detection.manners import MANNERS, Operation, loaded, slow, still
from hydro_agents.learning.opponents import shipped
from hydro_env import TaskConfig

Make = Callable[[TaskConfig, int, int], Controller]
"""Makes the controller of the axes from the task, the number of axes and a seed."""


class Acting(NamedTuple):
    """The controller of the axes."""

    make: Make
    trained: bool  # whether it is part of the leakage head's training


class Motion(NamedTuple):
    """The motion of the axes: a change of the task."""

    change: Callable[[TaskConfig], TaskConfig]
    label: str


def _shipped(kind: str) -> Make:
    return lambda config, count, seed: shipped(kind, config)


def _manner(name: str) -> Make:
    return lambda config, count, seed: Operation(MANNERS[name], config, count, seed)


class _Memory(NamedTuple):
    time: int  # control periods since the start
    holding: NDArray[np.float64]  # (N,), command that holds the initial position
    error: NDArray[np.float64]  # (N,), of the previous sample
    command: NDArray[np.float64]  # (N,)


class _Unseen:
    """Base of the operations outside the training; each axis draws its own parameters."""

    def __init__(self, config: TaskConfig, count: int, seed: int) -> None:
        self.layout, self.period = ObservationLayout.of(config), config.control_period
        self.stroke = config.plant.cylinder.stroke
        self.numbers = np.random.default_rng([seed, 7]).random((4, count))

    def command(self, memory: _Memory, error: NDArray[np.float64]) -> NDArray[np.float64]:
        """Commands (N,) relative to the holding command; ``error`` (N,) in strokes."""
        raise NotImplementedError

    def predict(
        self,
        observation: Floats,
        state: _Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Commands (N, 1); the arguments are those of a controller."""
        del episode_start, deterministic
        batch, _ = as_batch(observation)
        error = self.layout.si(batch, "tracking_error") / self.stroke
        if state is None:
            state = _Memory(0, self.layout.si(batch, "previous_command"), error, np.zeros_like(error))
        command = self.command(state, error)
        action = np.clip(state.holding + command, -1.0, 1.0).astype(np.float32)[:, None]
        return action, _Memory(state.time + 1, state.holding, error, command)


class SlidingMode(_Unseen):
    """A switching surface of error and speed of the error, with a boundary layer (Slotine and Li, 1991, chapter 7)."""

    def command(self, memory: _Memory, error: NDArray[np.float64]) -> NDArray[np.float64]:
        """Commands (N,)."""
        lead, layer, size, _ = self.numbers
        surface = error + (0.005 + 0.02 * lead) * (error - memory.error) / self.period
        return np.asarray((0.1 + 0.5 * size) * np.tanh(surface / (0.002 + 0.01 * layer)))


class ThreeStep(_Unseen):
    """A switch with a dead band (out, hold, in), like a simple control with proximity switches."""

    def command(self, memory: _Memory, error: NDArray[np.float64]) -> NDArray[np.float64]:
        """Commands (N,)."""
        band, size = 0.003 + 0.01 * self.numbers[0], 0.05 + 0.3 * self.numbers[1]
        keep = (memory.command != 0.0) & (np.abs(error) > 0.3 * band) & (np.sign(error) == np.sign(memory.command))
        return np.where((np.abs(error) > band) | keep, size * np.sign(error), 0.0)


class SweptSine(_Unseen):
    """A sine of rising frequency in open loop, like in a measurement of the frequency response."""

    def command(self, memory: _Memory, error: NDArray[np.float64]) -> NDArray[np.float64]:
        """Commands (N,)."""
        time, rate = memory.time * self.period, 1.0 + 4.0 * self.numbers[1]
        size = 0.03 + 0.2 * self.numbers[0]
        return np.asarray(0.2 * error + size * np.sin(2.0 * np.pi * (1.0 + 0.5 * rate * time) * time))


ACTING: dict[str, Acting] = {
    "PID": Acting(_shipped("pid"), True),
    "PPO": Acting(_shipped("ppo"), True),
    "flow-linearising": Acting(_shipped("flow_linearising"), True),
    **{name: Acting(_manner(name), True) for name in MANNERS},
    "ADRC": Acting(_shipped("adrc"), False),
    "LQG": Acting(_shipped("lqg"), False),
    "sliding mode": Acting(SlidingMode, False),
    "three-step switch": Acting(ThreeStep, False),
    "swept sine": Acting(SweptSine, False),
}
"""Controllers of the axes, by name."""

MOTIONS: dict[str, Motion] = {
    "ordinary": Motion(lambda config: config, "all kinds of reference"),
    "slow": Motion(slow, "references 12 times slower"),
    "standing still": Motion(still, "a place that is held"),
    "changing loads": Motion(loaded, "changing external forces"),
}
"""Motions of the axes, by name."""
