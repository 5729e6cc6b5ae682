"""Simulated axes in long, continuous operation, and the looks of a detector at them, as jobs that can be resumed.

An episode holds one family and begins at rest. The reference of an axis at work consists of stretches of 10 to 60 s,
each with its own family, at full speed, at a sixteenth of it, or standing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import SIGNALS, Detector, MeasuredColumns
from hydro_agents.detection.looks import Activity, Looks, joined, look, window_of
from hydro_agents.running.jobs import Columns, Job, Report, fingerprint, run_jobs
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.configuration import LeakageDraw, task_config
from hydro_env.task.reference_signals import FAMILIES
from hydro_env.task.settings import choice

SHARES = {Activity.STANDING: 0.55, Activity.SLOW: 0.2, Activity.MOVING: 0.25}
PACE = {Activity.STANDING: 0.0, Activity.SLOW: 1.0 / 16.0, Activity.MOVING: 1.0}
STRETCH = (10.0, 60.0)  # duration of a stretch in s, drawn log-uniformly
FADE = 2.0  # time in s in which the reference passes from one family to the next

TOGETHER = 4  # largest number of axes of a job

_ONSET = choice(LeakageDraw, "schedule", "onset")


@dataclass(frozen=True)
class Work:
    """Healthy axes at work, with consecutive seeds."""

    first_seed: int
    axes: int
    duration: float  # s, without a leak
    interval: float  # s, between looks
    after: float = 0.0  # s, that follow with each leak
    leaks: tuple[float, ...] = ()  # l/min at 100 bar, that begin then; each continues the same axes


def simulate(config: TaskConfig, controller: Controller, detector: Detector, work: Work) -> list[Looks]:
    """Simulate axes at work and look at them at regular times; axes, references and noise depend on the seeds alone.

    Returns:
        Looks at the healthy axes, then the looks with each leak, all with the same past.

    Raises:
        ConfigurationError: the work is shorter than a window, or an axis cannot begin.
    """
    running = _Running(config, controller, detector, work)
    looks = [running.looks(running.change)]
    past, plants = deepcopy(running.state), running.env.get_state()
    for leak in work.leaks:
        running.state = deepcopy(past)
        running.env.set_state(plants)
        running.begin(leak)
        looks.append(running.looks(running.end))
    running.env.close()
    return looks


@dataclass
class _State:
    """What changes from step to step, but for the plants."""

    observation: NDArray[Any]
    window: NDArray[np.float64]  # (N, 5, length): the last measured signals, in a ring
    alive: NDArray[np.bool_]  # (N,)
    detector: Detector
    controller_memory: Any = None
    step: int = 0


class _Running:
    """Axes at work."""

    def __init__(self, config: TaskConfig, controller: Controller, detector: Detector, work: Work) -> None:
        self.controller, self.known, self.period = controller, config, config.control_period
        self.every = max(round(work.interval / self.period), 1)
        self.change = round(work.duration / self.period)
        self.end = self.change + round(work.after / self.period)
        self.length = window_of(detector, config)
        if self.change < self.length:
            raise ConfigurationError(
                f"alarms: work of {work.duration:g} s is shorter than a window of {self.length * self.period:g} s"
            )
        leakage = {**config.leakage.model_dump(), "schedule": "constant"}
        # One period more than is simulated: no axis restarts.
        self.config = task_config(config, episode_duration=(self.end + 1) * self.period, leakage=leakage)
        self.measured = MeasuredColumns.of(self.config)
        self.seeds = np.arange(work.first_seed, work.first_seed + work.axes)
        self.env = ServoHydraulicVectorEnv(work.axes, self.config, info=False)
        references = working_references(self.config, self.seeds)
        low, high = np.log(self.config.leakage.healthy_range)
        flows = [np.exp(np.random.default_rng([int(seed), 2]).uniform(low, high)) for seed in self.seeds]
        options: dict[str, Any] = {"reference": references, "leakage_flow_lpm": np.array(flows)}
        observation, _ = self.env.reset(seed=[int(seed) for seed in self.seeds], options=options)
        window = np.full((work.axes, len(SIGNALS), self.length), np.nan)
        self.state = _State(observation, window, np.ones(work.axes, dtype=np.bool_), deepcopy(detector))

    def begin(self, leak_lpm: float) -> None:
        """Let the seals of all axes leak from now on, l/min at 100 bar."""
        row = self.env.axes.record
        row["leak_schedule"] = _ONSET
        row["leak_start_time"] = self.state.step * self.period
        row["leak_start_flow"] = row["leak_flow"]
        row["leak_target_flow"] = leak_lpm

    def looks(self, end: int) -> Looks:
        """Run up to a step; the looks since the last call."""
        now, rows = self.state, []
        while now.step < end:
            seen = now.observation[:, self.measured.columns] * self.measured.scale
            now.window[:, self.measured.rows, now.step % self.length] = seen
            if now.step + 1 >= self.length and (now.step + 1 - self.length) % self.every == 0:
                signals, time = np.roll(now.window, -(now.step + 1), axis=2), now.step * self.period
                score, *rest = look(now.detector, signals, self.known, time)
                flow = self.env.axes.column("leak_flow").copy()
                rows.append((time, np.where(now.alive, score, np.nan), *rest, flow))
            started = np.full(len(self.seeds), now.step == 0)
            action, now.controller_memory = self.controller.predict(
                now.observation, now.controller_memory, started, True
            )
            now.observation, _, terminated, _, _ = self.env.step(np.where(now.alive[:, None], action, 0.0))
            now.alive = now.alive & ~terminated
            now.step += 1
        times, *columns = zip(*rows, strict=True)
        return Looks(np.array(times), *(np.stack(values, axis=1) for values in columns))


@dataclass(frozen=True)
class Bench:
    """Settings that all looks of a calibration share."""

    config: TaskConfig
    controllers: Sequence[Controller]  # in turn, one for each job
    detector: Detector
    detector_name: str
    folder: Path | None = None  # for the results of the jobs; None keeps none
    progress: Report | None = None  # called when a job finishes

    def looks(self, name: str, work: Work) -> list[Looks]:
        """Looks at healthy axes and with each leak; see :func:`simulate`. ``name`` is that of the jobs.

        Raises:
            ConfigurationError: work is shorter than a window, or an axis cannot begin.
        """
        jobs: dict[str, Job] = {}
        acting = [((each, self.detector), fingerprint(each, self.detector)) for each in self.controllers]
        fair = math.ceil(work.axes / len(acting))
        size = TOGETHER if work.axes > TOGETHER else fair  # each controller gets a part
        for number, first in enumerate(range(0, work.axes, size)):
            participant, digest = acting[number % len(acting)]
            part = replace(work, first_seed=work.first_seed + first, axes=min(size, work.axes - first))
            jobs[f"{name}|{number}"] = Job(simulated, participant, (self.config, part), digest)
        results = run_jobs(jobs, self.folder, None, self.progress)[0]
        parts = []
        for result in (results[key] for key in jobs):
            if result.error:
                raise ConfigurationError(result.error)
            each = range(1 + len(work.leaks))
            parts.append([Looks(*(result.metrics[f"{row}.{field}"] for field in Looks._fields)) for row in each])
        return [joined(column) for column in zip(*parts, strict=True)]


def simulated(acting: tuple[Controller, Detector], config: TaskConfig, work: Work) -> Columns:
    """The looks of :func:`simulate`, named ``0.time``, ``0.score``, ….

    Raises:
        ConfigurationError: the work is shorter than a window, or an axis cannot begin.
    """
    each = simulate(config, *acting, work)
    return {f"{row}.{field}": values for row, looks in enumerate(each) for field, values in looks._asdict().items()}


def working_references(config: TaskConfig, seeds: NDArray[np.int64]) -> NDArray[np.float64]:
    """References of N axes at work, m, (N, samples of an episode with its preview).

    Args:
        config: the task; its episode is as long as the operation.
        seeds: seeds of the axes (N,); the references stay within the limits of the plants that they draw.
    """
    names = [name for name in FAMILIES if name != "user" and config.references.weights.get(name, 0.0) > 0.0]
    env = ServoHydraulicVectorEnv(len(seeds), config, info=False)
    families = []
    for name in names:
        env.reset(seed=[int(seed) for seed in seeds], options={"reference": name})
        families.append(env.axes.reference.copy())
    env.close()
    return np.array([_joined([rows[axis] for rows in families], config, int(seed)) for axis, seed in enumerate(seeds)])


def _joined(families: Sequence[NDArray[np.float64]], config: TaskConfig, seed: int) -> NDArray[np.float64]:
    """The reference of one axis, from one of each family."""
    generator, period = np.random.default_rng([seed, 1]), config.control_period
    samples = len(families[0])
    row = np.empty(samples)
    clocks = np.zeros(len(families))  # in samples: where each family goes on
    first, held = 0, families[0][0]
    activities, shares = list(SHARES), list(SHARES.values())
    while first < samples:
        duration = np.exp(generator.uniform(*np.log(STRETCH)))
        family = int(generator.integers(len(families)))
        pace = PACE[activities[generator.choice(len(shares), p=shares)]]
        last = min(first + max(round(duration / period), 1), samples)
        ahead = clocks[family] + pace * np.arange(last - first)
        stretch = np.interp(ahead, np.arange(samples), families[family])
        share = np.minimum(np.arange(last - first) * period / FADE, 1.0)
        weight = share**3 * (10.0 + share * (6.0 * share - 15.0))
        row[first:last] = held + weight * (stretch - held)
        clocks[family] = ahead[-1] + pace
        first, held = last, row[last - 1]
    return row
