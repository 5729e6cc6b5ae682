"""LabelledWindows of the leakage head's training: simulated axes in many kinds of operation, with faults."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import CAUSE_OF_FAULT, cut, measured_run
from hydro_agents.detection.disturbances import DISTURBANCES, DRIFTS, PRESSURES, Disturbed, drawn
from hydro_agents.detection.features import LABELS, features_of
from hydro_agents.detection.operations import ACTING, MOTIONS, OPERATIONS
from hydro_agents.detection.sheet import leak_scale, rig_features, sheet_of
from hydro_agents.detection.training_settings import LARGEST_LEAK, LEAST_LEAK, HeadTrainingSettings
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_env import TaskConfig
from hydro_env.task.configuration import LEAKAGE_LIMIT, task_config
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.faults import FAULT_KINDS, FAULTS, SIGNED_KINDS, fault_limits, faults_of
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Array, Floats, Indices, Mask, Singles

EXTERNAL_LEAK = "external_leak"
LABEL_OF_FAULT = {name: LABELS.index(cause.word.replace(" ", "_")) for name, cause in CAUSE_OF_FAULT.items()}
del LABEL_OF_FAULT["position_offset"]  # is invisible in the measured signals

CHANGING = ("onset", "growth")

CHUNK, CHUNK_OF_RIG = 256, 24  # largest number of axes that are simulated together; the same for each drawn rig
CHUNK_OF_POLICY = 96  # the same under a policy for any axis: it takes a quarter of a minute to choose its gains

POLICY = "PPO on flow linearisation"
FOR_ANY_AXIS = ("flow-linearising", POLICY)  # of ACTING, on drawn rigs

WINDOWS = 3  # from each run

SHARES = (
    ("constant", 0.49, False),  # laminar gap
    ("onset", 0.15, False),  # begins within the window
    ("growth", 0.15, False),
    ("orifice", 0.06, False),  # constant
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
    usual: Mask  # (N,), with the task's own sensor noise, and not with a leak through an orifice
    plain: Mask  # (N,), with a constant leak and no other fault
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
    acting: str  # of ACTING; empty: a controller of the study
    leak: str  # one of SHARES
    axes: int
    disturbed: bool = False


def rigs_of(config: TaskConfig, settings: HeadTrainingSettings, split: str) -> tuple[TaskConfig, ...]:
    """The task on each rig of a split of the law; without a law the task."""
    if not settings.law:
        return (config,)
    return rig_tasks(task_config(config, law=settings.law.model_dump() | {"split": split, "preview_paces": ()}))


def training_jobs(
    config: TaskConfig,
    controllers: Sequence[Controller],
    settings: HeadTrainingSettings,
    split: str,
    episodes: int,
    first_seed: int,
) -> dict[str, Job]:
    """A job for each chunk of about so many runs, by its number; results: :class:`LabelledWindows`.

    With a law, each chunk has the next of its rigs, and controllers for any axis instead of those given. The leaks are
    in the rig's unit (:func:`~hydro_agents.detection.sheet.leak_scale`).
    """
    rigs, jobs, seed = rigs_of(config, settings, split), {}, first_seed
    for number, (controller, chunk) in enumerate(_chunks(controllers, settings, episodes)):
        seeds = np.arange(seed, seed + chunk.axes)
        seed += chunk.axes
        arguments = (settings, chunk, seeds, rigs[number % len(rigs)])
        jobs[str(number)] = Job(simulated, controller, arguments, fingerprint(controller))
    return jobs


def _chunks(
    controllers: Sequence[Controller], settings: HeadTrainingSettings, episodes: int
) -> Iterator[tuple[Controller | None, Chunk]]:
    """Groups of runs that are simulated together, each with its controller, if that is one of the study."""
    total = sum(row.share for row in OPERATIONS)
    usual = FOR_ANY_AXIS if settings.law else controllers
    for place, row in enumerate(OPERATIONS):
        all_acting = [row.manner] if row.manner else usual
        for acting in all_acting:
            name, controller = (acting, None) if isinstance(acting, str) else ("", acting)
            largest = CHUNK
            if settings.law:
                largest = CHUNK_OF_POLICY if name == POLICY else CHUNK_OF_RIG
            for leak, share, moves in SHARES:
                count = round(episodes * share * row.share / total / len(all_acting))
                most = min(largest, CHUNK // 4) if leak in CHANGING else largest  # more lengths of windows
                pieces = -(-count // most)
                for piece in range(pieces):
                    axes = count * (piece + 1) // pieces - count * piece // pieces
                    yield controller, Chunk(place, name, leak, axes, moves)


def simulated(
    controller: Controller | None, settings: HeadTrainingSettings, chunk: Chunk, seeds: Indices, config: TaskConfig
) -> Columns:
    """The windows of one chunk."""
    generator = np.random.default_rng([seeds[0], chunk.row])
    count, changing = chunk.axes, chunk.leak in CHANGING
    sizes, steps = _lengths(generator, settings, config, changing)
    noise = np.exp(generator.uniform(np.log(LEAST_NOISE), np.log(MOST_NOISE)))
    noise = noise if generator.random() < NOISY else 1.0
    task = _task_of(chunk, config, sizes[0], steps, noise)
    leaks = _leaks(generator, config, count)
    faults, labels = draw_faults(config, generator, count, 0.0 if chunk.disturbed else settings.fault_share)
    plain = ~np.any([*faults.values()], axis=0) & (chunk.leak == "constant")
    usual = np.full(count, noise == 1.0 and chunk.leak != "orifice")
    scale, sheet = leak_scale(config), sheet_of(config, settings.law is not None)
    rig = rig_features(config) if settings.law else np.empty(0, np.float32)
    faults[EXTERNAL_LEAK] = np.minimum(scale * faults[EXTERNAL_LEAK], fault_limits(EXTERNAL_LEAK)[1])
    labels[:, 0] = leaks > config.leakage.class_bounds[0]
    acting: Any = ACTING[chunk.acting](task, count, seeds[0]) if chunk.acting else controller
    moves = None
    if chunk.disturbed:
        moves = drawn(generator, generator.choice(list(DISTURBANCES), count), steps, config.control_period)
        acting = Disturbed(acting, moves)

    measured, run = measured_run(task, acting, Cases(seeds, scale * leaks, faults=faults))
    signals = measured.astype(np.float32)
    if moves:
        signals[:, PRESSURES] += moves.course[:, DRIFTS]
    lengths = np.where(run.failed_at < 0, steps, run.failed_at + 1)
    parts = []
    for size in sizes:
        kept = np.flatnonzero(lengths >= (steps if changing else size))
        begins = np.floor(generator.random(len(kept)) * (lengths[kept] - size + 1)).astype(int)
        begins[generator.random(len(kept)) < AT_START] = 0
        if changing:  # the run ends with its only window
            begins[:] = steps - size
        features = features_of(cut(signals[kept], begins, size), sheet)
        features = np.concatenate([features, np.tile(rig, (len(kept), 1))], axis=1)
        felt = moves.felt(kept, begins, size) if moves else np.zeros(len(kept))
        parts.append(LabelledWindows(features, labels[kept], leaks[kept], usual[kept], plain[kept], felt))
    return LabelledWindows.joined(parts)._asdict()


def _lengths(
    generator: np.random.Generator, settings: HeadTrainingSettings, config: TaskConfig, changing: bool
) -> tuple[list[int], int]:
    """Samples of each window of a run, and of the run."""
    shortest, longest = config.steps, settings.longest_window(config)
    # Whole lengths in a few steps: the windows of one length are read together.
    choices = np.unique(np.geomspace(shortest, longest, 5).round().astype(int))
    sizes = [generator.choice(choices) if turn % 2 else choices[0] for turn in range(WINDOWS)]
    if not changing:
        return sizes, longest + longest // 4
    size = generator.choice(sizes)
    before = generator.integers(shortest) if generator.random() > AT_START else 0
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
    motion = MOTIONS[OPERATIONS[chunk.row].motion]
    return motion(task_config(config, episode_duration=duration, leakage=leakage, sensors=sensors))


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
) -> tuple[dict[str, Floats], Singles]:
    """Sizes of the faults of axes by name, and the labels of the axes."""
    sizes = {name: np.zeros(count) for name in FAULTS}
    # Beside a leak from chamber b, a valve without underlap holds no weight: it lets chamber a run empty.
    hangs = config.plant.load.external_force != 0.0
    untrained = {"sensor_freeze", EXTERNAL_LEAK} if hangs else {"sensor_freeze"}  # a stuck sensor needs no network
    kinds = [kind for kind in FAULT_KINDS if kind not in untrained]
    fitted = [name for name in SENSORS if getattr(config.sensors, name).fitted]
    labels = np.zeros((count, len(LABELS)), np.float32)
    for axis in np.flatnonzero(generator.random(count) < share):
        for kind in generator.choice(kinds, 1 + (generator.random() < SECOND_FAULT), replace=False):
            size = generator.uniform(*getattr(config.faults, kind).range)
            if kind in SIGNED_KINDS:
                size *= generator.choice((-1.0, 1.0))
            name = generator.choice(faults_of(kind, fitted))
            sizes[name][axis] = size
            if name in LABEL_OF_FAULT:
                labels[axis, LABEL_OF_FAULT[name]] = 1.0
    return sizes, labels
