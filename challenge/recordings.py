"""Write the recordings of the challenge and their labels; README.md describes them.

    python -m challenge.recordings FOLDER [--count 600] [--jobs 2]

Each block of 300 recordings follows from its split and its number: any size can be made, continued, and made again.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from numpy.typing import NDArray

from benchmarks import command_line
from challenge.axes import FIRST_NEW, KNOWN, NEW_AXES, axes_table, task_of
from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.pid import PID
from hydro_agents.detection.dataset import EXTERNAL_LEAK
from hydro_agents.detection.detector import CAUSE_OF_FAULT, Cause, measured_run
from hydro_agents.detection.disturbances import DISTURBANCES, DRIFTS, PRESSURES, Disturbed, drawn
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
from hydro_env.types import Floats, Indices
from hydro_rig.recordings.columns import MEASURED, factor
from hydro_rig.recordings.simulated import WRITTEN_UNITS, heading

SHARES = {"train": 0.5, "validation": 0.2, "test": 0.3}  # of the recordings
SEEDS = {"train": BENCHMARK_TRAINING, "validation": BENCHMARK_VALIDATION, "test": BENCHMARK_TEST}

BLOCK, CREWS = 300, 8  # recordings per file; groups per tier: each shares its axis, who moves it, motion and noise

DURATION = 60.0  # s, of a recording
HEALTHY = (0.1, 1.0)  # flow past a healthy seal over the largest of a healthy one, log-uniform
LEAKS = (1.0 / 0.6, 2.0 / 0.03)  # past a leaking seal
SCHEDULES = ("constant", "onset", "growth")  # of a leak
SOUND, OTHER, LEAKING = range(3)  # states of an axis
MOVING = list(DISTURBANCES)
DAMAGED = ["lost rows", "spikes"]
FAULTS = (  # kinds of other faults; they act from the start
    *("valve_null_shift", "valve_underlap", "valve_flow", "external_leak", "tank_pressure"),
    *("sensor_offset", "sensor_gain", "sensor_dropout"),
)


class Tier(NamedTuple):
    """A tier of difficulty: what its axes draw from."""

    states: tuple[float, float, float]  # shares of sound axes, of those with another fault, and of leaking ones
    acting: tuple[str, ...]  # names in ACTING
    motions: tuple[str, ...]  # names in MOTIONS
    noise: tuple[float, ...] = (1.0,)  # of the sensors, as factors on the data sheet
    harsh: bool = False  # a moving supply, a drifting transducer, lost rows or spikes; in the test also ``unseen``
    unseen: tuple[str, ...] = ()  # names in ACTING that only the test split has


MIXED = (0.3, 0.3, 1.0 - 0.3 - 0.3)
TIERS = {  # 1 a well-kept machine, 2 an ordinary one, 3 a difficult one
    1: Tier((0.4, 0.0, 0.6), ("PID", "flow-linearising"), ("ordinary",)),
    2: Tier(
        *(MIXED, ("PID", "flow-linearising", "by hand", "open loop")),
        *(("ordinary", "slow", "standing still", "changing loads"), (0.7, 1.0, 1.6)),
    ),
    3: Tier(
        *(MIXED, ("PID", "flow-linearising", "by hand", "chattering"), ("ordinary", "standing still")),
        *((1.0, 1.6), True, ("sliding mode", "three-step switch")),
    ),
}


class Crew(NamedTuple):
    """What some recordings of a block have in common; they are simulated together."""

    axis: int
    tier: int
    acting: str
    motion: str
    schedule: str
    noise: float


class Members(NamedTuple):
    """What the N recordings of a crew have each."""

    numbers: Indices
    seeds: Indices
    states: Indices
    harsh: NDArray[np.str_]


class _Noted:
    """A controller that notes when the leaks of its axes begin."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    def begin(self, axes: Axes) -> None:
        """Read the drawn course of the leaks."""
        self.onset, self.before = axes.column("leak_start_time").copy(), axes.column("leak_start_flow").copy()
        if isinstance(self.controller, TrueStateController):
            self.controller.begin(axes)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[Any], Any]:
        """The commands of the controller."""
        return self.controller.predict(observation, state, episode_start, deterministic)


def simulated_block(split: str, block: int, count: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The rows of ``count`` recordings, and their labels."""
    seeds = np.array(SEEDS[split].take(count, BLOCK * block))
    generator = np.random.default_rng(seeds[0])
    tier = 1 + np.arange(count) % len(TIERS)
    turn_of = np.arange(count) // len(TIERS) % CREWS
    numbers = BLOCK * block + generator.permutation(count)  # the number of a recording tells nothing
    axes = generator.permutation(np.resize(range(KNOWN), len(TIERS) * CREWS))
    if split == "test":  # every other crew has an axis that no other split has
        axes[::2] = generator.permutation(np.resize(NEW_AXES, len(axes[::2])))
    next_axis = iter(axes.tolist())
    parts: list[tuple[pd.DataFrame, dict[str, Any]]] = []
    for level, settings in TIERS.items():
        acting = settings.acting + (settings.unseen if split == "test" else ())
        hands = generator.choice(acting, CREWS, replace=len(acting) < CREWS)
        schedules = generator.permutation(np.resize(SCHEDULES, CREWS))
        for turn in range(CREWS):
            chosen = np.flatnonzero((tier == level) & (turn_of == turn))
            motion, noise = generator.choice(settings.motions), generator.choice(settings.noise)
            crew = Crew(next(next_axis), level, str(hands[turn]), str(motion), str(schedules[turn]), float(noise))
            kinds = (MOVING if turn % 2 else DAMAGED) if settings.harsh else [""]
            states = generator.choice(3, len(chosen), p=settings.states)
            members = Members(numbers[chosen], seeds[chosen], states, generator.choice(kinds, len(chosen)))
            if len(chosen):
                parts += simulated_crew(task_of(crew.axis), crew, members, generator)
    parts.sort(key=lambda part: int(part[1]["recording"]))
    return pd.concat([rows for rows, _ in parts], ignore_index=True), pd.DataFrame([label for _, label in parts])


def simulated_crew(
    config: TaskConfig, crew: Crew, members: Members, generator: np.random.Generator
) -> Iterator[tuple[pd.DataFrame, dict[str, Any]]]:
    """Simulate the recordings of a crew; yields the rows and the label of each."""
    count = len(members.seeds)
    sensors = config.sensors.model_dump()
    for name in SENSORS:
        sensors[name]["noise"] *= crew.noise
    leakage = config.leakage.model_dump() | {"schedule": crew.schedule, "start_range": (0.1, 0.7)}
    task = MOTIONS[crew.motion](task_config(config, episode_duration=DURATION, leakage=leakage, sensors=sensors))
    bound = config.leakage.class_bounds[0]
    shares = np.where(members.states[:, None] == LEAKING, LEAKS, HEALTHY)
    flow = np.minimum(bound * np.exp(generator.uniform(*np.log(shares).T)), LEAKAGE_LIMIT)
    faults, names = drawn_faults(config, generator, members.states)
    gains = pid_from_figures(task) if crew.acting == "PID" else None
    made = ACTING[crew.acting]
    controller: Controller = PID(gains, task) if gains is not None else made(task, count, int(members.seeds[0]))
    moves = None
    if members.harsh[0] in MOVING:  # a crew has a moving supply or sensor, or damaged rows
        moves = drawn(generator, members.harsh, task.steps, task.control_period)
        controller = Disturbed(controller, moves)
    noted = _Noted(controller)
    signals, run = measured_run(task, noted, Cases(members.seeds, flow, faults=faults))
    if moves is not None:
        signals[:, PRESSURES] += moves.course[:, DRIFTS]
    for axis in range(count):
        rows = task.steps if run.failed_at[axis] < 0 else int(run.failed_at[axis]) + 1
        end = rows * task.control_period
        onset, before = 0.0, flow[axis]
        if crew.schedule != "constant":
            onset, before = noted.onset[axis], noted.before[axis]
        leaks = bool(members.states[axis] == LEAKING and onset < end)
        if crew.schedule == "growth" and leaks:  # the seal leaks once it passes more than a healthy one
            first, last = np.log(before), np.log(flow[axis])
            onset += (DURATION - onset) * np.clip((np.log(bound) - first) / (last - first), 0.0, 1.0)
            leaks = bool(onset < end)
        cause = CAUSE_OF_FAULT.get(names[axis], Cause.NONE)
        label = {
            "recording": int(members.numbers[axis]),
            "axis": crew.axis,
            "new_axis": crew.axis >= FIRST_NEW,
            "tier": crew.tier,
            "seconds": end,
            "leak": leaks,
            "onset": float(onset) if leaks else np.nan,
            "schedule": crew.schedule,
            "size": float(run.leakage_flow_lpm[axis]),
            "size_before": float(before),
            "size_share": float(run.leakage_flow_lpm[axis]) / bound,
            "cause": Cause.INTERNAL_LEAK.word if leaks else cause.word,
            "fault": names[axis],
            "harsh": str(members.harsh[axis]),
            "acting": crew.acting,
            "motion": crew.motion,
        }
        yield rows_of(signals[axis, :, :rows], task.control_period, label, generator), label


def drawn_faults(
    config: TaskConfig, generator: np.random.Generator, states: Indices
) -> tuple[dict[str, Floats], list[str]]:
    """Other faults of N axes: magnitudes (N,) by name, and the name of each axis's fault."""
    sizes: dict[str, Floats] = {}
    names = [""] * len(states)
    sensors = [name for name in SENSORS if getattr(config.sensors, name).fitted]
    # Beside a leak from chamber b, a valve without underlap holds no weight: it lets chamber a run empty.
    hangs = config.plant.load.external_force != 0.0
    kinds = [kind for kind in FAULTS if kind != EXTERNAL_LEAK or not hangs]
    for axis in np.flatnonzero(states == OTHER):
        kind = str(generator.choice(kinds))
        size = generator.uniform(*getattr(config.faults, kind).range)
        if kind in SIGNED_KINDS:
            size *= generator.choice((-1.0, 1.0))
        if kind == EXTERNAL_LEAK:
            size = min(leak_scale(config) * size, fault_limits(EXTERNAL_LEAK)[1])
        # An offset of the position is the same as another place of the axis.
        visible = [name for name in faults_of(kind, sensors) if name != "position_offset"]
        names[axis] = str(generator.choice(visible))
        sizes.setdefault(names[axis], np.zeros(len(states)))[axis] = size
    return sizes, names


def rows_of(signals: Floats, period: float, label: dict[str, Any], generator: np.random.Generator) -> pd.DataFrame:
    """The rows of one recording from its signals (5, T), with its lost rows and spikes."""
    count = signals.shape[1]
    if label["harsh"] == "spikes":
        hit = generator.random((len(PRESSURES), count)) < 0.02
        signals[PRESSURES] += np.where(hit, generator.normal(0.0, 10e5, hit.shape), 0.0)
    kept = np.ones(count, dtype=bool)
    if label["harsh"] == "lost rows":
        kept = np.asarray(generator.random(count) >= 0.05)
    numbers = {name: np.full(count, label[name], dtype=np.int32) for name in ("recording", "axis")}
    table = pd.DataFrame(numbers)
    table[heading("time")] = np.round(np.arange(count) * period, 6)
    for name, values in zip(MEASURED, signals, strict=True):
        table[heading(name)] = (values / factor(name, WRITTEN_UNITS[name], name)).astype(np.float32)
    return table[kept]


def labels_folder(folder: Path, split: str) -> Path:
    """Where the labels of a split are; those of the test split stand apart, so that the rest can be published."""
    return (folder / "hidden" if split == "test" else folder) / f"{split}_labels"


def write_block(folder: Path, split: str, block: int, count: int) -> None:
    """Simulate a block and write its files, the labels last; one that is there stays."""
    labels_file = labels_folder(folder, split) / f"{block:04d}.parquet"
    if labels_file.exists():
        return
    rows, labels = simulated_block(split, block, count)
    (folder / split).mkdir(parents=True, exist_ok=True)
    labels_file.parent.mkdir(parents=True, exist_ok=True)
    rows.to_parquet(folder / split / labels_file.name, index=False, compression="zstd")
    labels.to_parquet(labels_file, index=False, compression="zstd")


def write_challenge(folder: Path, count: int = 600, jobs: int = 1) -> None:
    """Write the axes, and the recordings and labels of all splits."""
    folder.mkdir(parents=True, exist_ok=True)
    axes_table().to_parquet(folder / "axes.parquet", index=False)
    blocks = []
    for split, share in SHARES.items():
        here = round(count * share)
        for block, first in enumerate(range(0, here, BLOCK)):
            blocks.append(delayed(write_block)(folder, split, block, min(BLOCK, here - first)))
    Parallel(jobs)(blocks)


def main() -> None:
    """Read the arguments and write the files."""
    given = command_line(__doc__, "folder", count=600, jobs=2)
    write_challenge(given.folder, given.count, given.jobs)


if __name__ == "__main__":
    main()
