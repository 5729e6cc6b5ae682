"""Ways in which axes are operated, for the training of the leakage head: by hand, chattering, open loop, and so on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Floats, ObservationLayout, as_batch
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config

Array = NDArray[np.float64]
Span = tuple[float, float]

WAVES = ("sine", "square", "noise")
"""Waves that may be added to the command; noise is a new random level in each half period."""


class Manner(NamedTuple):
    """How an axis is operated: ranges from which each axis draws; all are log-uniform."""

    gain: Span = (2.0, 60.0)  # command for an error of one stroke
    delay: Span = (1.0, 1.0)  # control periods from the error to the command; 1: none
    interval: Span = (1.0, 1.0)  # control periods between two decisions
    step: Span = (1e-9, 1e-9)  # resolution of the command
    relay: Span = (1e-9, 1e-9)  # size of a relay command towards the reference, instead of the gain; 1e-9: none
    amplitude: Span = (1e-9, 1e-9)  # of the wave
    period: Span = (2.0, 2.0)  # of the wave, control periods
    waves: tuple[str, ...] = WAVES


MANNERS = {
    "proportional": Manner(),
    "by hand": Manner(gain=(2.0, 20.0), delay=(20.0, 60.0), interval=(15.0, 100.0), step=(0.01, 0.1)),
    "chattering": Manner(relay=(0.02, 0.5), delay=(1.0, 3.0)),
    "dithering": Manner(gain=(5.0, 50.0), amplitude=(0.01, 0.15), period=(2.0, 15.0)),
    "open loop": Manner(gain=(0.2, 2.0), amplitude=(0.02, 0.6), period=(30.0, 600.0)),
}
"""Manners by name."""


class OperationState(NamedTuple):
    """Memory of :class:`Operation`."""

    time: int  # control periods since the start
    holding: Array  # (N,), command that holds the initial position
    decided: Array  # (N,), command of the last decision
    level: Array  # (N,), of the noise
    errors: NDArray[np.float64]  # (longest delay, N)


class Operation:
    """Operates N axes in one manner, each with its own parameters; one episode per axis.

    Args:
        manner: ranges of the parameters.
        config: the task.
        count: number of axes N.
        seed: of the parameters.
    """

    def __init__(self, manner: Manner, config: TaskConfig, count: int, seed: int) -> None:
        self.layout = ObservationLayout.of(config)
        self.generator = np.random.default_rng(seed)
        self.stroke = config.plant.cylinder.stroke

        def drawn(span: Span) -> Array:
            return np.exp(self.generator.uniform(np.log(span[0]), np.log(span[1]), count))

        self.gain, self.amplitude, self.relay = drawn(manner.gain), drawn(manner.amplitude), drawn(manner.relay)
        self.has_relay = self.relay > 1e-6
        self.step = drawn(manner.step)
        self.delay = drawn(manner.delay).round().astype(int)
        self.interval, self.period = drawn(manner.interval).round(), drawn(manner.period).round()
        self.wave = self.generator.integers(0, len(manner.waves), count)
        self.wave = np.array([WAVES.index(name) for name in manner.waves])[self.wave]

    def predict(
        self,
        observation: Floats,
        state: OperationState | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Any]:
        """Commands (N, 1) of one control period; the arguments are those of a controller."""
        del episode_start, deterministic
        batch, _ = as_batch(observation)
        error = self.layout.si(batch, "tracking_error") / self.stroke
        if state is None:
            holding = self.layout.si(batch, "previous_command")
            errors = np.repeat(error[None], int(self.delay.max()), axis=0)
            state = OperationState(0, holding, np.zeros_like(error), np.zeros_like(error), errors)
        errors = np.concatenate([state.errors[1:], error[None]])
        seen = errors[len(errors) - self.delay, np.arange(len(error))]
        wanted = np.where(self.has_relay, self.relay * np.sign(seen), self.gain * seen)
        decided = np.where(state.time % self.interval == 0, np.round(wanted / self.step) * self.step, state.decided)
        phase = state.time % self.period / self.period
        new_level = (state.time % np.maximum(self.period // 2, 1)) == 0
        level = np.where(new_level, self.generator.uniform(-1.0, 1.0, len(error)), state.level)
        shapes = np.stack([np.sin(2.0 * np.pi * phase), np.where(phase < 0.5, 1.0, -1.0), level])
        command = state.holding + decided + self.amplitude * shapes[self.wave, np.arange(len(error))]
        action = np.clip(command, -1.0, 1.0).astype(np.float32)[:, None]
        return action, OperationState(state.time + 1, state.holding, decided, level, errors)


def slow(config: TaskConfig, factor: float = 12.0) -> TaskConfig:
    """The task with references that are slower by a factor."""
    r = config.references
    low, high = r.frequency_range
    changes = {
        "speed_share": r.speed_share / factor,
        "acceleration_limit": max(r.acceleration_limit / factor**2, 0.011),
        "frequency_range": (low / factor, high / factor),
    }
    return task_config(config, references=r.model_dump() | changes)


def still(config: TaskConfig) -> TaskConfig:
    """The task with constant references, each at its own position."""
    changes = {"weights": {"step": 1.0}, "step_range": (1e-6, 1e-6)}
    return task_config(config, references=config.references.model_dump() | changes)


def loaded(config: TaskConfig) -> TaskConfig:
    """The task with changing external forces."""
    return task_config(config, disturbance=config.disturbance.model_dump() | {"kind": "mixed"})


class Row(NamedTuple):
    """A part of the training data: its share, the task of the axes, and their manner of operation."""

    name: str
    share: float
    task: Callable[[TaskConfig], TaskConfig]
    manner: Manner | None  # None: the controllers of the study


def _as_it_is(config: TaskConfig) -> TaskConfig:
    return config


OPERATIONS = (
    Row("controllers", 0.23, _as_it_is, None),
    Row("controllers, slow references", 0.08, slow, None),
    Row("controllers, standing still", 0.11, still, None),
    Row("controllers, changing loads", 0.06, loaded, None),
    Row("proportional", 0.08, _as_it_is, MANNERS["proportional"]),
    Row("proportional, standing still", 0.07, still, MANNERS["proportional"]),
    Row("by hand", 0.10, _as_it_is, MANNERS["by hand"]),
    Row("chattering", 0.08, _as_it_is, MANNERS["chattering"]),
    Row("chattering, standing still", 0.03, still, MANNERS["chattering"]),
    Row("dithering", 0.05, _as_it_is, MANNERS["dithering"]),
    Row("dithering, standing still", 0.03, still, MANNERS["dithering"]),
    Row("open loop", 0.08, _as_it_is, MANNERS["open loop"]),
)
"""The mixture of the training data."""
