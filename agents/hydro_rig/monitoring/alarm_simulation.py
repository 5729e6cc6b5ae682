"""Simulated axes in long, continuous operation, and the looks of a detector at them, as jobs that can be resumed.

An episode holds one family and begins at rest. The reference of an axis at work consists of stretches of 10 to 60 s,
each with its own family, at full speed, at a sixteenth of it, or standing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import Detector, MeasuredColumns
from hydro_agents.detection.features import SIGNALS
from hydro_agents.detection.looks import Activity, Looks, joined, look, window_of
from hydro_agents.running.jobs import Columns, Job, Report, fingerprint, run_jobs
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.configuration import LeakageDraw, task_config
from hydro_env.task.faults import FAULT_KINDS, FAULTS, KIND_OF_FAULT, Fault
from hydro_env.task.reference_signals import FAMILIES
from hydro_env.task.settings import choice

SHARES = {Activity.STANDING: 0.55, Activity.SLOW: 0.2, Activity.MOVING: 0.25}
PACE = {Activity.STANDING: 0.0, Activity.SLOW: 1.0 / 16.0, Activity.MOVING: 1.0}
STRETCH = (10.0, 60.0)  # duration of a stretch in s, drawn log-uniformly
FADE = 2.0  # time in s in which the reference passes from one family to the next

_ONSET, _GROWTH = (choice(LeakageDraw, "schedule", name) for name in ("onset", "growth"))
_FAULT_ONSET = choice(Fault, "schedule", "onset")


@dataclass(frozen=True)
class Onset:
    """Change of the axes after ``Work.duration``; each onset continues the same axes."""

    leak_lpm: float | None = None  # at 100 bar; None: the seal stays healthy
    then: Activity | None = None  # from then on; None: all activities in turn
    grows: bool = False  # log-linearly until the end, instead of suddenly
    fault: tuple[str, float] | None = None  # one of hydro_env.task.faults.FAULTS and its magnitude, sudden

    @property
    def activity(self) -> str:
        """The activity of the axes from then on, as a word; ``all``: all in turn."""
        return self.then.name.lower() if self.then is not None else "all"

    @property
    def name(self) -> str:
        """Name for files and tables."""
        parts = ["none" if self.leak_lpm is None else f"{self.leak_lpm:g}"]
        parts += [self.activity] if self.then is not None else []
        parts += ["growing"] if self.grows else []
        return "_".join([*parts, *(f"{value}" for value in self.fault or ())])


class OnsetLooks(NamedTuple):
    """Looks at axes before and after an onset."""

    onset: Onset
    time: float  # s, of the onset
    before: Looks
    after: Looks


@dataclass(frozen=True)
class Work:
    """Axes at work, with consecutive seeds."""

    first_seed: int
    axes: int
    duration: float  # s, up to the onset
    interval: float  # s, between looks
    leak_lpm: float | None = None  # at 100 bar, from the start; None: healthy, drawn by the seed
    after: float = 0.0  # s, that follow each onset
    onsets: tuple[Onset, ...] = ()  # each continues the same axes

    def found(self, looks: list[Looks]) -> list[OnsetLooks]:
        """Its looks (:func:`simulate`), onset by onset."""
        before, *each = looks
        pairs = zip(self.onsets, each, strict=True)
        return [OnsetLooks(onset, self.duration, before, after) for onset, after in pairs]


def simulate(config: TaskConfig, controller: Controller, detector: Detector, work: Work) -> list[Looks]:
    """Simulate axes at work and look at them at regular times; axes, references and noise depend on the seeds alone.

    Returns:
        Looks at the axes up to the onset, then the looks after each onset, all with the same past.

    Raises:
        ConfigurationError: the work is shorter than a window, or an axis cannot begin.
    """
    running = _Running(config, controller, detector, work)
    results, start = [running.looks(running.change)], running.memory()
    for onset in work.onsets:
        running.recall(start)
        running.begin(onset)
        results.append(running.looks(running.end))
    running.env.close()
    return results


class _Running:
    """Axes at work; :meth:`recall` returns to an earlier state for the next onset."""

    def __init__(self, config: TaskConfig, controller: Controller, detector: Detector, work: Work) -> None:
        self.controller, self.detector, self.work = controller, deepcopy(detector), work
        self.known, self.period = config, config.control_period
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
        options: dict[str, Any] = {"reference": references, "leakage_flow_lpm": self._flows()}
        self.observation, _ = self.env.reset(seed=[int(seed) for seed in self.seeds], options=options)
        self.window = np.full((work.axes, len(SIGNALS), self.length), np.nan)
        self.alive = np.ones(work.axes, dtype=np.bool_)
        self.controller_memory: Any = None
        self.step = 0

    def _flows(self) -> NDArray[np.float64]:
        if self.work.leak_lpm is not None:
            return np.full(len(self.seeds), self.work.leak_lpm)
        low, high = np.log(self.config.leakage.healthy_range)
        return np.array([np.exp(np.random.default_rng([int(seed), 2]).uniform(low, high)) for seed in self.seeds])

    def memory(self) -> tuple[Any, ...]:
        numbers = self.observation.copy(), self.window.copy(), self.alive.copy()
        return self.env.get_state(), *numbers, self.controller_memory, self.step, deepcopy(self.detector)

    def recall(self, memory: tuple[Any, ...]) -> None:
        state, observation, window, alive, self.controller_memory, self.step, detector = memory
        self.env.set_state(state)
        self.detector = deepcopy(detector)
        self.observation, self.window, self.alive = observation, window.copy(), alive

    def begin(self, onset: Onset) -> None:
        """Change the leaks and the activities of the axes from now on."""
        axes, now = self.env.axes, self.step * self.period
        if onset.then is not None:
            axes.reference[:] = working_references(self.config, self.seeds, (now, onset.then))
        row = axes.record
        if onset.leak_lpm is not None:
            row["leak_schedule"] = _GROWTH if onset.grows else _ONSET
            row["leak_start_time"] = now
            row["leak_start_flow"] = row["leak_flow"]
            row["leak_target_flow"] = onset.leak_lpm
        if onset.fault is not None:
            name, magnitude = onset.fault
            kind = FAULT_KINDS.index(KIND_OF_FAULT[name])
            row["faulty"] = 1.0
            row["fault_schedule"][:, kind] = _FAULT_ONSET
            row["fault_start"][:, kind] = now
            row["fault_target"][:, FAULTS.index(name)] = magnitude

    def looks(self, end: int) -> Looks:
        length, measured, rows = self.length, self.measured, []
        while self.step < end:
            seen = self.observation[:, measured.columns] * measured.scale
            self.window[:, measured.rows, self.step % length] = seen
            if self.step + 1 >= length and (self.step + 1 - length) % self.every == 0:
                signals = np.roll(self.window, -(self.step + 1), axis=2)
                score, *rest = look(self.detector, signals, self.known, self.step * self.period)
                flow = self.env.axes.column("leak_flow").copy()
                rows.append((self.step * self.period, np.where(self.alive, score, np.nan), *rest, flow))
            started = np.full(len(self.seeds), self.step == 0)
            action, self.controller_memory = self.controller.predict(
                self.observation, self.controller_memory, started, True
            )
            self.observation, _, terminated, _, _ = self.env.step(np.where(self.alive[:, None], action, 0.0))
            self.alive = self.alive & ~terminated
            self.step += 1
        time, *columns = zip(*rows, strict=True)
        return Looks(np.array(time), *(np.stack(values, axis=1) for values in columns))


@dataclass(frozen=True)
class Bench:
    """Settings that all looks of a calibration share."""

    config: TaskConfig
    controllers: Mapping[str, Controller]  # in turn, one for each job
    detector: Detector
    detector_name: str
    folder: Path | None = None  # for the results of the jobs; None keeps none
    together: int = 128  # largest number of axes of a job
    progress: Report | None = None  # called when a job finishes

    def looks(self, listed: Mapping[str, Work]) -> dict[str, list[Looks]]:
        """Looks up to the onset, and after each onset; see :func:`simulate`.

        Raises:
            ConfigurationError: work is shorter than a window, or an axis cannot begin.
        """
        jobs: dict[str, Job] = {}
        keys: dict[str, list[str]] = {name: [] for name in listed}
        acting = [((each, self.detector), fingerprint(each, self.detector)) for each in self.controllers.values()]
        for name, work in listed.items():
            fair = math.ceil(work.axes / len(acting))
            size = self.together if work.axes > self.together else fair  # each controller gets a part
            for number, first in enumerate(range(0, work.axes, size)):
                participant, digest = acting[number % len(acting)]
                part = replace(work, first_seed=work.first_seed + first, axes=min(size, work.axes - first))
                keys[name].append(f"{name}|{number}")
                jobs[keys[name][-1]] = Job(simulated, participant, (self.config, part), digest)
        results = run_jobs(jobs, self.folder, None, self.progress)[0]
        found = {}
        for name, work in listed.items():
            parts: list[list[Looks]] = []
            for result in (results[key] for key in keys[name]):
                if result.error:
                    raise ConfigurationError(result.error)
                each = range(1 + len(work.onsets))
                parts.append([Looks(*(result.metrics[f"{index}.{key}"] for key in Looks._fields)) for index in each])
            found[name] = [joined(column) for column in zip(*parts, strict=True)]
        return found


def simulated(acting: tuple[Controller, Detector], config: TaskConfig, work: Work) -> Columns:
    """The looks of :func:`simulate`, named ``0.time``, ``0.score``, ….

    Raises:
        ConfigurationError: the work is shorter than a window, or an axis cannot begin.
    """
    controller, detector = acting
    each = simulate(config, controller, detector, work)
    return {f"{index}.{key}": values for index, looks in enumerate(each) for key, values in looks._asdict().items()}


def working_references(
    config: TaskConfig, seeds: NDArray[np.int64], then: tuple[float, Activity] | None = None
) -> NDArray[np.float64]:
    """References of N axes at work, m, (N, samples of an episode with its preview).

    Args:
        config: the task; its episode is as long as the operation.
        seeds: seeds of the axes (N,); the references stay within the limits of the plants that they draw.
        then: a time in s, and the activity of each axis from then on.
    """
    names = [name for name in FAMILIES if name != "user" and config.references.weights.get(name, 0.0) > 0.0]
    env = ServoHydraulicVectorEnv(len(seeds), config, info=False)
    families = []
    for name in names:
        env.reset(seed=[int(seed) for seed in seeds], options={"reference": name})
        families.append(env.axes.reference.copy())
    env.close()
    rows = [
        _joined(
            [family[axis] for family in families], config.control_period, np.random.default_rng([int(seed), 1]), then
        )
        for axis, seed in enumerate(seeds)
    ]
    return np.array(rows)


def _joined(
    families: list[NDArray[np.float64]],
    period: float,
    generator: np.random.Generator,
    then: tuple[float, Activity] | None,
) -> NDArray[np.float64]:
    samples = len(families[0])
    row = np.empty(samples)
    clocks = np.zeros(len(families))  # in samples: where each family goes on
    first, held = 0, families[0][0]
    activities, shares = list(SHARES), list(SHARES.values())
    while first < samples:
        duration = np.exp(generator.uniform(*np.log(STRETCH)))
        family = int(generator.integers(len(families)))
        activity = activities[generator.choice(len(shares), p=shares)]
        last = min(first + max(round(duration / period), 1), samples)
        if then is not None:
            change = round(then[0] / period)
            if first >= change:
                activity, last = then[1], samples
            else:
                last = min(last, change)
        ahead = clocks[family] + PACE[activity] * np.arange(last - first)
        stretch = np.interp(ahead, np.arange(samples), families[family])
        share = np.minimum(np.arange(last - first) * period / FADE, 1.0)
        weight = share**3 * (10.0 + share * (6.0 * share - 15.0))
        row[first:last] = held + weight * (stretch - held)
        clocks[family] = ahead[-1] + PACE[activity]
        first, held = last, row[last - 1]
    return row
