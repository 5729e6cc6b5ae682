"""The recordings of the challenge: what each draws, in three tiers of difficulty, and their labels.

Every block of recordings follows from the version, the split, its number and the key of the test split: any size can be
made, continued, and made again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.pid import PID
from hydro_agents.detection.dataset import EXTERNAL_LEAK
from hydro_agents.detection.detector import CAUSE_OF_FAULT, Cause, measured_run
from hydro_agents.detection.disturbances import DISTURBANCES, PRESSURES, Disturbed, drawn
from hydro_agents.detection.operations import ACTING, MOTIONS
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.learning.stable_gain import pid_from_figures
from hydro_agents.running.cases import Cases, TrueStateController
from hydro_agents.running.seeds import BENCHMARK_TEST, BENCHMARK_TRAINING, BENCHMARK_VALIDATION
from hydro_env import TaskConfig
from hydro_env.axes import Axes
from hydro_env.task.configuration import LEAKAGE_LIMIT, task_config
from hydro_env.task.faults import SIGNED_KINDS, fault_limits, faults_of
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_rig.challenge.plates import FIRST_NEW, KNOWN, NEW_AXES, Plate, plate_of, seed_of, task_of
from hydro_rig.recordings.columns import MEASURED, factor
from hydro_rig.recordings.simulated import WRITTEN_UNITS, heading

VERSION = 2
"""Of the recordings: whatever changes one of them is a new version."""

SPLITS = {"train": 0.5, "validation": 0.2, "test": 0.3}
"""Shares of the recordings."""

_SEEDS = {"train": BENCHMARK_TRAINING, "validation": BENCHMARK_VALIDATION, "test": BENCHMARK_TEST}

BLOCK, CREWS = 300, 8
"""Recordings per file, and groups of them per tier: a group shares its axis, who moves it, motion and noise."""

DURATION = 60.0  # s, of a recording
LEAKS = (1.0 / 0.6, 2.0 / 0.03)
"""Of a leaking seal over the largest leak of a healthy one, log-uniform; that grows with the flow of the axis."""

HEALTHY = (0.1, 1.0)  # of a healthy seal, log-uniform

FAULTS = (
    *("valve_null_shift", "valve_underlap", "valve_flow", "external_leak", "tank_pressure"),
    *("sensor_offset", "sensor_gain", "sensor_dropout"),
)
"""Kinds of other faults; they act from the start."""


class Tier(NamedTuple):
    """A tier of difficulty: what its axes draw from."""

    sound: float  # share of the axes without any fault
    other: float  # share with another fault than a leak past the piston
    acting: tuple[str, ...]  # names in ACTING
    motions: tuple[str, ...]  # names in MOTIONS
    noise: tuple[float, ...] = (1.0,)  # of the sensors, as factors on the data sheet
    harsh: bool = False  # a moving supply, a drifting transducer, lost rows or spikes; in the test also ``unseen``
    unseen: tuple[str, ...] = ()  # names in ACTING that only the test split has


TIERS: Mapping[int, Tier] = {
    1: Tier(0.4, 0.0, ("PID", "flow-linearising"), ("ordinary",)),
    2: Tier(
        0.3,
        0.3,
        ("PID", "flow-linearising", "by hand", "open loop"),
        ("ordinary", "slow", "standing still", "changing loads"),
        (0.7, 1.0, 1.6),
    ),
    3: Tier(
        0.3,
        0.3,
        ("PID", "flow-linearising", "by hand", "chattering"),
        ("ordinary", "standing still"),
        (1.0, 1.6),
        True,
        ("sliding mode", "three-step switch"),
    ),
}
"""The tiers: 1 a well-kept machine, 2 an ordinary one, 3 a difficult one."""

SCHEDULES = ("constant", "onset", "growth")  # of a leak
DAMAGED = ("lost rows", "spikes")
HARSH = (*DISTURBANCES, *DAMAGED)
"""What the recordings of tier 3 suffer from, one each."""

LABELS = {
    "recording": "number; the same in both tables",
    "axis": "number of the axis in `axes.parquet`",
    "new_axis": "whether no other split has recordings of this axis",
    "tier": "1 to 3",
    "seconds": "length",
    "leak": "whether the piston seal leaks at the end",
    "onset": "s, from which on it leaks; 0: from the start; empty: never",
    "schedule": "constant, onset (sudden) or growth (from the onset in proportion to the logarithm)",
    "size": "l/min at 100 bar, at the end",
    "size_before": "l/min at 100 bar, at the start",
    "size_share": "size over the largest leak of a healthy seal of this axis",
    "cause": "none, internal leak, external leak, valve fault, sensor fault or return line",
    "fault": "name of the other fault; empty: none",
    "harsh": "what the recording suffers from (tier 3)",
    "acting": "who moved the axis",
    "motion": "kind of motion",
}
"""Columns of the labels."""


@dataclass(frozen=True)
class Benchmark:
    """What makes the recordings, and nothing else does.

    Args:
        recordings: of all splits together.
        key: of the test split and of the axes that it alone has; empty: its seeds are public, and so are its labels
            for those who make them.
    """

    recordings: int
    key: str = ""

    def plate(self, axis: int) -> Plate:
        """The nameplate of an axis."""
        return plate_of(seed_of(axis, self.key))

    def blocks(self, split: str) -> list[int]:
        """The number of recordings in each block of a split."""
        count = round(self.recordings * SPLITS[split])
        return [min(BLOCK, count - first) for first in range(0, count, BLOCK)]

    def seeds(self, split: str, block: int, count: int) -> NDArray[np.int64]:
        """Seeds of the axes of a block."""
        if split != "test" or not self.key:
            return np.array(_SEEDS[split].take(count, BLOCK * block))
        secret = hashlib.sha256(f"{self.key}/{block}".encode()).digest()
        # Above all seeds of the ledger.
        return np.random.default_rng(list(secret)).integers(2**31, 2**32, count)


class Block(NamedTuple):
    """Recordings of one file, and their labels."""

    signals: pd.DataFrame
    labels: pd.DataFrame


class _Noted:
    """A controller that notes when the leaks of its axes begin."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    def begin(self, axes: Axes) -> None:
        """Read the drawn course of the leaks."""
        self.onset, self.before = (axes.column(name).copy() for name in ("leak_start_time", "leak_start_flow"))
        if isinstance(self.controller, TrueStateController):
            self.controller.begin(axes)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[Any], Any]:
        """The commands of the controller."""
        return self.controller.predict(observation, state, episode_start, deterministic)


class _Crew(NamedTuple):
    """What some recordings of a block have in common; they are simulated together."""

    axis: int
    tier: int
    acting: str
    motion: str
    schedule: str
    noise: float


def simulated_block(config: TaskConfig, benchmark: Benchmark, split: str, block: int) -> Block:
    """Simulate one block of a split.

    Args:
        config: the task, which moves to every axis.
        benchmark: size and key.
        split: a name in SPLITS.
        block: its number.
    """
    count = benchmark.blocks(split)[block]
    seeds = benchmark.seeds(split, block, count)
    generator = np.random.default_rng(seeds[0])
    tier = 1 + np.arange(count) % len(TIERS)
    crew = np.arange(count) // len(TIERS) % CREWS
    numbers = BLOCK * block + generator.permutation(count)  # the number of a recording tells nothing
    axes = iter(_axes_of_crews(generator, split))
    parts = []
    for level, settings in TIERS.items():
        acting = settings.acting + (settings.unseen if split == "test" else ())
        hands = generator.choice(acting, CREWS, replace=len(acting) < CREWS)
        schedules = generator.permutation(np.resize(SCHEDULES, CREWS))
        for turn in range(CREWS):
            members = np.flatnonzero((tier == level) & (crew == turn))
            moving = settings.harsh and bool(turn % 2)
            shared = _Crew(
                next(axes),
                level,
                str(hands[turn]),
                str(generator.choice(settings.motions)),
                str(schedules[turn]),
                float(generator.choice(settings.noise)),
            )
            kinds = list(DISTURBANCES) if moving else list(DAMAGED) if settings.harsh else [""]
            shares = (settings.sound, settings.other, 1.0 - settings.sound - settings.other)
            states, harsh = generator.choice(3, len(members), p=shares), generator.choice(kinds, len(members))
            if len(members):
                task = task_of(config, benchmark.plate(shared.axis))
                parts += _run(task, shared, seeds[members], states, harsh, numbers[members], generator)
    parts.sort(key=lambda part: int(part[1]["recording"]))
    return Block(pd.concat([part[0] for part in parts], ignore_index=True), pd.DataFrame([part[1] for part in parts]))


def _axes_of_crews(generator: np.random.Generator, split: str) -> list[int]:
    """The axis of each crew of a block; in the test split every other crew has an axis that no other split has."""
    axes = generator.permutation(np.resize(range(KNOWN), len(TIERS) * CREWS))
    if split == "test":
        axes[::2] = generator.permutation(np.resize(NEW_AXES, len(axes[::2])))
    numbers: list[int] = axes.tolist()
    return numbers


_SOUND, _OTHER, _LEAKS = range(3)


def _run(
    config: TaskConfig,
    crew: _Crew,
    seeds: NDArray[np.int64],
    states: NDArray[np.int64],
    harsh: NDArray[np.str_],
    numbers: NDArray[np.int64],
    generator: np.random.Generator,
) -> list[tuple[pd.DataFrame, dict[str, Any]]]:
    """Simulate the axes of one crew; per axis its rows and its labels."""
    count = len(seeds)
    sensors = config.sensors.model_dump()
    for name in SENSORS:
        sensors[name]["noise"] *= crew.noise
    leakage = config.leakage.model_dump() | {"schedule": crew.schedule, "start_range": (0.1, 0.7)}
    task = task_config(config, episode_duration=DURATION, leakage=leakage, sensors=sensors)
    task = MOTIONS[crew.motion](task)
    bound = config.leakage.class_bounds[0]
    shares = np.where(states[:, None] == _LEAKS, LEAKS, HEALTHY)
    flow = np.minimum(bound * np.exp(generator.uniform(*np.log(shares).T)), LEAKAGE_LIMIT)
    faults, names = _faults(config, generator, states)
    figures = pid_from_figures(task) if crew.acting == "PID" else None  # of the axis: the gains follow from them
    controller: Controller = (
        PID(figures, task) if figures is not None else ACTING[crew.acting].make(task, count, int(seeds[0]))
    )
    moves = None
    if np.isin(harsh, list(DISTURBANCES)).all():  # a crew has a moving supply or sensor, or damaged rows
        moves = drawn(generator, harsh, task.steps, task.control_period)
        controller = Disturbed(controller, moves)
    noted = _Noted(controller)
    signals, run = measured_run(task, noted, Cases(seeds, flow, faults=faults))
    if moves is not None:
        moves.read(signals)
    parts = []
    for axis in range(count):
        rows = task.steps if run.failed_at[axis] < 0 else int(run.failed_at[axis]) + 1
        onset = noted.onset[axis] if crew.schedule != "constant" else 0.0
        end = rows * task.control_period
        leaks = bool(states[axis] == _LEAKS and onset < end)
        if crew.schedule == "growth" and leaks:  # the seal leaks once it passes more than a healthy one
            first, last = np.log(noted.before[axis]), np.log(flow[axis])
            onset += (DURATION - onset) * np.clip((np.log(bound) - first) / (last - first), 0.0, 1.0)
            leaks = bool(onset < end)
        other = CAUSE_OF_FAULT[names[axis]] if names[axis] else Cause.NONE
        label = {
            "recording": int(numbers[axis]),
            "axis": crew.axis,
            "new_axis": crew.axis >= FIRST_NEW,
            "tier": crew.tier,
            "seconds": end,
            "leak": leaks,
            "onset": float(onset) if leaks else np.nan,
            "schedule": crew.schedule,
            "size": float(run.leakage_flow_lpm[axis]),
            "size_before": float(noted.before[axis] if crew.schedule != "constant" else flow[axis]),
            "size_share": float(run.leakage_flow_lpm[axis]) / bound,
            "cause": Cause.INTERNAL_LEAK.word if leaks else other.word,
            "fault": names[axis],
            "harsh": str(harsh[axis]),
            "acting": crew.acting,
            "motion": crew.motion,
        }
        parts.append((_rows(signals[axis, :, :rows], task, label, generator), label))
    return parts


def _faults(
    config: TaskConfig, generator: np.random.Generator, states: NDArray[np.int64]
) -> tuple[dict[str, Floats], list[str]]:
    """Other faults of axes: magnitudes by name, and the name of each axis's fault."""
    sizes: dict[str, Floats] = {}
    names, sensors = [""] * len(states), [name for name in SENSORS if getattr(config.sensors, name).fitted]
    hangs, scale = config.plant.load.external_force != 0.0, leak_scale(config)
    for axis in np.flatnonzero(states == _OTHER):
        # Beside a leak from chamber b, a valve without underlap holds no weight: it lets chamber a run empty.
        kind = str(generator.choice([kind for kind in FAULTS if kind != EXTERNAL_LEAK or not hangs]))
        low, high = getattr(config.faults, kind).range
        size = generator.uniform(low, high) * (generator.choice((-1.0, 1.0)) if kind in SIGNED_KINDS else 1.0)
        # An offset of the position is the same as another place of the axis.
        visible = [name for name in faults_of(kind, sensors) if name != "position_offset"]
        size = min(scale * size, fault_limits(EXTERNAL_LEAK)[1]) if kind == EXTERNAL_LEAK else size
        names[axis] = str(generator.choice(visible))
        sizes.setdefault(names[axis], np.zeros(len(states)))[axis] = size
    return sizes, names


def _rows(signals: Floats, task: TaskConfig, label: Mapping[str, Any], generator: np.random.Generator) -> pd.DataFrame:
    """The rows of one recording, with its lost rows and spikes."""
    count = signals.shape[1]
    if label["harsh"] == "spikes":
        hit = generator.random((len(PRESSURES), count)) < 0.02
        signals[PRESSURES] += np.where(hit, generator.normal(0.0, 10e5, hit.shape), 0.0)
    kept = np.ones(count, dtype=bool)
    if label["harsh"] == "lost rows":
        kept = np.asarray(generator.random(count) >= 0.05)
    numbers = {name: np.full(count, label[name], dtype=np.int32) for name in ("recording", "axis")}
    table = pd.DataFrame(numbers)
    table[heading("time")] = np.round(np.arange(count) * task.control_period, 6)
    for name, values in zip(MEASURED, signals, strict=True):
        table[heading(name)] = (values / factor(name, WRITTEN_UNITS[name], name)).astype(np.float32)
    return table[kept]
