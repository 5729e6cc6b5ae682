"""LabelledWindows of the leakage head's training: simulated axes in many kinds of operation, with faults."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import CAUSE_OF_FAULT, cut, measured_run
from hydro_agents.detection.disturbances import DISTURBANCES, Disturbed, drawn
from hydro_agents.detection.features import LABELS, features_of
from hydro_agents.detection.operations import ACTING, OPERATIONS
from hydro_agents.detection.sheet import leak_scale, rig_features, sheet_of
from hydro_agents.detection.training_settings import LARGEST_LEAK, LEAST_LEAK, HeadTrainingSettings
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_env import TaskConfig
from hydro_env.task.configuration import LEAKAGE_LIMIT, task_config
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.faults import FAULT_KINDS, FAULTS, SIGNED_KINDS, fault_limits, faults_of
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Array, Floats, Indices, Singles

EXTERNAL_LEAK = "external_leak"
UNSEEN = ("position_offset",)  # faults that are invisible in the measured signals; they get no label

LABEL_OF_FAULT = {
    name: LABELS.index(cause.word.replace(" ", "_")) for name, cause in CAUSE_OF_FAULT.items() if name not in UNSEEN
}

TRAINED_FAULTS = tuple(kind for kind in FAULT_KINDS if kind != "sensor_freeze")  # a stuck one needs no network

LEAK_COURSES = ("constant", "onset", "growth", "orifice")
"""Leaks of the training: constant laminar gap, beginning or growing within the window, constant orifice."""

CHANGING = ("onset", "growth")

CHUNK, CHUNK_OF_RIG = 256, 24  # largest number of axes that are simulated together; the same for each drawn rig
CHUNK_OF_POLICY = 96  # the same under a policy for any axis: it takes a quarter of a minute to choose its gains

KINDS_FOR_ANY_AXIS = ("flow_linearising", "ppo")  # kinds of controllers that serve drawn rigs
POLICY = KINDS_FOR_ANY_AXIS.index("ppo")

WINDOWS = 3  # from each run

SHARES = (
    ("constant", 0.49, False),
    ("onset", 0.15, False),
    ("growth", 0.15, False),
    ("orifice", 0.06, False),
    ("constant", 0.15, True),
)
"""Kinds of runs: the leak, their share, and whether a disturbance comes beside it."""

HEALTHY_SHARE, SECOND_FAULT, AT_START, SMALL = 0.5, 0.1, 0.2, 0.35
"""Shares: of healthy axes, of faulty axes with a second fault, of windows at the start of a run, of leaks that are
drawn from the healthy bound upwards; the other leaks are drawn from three times that bound upwards."""

NOISY, LEAST_NOISE, MOST_NOISE = 0.3, 0.7, 1.6  # share of chunks with other sensor noise, and its range as a factor
LATEST = 0.9  # latest onset of a leak, as a fraction of the window


class LabelledWindows(NamedTuple):
    """N labelled windows."""

    features: Singles  # (N, F); with a law those of the rig at the end
    labels: Singles  # (N, labels), 0 or 1
    size: Floats  # (N,), internal leak, in the rig's unit of leaks
    fault: Indices  # (N,), index into FAULTS of the first fault, −1 for none
    leak: Indices  # (N,), index into LEAK_COURSES
    noise: Floats  # (N,), of the sensors, as a factor on the task's
    disturbance: Floats  # (N,), its range in the window over the noticeable one; 0: none

    def part(self, chosen: Array) -> "LabelledWindows":
        """Some of the windows."""
        return LabelledWindows._make(values[chosen] for values in self)

    @classmethod
    def joined(cls, parts: "Sequence[LabelledWindows]") -> "LabelledWindows":
        """Several sets as one."""
        return cls._make(np.concatenate(columns) for columns in zip(*parts, strict=True))


class Chunk(NamedTuple):
    """Runs that are simulated together."""

    row: int  # of OPERATIONS
    controller: int  # index of the controller, −1: none
    leak: str  # one of LEAK_COURSES
    axes: int
    disturbed: bool = False


@dataclass(frozen=True)
class TrainingPlan:
    """Sources of the windows.

    With a law, each chunk has the next of its rigs, and controllers for any axis instead of those given. The leaks are
    in the rig's unit (:func:`~hydro_agents.detection.sheet.leak_scale`).
    """

    config: TaskConfig
    controllers: Sequence[Controller]
    settings: HeadTrainingSettings
    split: str = "training"  # of the law's rigs

    @cached_property
    def rigs(self) -> tuple[TaskConfig, ...]:
        """The task on each rig."""
        law = self.settings.law
        if law is None:
            return (self.config,)
        return rig_tasks(task_config(self.config, law=law.model_dump() | {"split": self.split, "preview_paces": ()}))

    def chunks(self, episodes: int) -> list[Chunk]:
        """Groups of runs that are simulated together."""
        total = sum(row.share for row in OPERATIONS)
        controllers = len(self.controllers) if self.settings.law is None else len(KINDS_FOR_ANY_AXIS)
        chunks = []
        for number, row in enumerate(OPERATIONS):
            acting = [-1] if row.manner else range(controllers)
            for controller in acting:
                for leak, share, moves in SHARES:
                    count = round(episodes * share * row.share / total / len(acting))
                    pieces = -(-count // self._largest(controller, leak))
                    for piece in range(pieces):
                        size = count * (piece + 1) // pieces - count * piece // pieces
                        chunks.append(Chunk(number, controller, leak, size, moves))
        return chunks

    def _largest(self, controller: int, leak: str) -> int:
        if self.settings.law is None:
            largest = CHUNK
        elif controller == POLICY:
            largest = CHUNK_OF_POLICY
        else:
            largest = CHUNK_OF_RIG
        return min(largest, CHUNK // 4) if leak in CHANGING else largest  # more lengths of windows

    def jobs(self, episodes: int, first_seed: int) -> dict[str, Job]:
        """A job for each chunk of about so many runs, by its number; results: :class:`LabelledWindows`."""
        digests = [fingerprint(controller) for controller in self.controllers]
        jobs, seed = {}, first_seed
        for number, chunk in enumerate(self.chunks(episodes)):
            seeds = np.arange(seed, seed + chunk.axes)
            seed += chunk.axes
            acting, digest = None, "none"
            if self.settings.law is None and chunk.controller >= 0:
                acting, digest = self.controllers[chunk.controller], digests[chunk.controller]
            arguments = (self.settings, chunk, seeds, self.rigs[number % len(self.rigs)])
            jobs[str(number)] = Job(simulated, acting, arguments, digest)
        return jobs


def simulated(
    controller: Controller | None, settings: HeadTrainingSettings, chunk: Chunk, seeds: Indices, config: TaskConfig
) -> Columns:
    """The windows of one chunk."""
    generator = np.random.default_rng([int(seeds[0]), chunk.row])
    count, changing = chunk.axes, chunk.leak in CHANGING
    sizes, steps = _lengths(generator, settings, config, changing)
    noise = float(np.exp(generator.uniform(np.log(LEAST_NOISE), np.log(MOST_NOISE))))
    noise = noise if generator.random() < NOISY else 1.0
    task = _task_of(chunk, config, sizes[0], steps, noise)
    leaks = _leaks(generator, config, count)
    fault_share = 0.0 if chunk.disturbed else settings.fault_share
    faults, fault, labels = draw_faults(config, generator, count, fault_share)
    scale, sheet = leak_scale(config), sheet_of(config, settings.law is not None)
    faults[EXTERNAL_LEAK] = np.minimum(scale * faults[EXTERNAL_LEAK], fault_limits(EXTERNAL_LEAK)[1])
    labels[:, 0] = leaks > config.leakage.class_bounds[0]
    acting = _acting(controller, settings, chunk, task, int(seeds[0]))
    moves = None
    if chunk.disturbed:
        kinds = generator.choice(list(DISTURBANCES), count)
        moves = drawn(generator, kinds, steps, config.control_period)
        acting = Disturbed(acting, moves)

    measured, run = measured_run(task, acting, Cases(seeds, scale * leaks, faults=faults))
    signals = measured.astype(np.float32)
    if moves is not None:
        moves.read(signals)
    lengths = np.where(run.failed_at < 0, steps, run.failed_at + 1)
    parts = []
    for size in sizes:
        kept = np.flatnonzero(lengths >= (steps if changing else size))
        begins = np.floor(generator.random(len(kept)) * (lengths[kept] - size + 1)).astype(int)
        begins[generator.random(len(kept)) < AT_START] = 0
        if changing:  # the run ends with its only window
            begins[:] = steps - size
        felt = np.zeros(len(kept))
        if moves is not None:
            felt = moves._replace(course=moves.course[kept]).felt(begins, size)
        parts.append(
            LabelledWindows(
                features=features_of(cut(signals[kept], begins, size), sheet),
                labels=labels[kept],
                size=leaks[kept],
                fault=fault[kept],
                leak=np.full(len(kept), LEAK_COURSES.index(chunk.leak)),
                noise=np.full(len(kept), noise),
                disturbance=felt,
            )
        )
    found = LabelledWindows.joined(parts)
    if settings.law is not None:
        rig = np.tile(rig_features(config), (len(found.features), 1))
        found = found._replace(features=np.concatenate([found.features, rig], axis=1))
    return found._asdict()


def _lengths(
    generator: np.random.Generator, settings: HeadTrainingSettings, config: TaskConfig, changing: bool
) -> tuple[list[int], int]:
    """Samples of each window of a run, and of the run."""
    shortest, longest = config.steps, settings.longest_window(config)
    # Whole lengths in a few steps: the windows of one length are read together.
    choices = np.unique(np.geomspace(shortest, longest, 5).round().astype(int))
    sizes = []
    for turn in range(WINDOWS):
        size = choices[0] if turn % 2 == 0 else generator.choice(choices)
        sizes.append(int(size))
    if not changing:
        return sizes, longest + longest // 4
    size = int(generator.choice(sizes))
    before = int(generator.integers(shortest)) if generator.random() > AT_START else 0
    return [size], size + before


def _task_of(chunk: Chunk, config: TaskConfig, size: int, steps: int, noise: float) -> TaskConfig:
    """The task of a chunk: runs of ``steps`` samples, which end with a window of ``size`` if their leak changes."""
    leakage = config.leakage.model_dump() | {"schedule": "constant"}
    if chunk.leak == "orifice":
        leakage |= {"law": "orifice"}
    if chunk.leak in CHANGING:
        begin, last = 1.0 - size / steps, 1.0 - (1.0 - LATEST) * size / steps
        leakage |= {"schedule": chunk.leak, "start_range": (begin, last)}
    sensors = config.sensors.model_dump()
    for name in SENSORS:
        sensors[name]["noise"] *= noise
    duration = steps * config.control_period
    return OPERATIONS[chunk.row].task(task_config(config, episode_duration=duration, leakage=leakage, sensors=sensors))


def _acting(
    controller: Controller | None, settings: HeadTrainingSettings, chunk: Chunk, task: TaskConfig, seed: int
) -> Any:
    """Who acts on the axes of a chunk."""
    manner = OPERATIONS[chunk.row].manner
    if manner:
        return ACTING[manner](task, chunk.axes, seed)
    if settings.law is not None:
        return shipped(KINDS_FOR_ANY_AXIS[chunk.controller], task)
    return controller


def _leaks(generator: np.random.Generator, config: TaskConfig, count: int) -> Floats:
    """Leaks in the rig's unit: healthy, or above the healthy bound; log-uniform."""
    bound, largest = config.leakage.class_bounds[0], LEAKAGE_LIMIT / leak_scale(config)
    healthy = generator.random(count) < HEALTHY_SHARE
    low = np.where(generator.random(count) < SMALL, bound, 3.0 * bound)
    low = np.where(healthy, LEAST_LEAK, low)
    high = np.where(healthy, bound, min(LARGEST_LEAK, largest))
    return np.exp(generator.uniform(np.log(low), np.log(high)))


def draw_faults(
    config: TaskConfig, generator: np.random.Generator, count: int, share: float
) -> tuple[dict[str, Floats], Indices, Singles]:
    """Faults of axes by name, the index of the first one of each axis (−1: none), and the labels of all."""
    sizes = {name: np.zeros(count) for name in FAULTS}
    # Beside a leak from chamber b, a valve without underlap holds no weight: it lets chamber a run empty.
    hangs = config.plant.load.external_force != 0.0
    kinds = [kind for kind in TRAINED_FAULTS if not (hangs and kind == EXTERNAL_LEAK)]
    fitted = [name for name in SENSORS if getattr(config.sensors, name).fitted]
    first, labels = np.full(count, -1), np.zeros((count, len(LABELS)), dtype=np.float32)
    for axis in np.flatnonzero(generator.random(count) < share):
        for kind in generator.choice(kinds, 1 + (generator.random() < SECOND_FAULT), replace=False):
            size = generator.uniform(*getattr(config.faults, kind).range)
            if kind in SIGNED_KINDS:
                size *= generator.choice((-1.0, 1.0))
            name = generator.choice(faults_of(kind, fitted))
            sizes[name][axis] = size
            if first[axis] < 0:
                first[axis] = FAULTS.index(name)
            if name in LABEL_OF_FAULT:
                labels[axis, LABEL_OF_FAULT[name]] = 1.0
    return sizes, first, labels
