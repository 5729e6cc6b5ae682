"""Operations of simulated axes: their motions, and who acts on them; those of the head's training, and unseen ones."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.base import Controller, Observation, ObservationLayout, as_batch
from hydro_env import TaskConfig, task_config
from hydro_env.types import Floats, Singles

Span = tuple[float, float]

SLOWER = 12.0
SMALLEST_STEP = 1e-6  # m; steps of this size count as rest


def at_rest(config: TaskConfig) -> TaskConfig:
    """The task with constant references at the start of each episode."""
    return task_config(config, references={"weights": {"step": 1.0}, "step_range": (SMALLEST_STEP, SMALLEST_STEP)})


class _Operator:
    """Acts on N axes in one episode each, and remembers it: commands from the position error.

    They come beside the command that holds the initial position.
    """

    act: Callable[[Floats], Floats]  # commands (N,) from the error (N,) in strokes

    def __init__(self, config: TaskConfig) -> None:
        self.layout, self.control_period = ObservationLayout.of(config), config.control_period
        self.stroke = config.plant.cylinder.stroke

    def predict(self, observation: Observation, state: Any = None, *_: Any, **__: Any) -> tuple[Singles, bool]:
        """Commands (N, 1) of one control period, the first without ``state``; the arguments are a controller's."""
        batch = as_batch(observation)[0]
        error = self.layout.si(batch, "tracking_error") / self.stroke
        if state is None:
            self.time, self.holding = 0, self.layout.si(batch, "previous_command")  # control periods; (N,)
        command = self.act(error)
        self.time += 1
        return np.clip(command, -1.0, 1.0).astype(np.float32)[:, None], True


class Operation(_Operator):
    """Operates N axes in one manner, each with its own parameters, which the seed draws; one episode per axis.

    The arguments after the seed are ranges from which each axis draws; all are log-uniform.
    """

    def __init__(
        self,
        config: TaskConfig,
        count: int,
        seed: int,
        gain: Span = (2.0, 60.0),  # command for an error of one stroke
        delay: Span = (1.0, 1.0),  # control periods from the error to the command; 1: none
        interval: Span = (1.0, 1.0),  # control periods between two decisions
        step: Span = (1e-9, 1e-9),  # resolution of the command
        relay: Span = (1e-9, 1e-9),  # size of a relay command towards the reference, instead of the gain; 1e-9: none
        amplitude: Span = (1e-9, 1e-9),  # of the wave
        period: Span = (2.0, 2.0),  # of the wave, control periods
    ) -> None:
        super().__init__(config)
        self.generator = np.random.default_rng(seed)

        def drawn(span: Span) -> Floats:
            low, high = np.log(span)
            return np.exp(self.generator.uniform(low, high, count))

        self.gain, self.amplitude, self.relay, self.step = map(drawn, (gain, amplitude, relay, step))
        self.delay = drawn(delay).round().astype(int)
        self.interval, self.period = drawn(interval).round(), drawn(period).round()
        self.wave = self.generator.integers(0, 3, count)  # of the shapes below
        self.decided = self.level = np.zeros(count)

    def act(self, error: Floats) -> Floats:
        """Commands (N,): of the last decision, and a wave."""
        if self.time == 0:  # as if the error had been the same for long
            self.errors = np.repeat(error[None], self.delay.max(), 0)
        time, axes = self.time, np.arange(len(error))
        self.errors = np.concatenate([self.errors[1:], error[None]])
        seen = self.errors[len(self.errors) - self.delay, axes]
        wanted = np.where(self.relay > 1e-6, self.relay * np.sign(seen), self.gain * seen)
        self.decided = np.where(time % self.interval == 0, np.round(wanted / self.step) * self.step, self.decided)
        phase = time % self.period / self.period
        new_level = (time % np.maximum(self.period // 2, 1)) == 0
        self.level = np.where(new_level, self.generator.uniform(-1.0, 1.0, len(error)), self.level)
        # Sine, square, and noise, which is a new level in each half period.
        shapes = np.stack([np.sin(2.0 * np.pi * phase), np.where(phase < 0.5, 1.0, -1.0), self.level])
        return self.holding + self.decided + self.amplitude * shapes[self.wave, axes]


class _Unseen(_Operator):
    """An operation outside the training; each axis draws its own four numbers, 0 to 1, for its law.

    A law gives the commands (N,) relative to the holding command from this object and the error in strokes.
    """

    def __init__(self, law: "Callable[[_Unseen, Floats], Floats]", config: TaskConfig, count: int, seed: int):
        super().__init__(config)
        self.law = law
        self.numbers = np.random.default_rng([seed, 7]).random((4, count))

    def act(self, error: Floats) -> Floats:
        if self.time == 0:
            self.last, self.command = error, np.zeros_like(error)  # of the previous sample
        self.command = self.law(self, error)
        self.last = error
        return self.holding + self.command


def _sliding_mode(axes: _Unseen, error: Floats) -> Floats:
    """A switching surface of error and speed of the error, with a boundary layer (Slotine and Li, 1991, chapter 7)."""
    lead, layer, size, _ = axes.numbers
    surface = error + (0.005 + 0.02 * lead) * (error - axes.last) / axes.control_period
    return (0.1 + 0.5 * size) * np.tanh(surface / (0.002 + 0.01 * layer))


def _three_step(axes: _Unseen, error: Floats) -> Floats:
    """A switch with a dead band (out, hold, in), like a simple control with proximity switches."""
    band, size = 0.003 + 0.01 * axes.numbers[0], 0.05 + 0.3 * axes.numbers[1]
    keep = (axes.command != 0.0) & (np.abs(error) > 0.3 * band) & (np.sign(error) == np.sign(axes.command))
    return np.where((np.abs(error) > band) | keep, size * np.sign(error), 0.0)


def _swept_sine(axes: _Unseen, error: Floats) -> Floats:
    """A sine of rising frequency in open loop, like in a measurement of the frequency response."""
    time, rate = axes.time * axes.control_period, 1.0 + 4.0 * axes.numbers[1]
    size = 0.03 + 0.2 * axes.numbers[0]
    return 0.2 * error + size * np.sin(2.0 * np.pi * (1.0 + 0.5 * rate * time) * time)


def slow(config: TaskConfig) -> TaskConfig:
    """The task with references that are slower by the factor :data:`SLOWER`."""
    r = config.references
    low, high = r.frequency_range
    changes = {
        "speed_share": r.speed_share / SLOWER,
        "acceleration_limit": max(r.acceleration_limit / SLOWER**2, 0.011),
        "frequency_range": (low / SLOWER, high / SLOWER),
    }
    return task_config(config, references=r.model_dump() | changes)


def loaded(config: TaskConfig) -> TaskConfig:
    """The task with changing external forces."""
    return task_config(config, disturbance=config.disturbance.model_dump() | {"kind": "mixed"})


def _shipped(kind: str, config: TaskConfig, count: int, seed: int) -> Controller:
    from hydro_agents.learning.loading import shipped

    return shipped(kind, config)


UNSEEN = {"sliding mode": _sliding_mode, "three-step switch": _three_step, "swept sine": _swept_sine}
"""Laws that are not part of the leakage head's training."""

ACTING: dict[str, Callable[[TaskConfig, int, int], Controller]] = {
    "PID": partial(_shipped, "pid"),
    "PPO on flow linearisation": partial(_shipped, "ppo"),
    "flow-linearising": partial(_shipped, "flow_linearising"),
    "proportional": Operation,
    "by hand": partial(Operation, gain=(2.0, 20.0), delay=(20.0, 60.0), interval=(15.0, 100.0), step=(0.01, 0.1)),
    "chattering": partial(Operation, relay=(0.02, 0.5), delay=(1.0, 3.0)),
    "dithering": partial(Operation, gain=(5.0, 50.0), amplitude=(0.01, 0.15), period=(2.0, 15.0)),
    "open loop": partial(Operation, gain=(0.2, 2.0), amplitude=(0.02, 0.6), period=(30.0, 600.0)),
    **{name: partial(_Unseen, law) for name, law in UNSEEN.items()},
}
"""Controllers of the axes, by name, from task, number of axes and seed."""

MOTIONS = {
    "ordinary": lambda config: config,  # all kinds of reference
    "slow": slow,
    "standing still": at_rest,
    "changing loads": loaded,
}
"""Motions of the axes, changes of the task, by name."""


class OperationShare(NamedTuple):
    """A part of the training data: its share, the motion of the axes, and their manner of operation."""

    share: float
    motion: str  # of MOTIONS
    manner: str = ""  # of ACTING; default: the controllers of the study


OPERATIONS = (
    OperationShare(0.23, "ordinary"),
    OperationShare(0.08, "slow"),
    OperationShare(0.11, "standing still"),
    OperationShare(0.06, "changing loads"),
    OperationShare(0.08, "ordinary", "proportional"),
    OperationShare(0.07, "standing still", "proportional"),
    OperationShare(0.10, "ordinary", "by hand"),
    OperationShare(0.08, "ordinary", "chattering"),
    OperationShare(0.03, "standing still", "chattering"),
    OperationShare(0.05, "ordinary", "dithering"),
    OperationShare(0.03, "standing still", "dithering"),
    OperationShare(0.08, "ordinary", "open loop"),
)
"""The mixture of the training data."""
