"""The rehearsal of an exported block: its C code moves the simulated axis, healthy, worn, wrong, and in an emergency.

:class:`CBlock` loads the code of a folder; :data:`SCENES` lists what happens; :func:`rehearse` plays them.
"""

import ctypes
import math
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.report.kit import BLUE, GREY, ORANGE, Page, drawn, legend, signal, time_panels
from hydro_agents.running.machine import Origin
from hydro_agents.running.seeds import CONTROLLER_VECTORS
from hydro_agents.running.tasks import own_reference
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig, task_config
from hydro_env.files import read_yaml, write_text
from hydro_env.plant.analysis import reachable_range
from hydro_env.plant.parameters import grouped
from hydro_env.task.randomisation import own_value
from hydro_env.task.record import FAILURES
from hydro_env.types import ByName, Floats, Indices
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.c_files import WARNINGS, compiled
from hydro_rig.export.contract import MeasuredSignals, State

JOB, FILES = "rehearse", ("rehearsal.html", "rehearsal.csv")
MOVED = 0.5  # of the reach with a weak supply, in its middle: from there to there a move goes
SAFE = 0.1  # of the stroke: no error, overshoot or travel after a fault may be larger
READY, REST = 0.1, 1.0  # s before the first move, and after each
SWINGS = 0.5  # s at the end of a rest, in which a limit cycle shows
PAUSE = 0.4  # s from the emergency stop to the restart
LOST_EVERY = 10  # samples; one of them is lost
SETTLED = 1e-3  # m; a move is over while the axis stays this close to its target
WEAK = 0.8  # of the supply's pressure
HEALTHY, WORN = 0.02, 4.0  # l/min at 100 bar
_FIELD = re.compile(r"^ +(int|long|float|double) (\w+);", re.MULTILINE)
_TYPES = {"int": ctypes.c_int, "long": ctypes.c_long, "float": ctypes.c_float, "double": ctypes.c_double}


class CBlock:
    """The block of an exported folder, compiled and loaded: its inputs and outputs are attributes of ``self.values``.

    Raises:
        ConfigurationError: it holds no exported block.
        HydroError: there is no compiler.
    """

    def __init__(self, folder: Path) -> None:
        sources = [file for file in folder.glob("*.c") if not file.name.startswith("test_")]
        if len(sources) != 1 or not (header := sources[0].with_suffix(".h")).is_file():
            raise ConfigurationError(f"{folder}: must be the folder of an exported controller, with its C code")
        texts = {file.name: file.read_text(encoding="utf-8") for file in (sources[0], header)}
        before_memory = texts[header.name].partition("typedef struct {")[2].partition("/* Memory")[0]
        fields = [(name, _TYPES[kind]) for kind, name in _FIELD.findall(before_memory)]
        self.names = {name for name, _ in fields}
        with tempfile.TemporaryDirectory() as place:
            compiled(texts, [*WARNINGS, "-shared", "-fPIC"], folder=Path(place))
            library = ctypes.CDLL(f"{place}/out")
        prefix = sources[0].stem
        size = getattr(library, f"{prefix}_size")
        size.restype = ctypes.c_size_t
        self._memory = ctypes.create_string_buffer(size())
        self._reset, self._step = getattr(library, f"{prefix}_reset"), getattr(library, f"{prefix}_step")
        self._step.restype = dict(fields)["command"]
        kind: Any = type("Block", (ctypes.Structure,), {"_fields_": fields})
        self.values = kind.from_buffer(self._memory)

    def reset(self) -> None:
        """A new block: off, with the usual limits and gains."""
        self._reset(self._memory)

    def step(self, inputs: ByName) -> float:
        """The command for one sample, V; inputs that are not given keep their values."""
        for name in inputs.keys() & self.names:
            setattr(self.values, name, inputs[name])
        return float(self._step(self._memory))


class Scene(NamedTuple):
    """What is wrong, from the start or at the event in the middle of the first move."""

    name: str
    what: str
    factors: Mapping[str, float] = {}  # of parameters of the plant, by path
    leak: float = HEALTHY  # l/min at 100 bar
    late: int = 0  # control periods by which the command comes too late
    event: str = ""
    last: State = State.CONTROLLING  # state at the end


SCENES = (
    Scene("healthy", "the axis of the rig file"),
    Scene("worn", f"a leak of {WORN:g} l/min past the piston", leak=WORN),
    Scene("slow valve", "a third of the bandwidth", {"valve.natural_frequency": 1.0 / 3.0}),
    Scene("heavy", "three times the mass", {"load.mass": 3.0}),
    Scene("weak supply", "four fifths of the pressure", {"supply.pressure": WEAK}),
    Scene("late", "two control periods more of latency", late=2),
    Scene("lost signals", f"each sensor in turn loses one of {LOST_EVERY} samples", event="lost"),
    Scene("broken cable", "no valid position any more", event="cable", last=State.HOLDING),
    Scene("emergency stop", "Enable falls in the middle of a move", event="stop", last=State.OFF),
    Scene("restart", f"Enable falls, and {PAUSE:g} s later the loop closes beside the reference", event="restart"),
)


class Take(NamedTuple):
    """What was recorded in a scene; times in s, lengths in m."""

    scene: Scene
    time: Floats
    position: Floats
    reference: Floats  # that the controller follows; NaN unless it controls
    command: Floats  # V
    state: Indices
    event: int  # number of its sample
    moves: tuple[int, int, int]  # number of the sample in which each move begins, and of the end
    targets: tuple[float, float]  # of the moves
    failure: str


def rehearse(folder: Path, rig: Path | None = None) -> tuple[TaskConfig, list[Take]]:
    """Play all scenes with the block of a folder; ``rig``: another one than that for which it was exported.

    Raises:
        ConfigurationError: the folder holds no exported block, or the rig cannot play a scene.
        HydroError: there is no compiler.
    """
    block = CBlock(folder)
    task = read_yaml(folder / "task.yaml") | {"randomisation": {}}  # every scene says what it changes
    config = task_config(task, rig=rig)
    return config, [_play(block, config, scene) for scene in SCENES]


def _play(block: CBlock, config: TaskConfig, scene: Scene) -> Take:
    period, weak = config.control_period, config.plant.supply.pressure * WEAK
    low, high = reachable_range(config.plant.replace(supply={"pressure": weak}))
    amplitude, middle = 0.5 * MOVED * (high - low), 0.5 * (low + high)
    targets = (middle + amplitude, middle - amplitude)
    signals = MeasuredSignals(config)
    block.reset()
    usual = block.values
    moving = 2.0 * amplitude / usual.max_speed + usual.max_speed / usual.max_acceleration
    ready, move, pause = (round(time / period) for time in (READY, moving + REST, PAUSE))
    if scene.event == "restart":  # it stands for the pause, and accelerates a second time
        move += pause + round(usual.max_speed / usual.max_acceleration / period)
    moves = (ready, ready + move, ready + 2 * move)
    event = ready + round(0.5 * moving / period)
    late = config.command_latency + scene.late * period
    reference = np.full(moves[-1] + 2, targets[1])
    changes: ByName = {"command_latency": late, "command_latency_range": None}
    task = task_config(own_reference(config, reference), **changes)
    env = ServoHydraulicVectorEnv(1, task, info=False)
    changed = {path: factor * own_value(config.plant, path) for path, factor in scene.factors.items()}
    options = {"leakage_flow_lpm": scene.leak, "initial_position": targets[1], "parameters": grouped(changed)}
    env.reset(seed=[CONTROLLER_VECTORS.first], options=options)
    sensors = [one.name for one in signals.signals if one.sensor and one.name in block.names]
    rows: list[tuple[float, ...]] = []
    failure = 0
    while len(rows) < moves[-1] and not failure:
        now = len(rows)
        wanted = targets[int(now >= moves[1])]
        inputs = signals.inputs_of(env.axes)
        inputs |= {"enable": True, "control": now >= ready, "reference": wanted}
        inputs |= _event(scene.event, now, event, pause, sensors)
        position = float(env.axes.column("position")[0])
        command = block.step(inputs)
        state = int(block.values.state)
        followed = block.values.internal_reference if state == State.CONTROLLING else math.nan
        rows.append((now * period, position, followed, command, state))
        env.step(np.array([[command / FULL_VOLTAGE]]))
        failure = int(env.axes.column("failure")[0])
    env.close()
    time, place, path, commands, state = np.array(rows).T
    states, end = state.astype(np.int64), FAILURES[failure]
    return Take(scene, time, place, path, commands, states, event, moves, targets, end)


def _event(event: str, now: int, begins: int, pause: int, sensors: list[str]) -> ByName:
    """Inputs that an event changes in a sample."""
    if event == "lost" and now % LOST_EVERY == LOST_EVERY // 2:
        name = sensors[now // LOST_EVERY % len(sensors)]
        return {name: math.nan, f"valid_{name}": False}
    if now < begins:
        return {}
    if event == "cable":
        return {"position": math.nan, "valid_position": False}
    if event == "stop":
        return {"enable": False}
    if event == "restart" and now < begins + pause:
        return {"enable": now >= begins + pause // 2, "control": False}
    return {}


# What an engineer signs -----------------------------------------------------------------------------------------------

COLUMNS = (
    *("peak error, mm", "overshoot, mm", "travel after the fault, mm", "swing at rest, mm", "time to hold, s"),
    *("largest command, V", "last state", "end"),
)


def signed(config: TaskConfig, takes: list[Take]) -> pd.DataFrame:
    """A row of :data:`COLUMNS` for each scene; ``end``: passed, or why not. NaN: does not apply."""
    safe, rows = 1e3 * SAFE * config.plant.cylinder.stroke, []
    for take in takes:
        lengths, time = _figures(take, config.control_period)
        end, last = take.failure, State(take.state[-1])
        if end == FAILURES[0]:
            end = "passed" if last == take.scene.last else f"must be {take.scene.last.name.lower()}"
            end = end if np.nanmax(lengths) <= safe else "beyond the safe distance"
        rows.append([*lengths, time, np.abs(take.command).max(), last.name.lower(), end])
    return pd.DataFrame(rows, [take.scene.name for take in takes], COLUMNS)


def _figures(take: Take, period: float) -> tuple[list[float], float]:
    """Peak error, overshoot, travel after the fault and swing in mm, and the longest time to hold in s."""
    controls, overshoots, swings, times = ~np.isnan(take.reference), [0.0], list[float](), list[float]()
    for begins, ends, target in zip(take.moves, take.moves[1:], take.targets, strict=False):
        controlled, position = controls[begins:ends], take.position[begins:ends]
        overshoots.append(np.max(np.sign(target - position[:1]) * (position - target), initial=0.0))
        if len(position) < ends - begins or not controlled[-1]:
            continue
        swings.append(np.ptp(position[-round(SWINGS / period) :]))
        last = np.flatnonzero(np.abs(position - target) > SETTLED)[-1]
        if last < len(position) - 1:
            closed = np.flatnonzero(controlled[1:] & ~controlled[:-1])
            times.append((last - max(closed, default=-1)) * period)
    error = np.max(np.abs(take.reference - take.position)[controls], initial=0.0)
    after = take.position[take.event :][~controls[take.event :]]
    travel = np.max(np.abs(after - after[0])) if len(after) else math.nan
    lengths = (error, max(overshoots), travel, max(swings, default=math.nan))
    return [1e3 * length for length in lengths], max(times, default=math.nan)


@drawn
def rehearsal_page(config: TaskConfig, takes: list[Take], table: pd.DataFrame, folder: str) -> Page:
    """The table on top, then position and command of each scene."""
    page = Page(f"Rehearsal of {folder}", FILES[1])
    failed = [name for name, end in table["end"].items() if end != "passed"]
    safe = f"{1e3 * SAFE * config.plant.cylinder.stroke:.3g} mm"
    verdict = f"In all {len(takes)} scenes it stays within {safe} and away from the end stops."
    if failed:
        verdict = f"It does not pass: {', '.join(failed)}."
    page.verdict(verdict, "worse" if failed else "good")
    page.text(
        f"The C code of the folder moves the simulated axis over the middle {MOVED:.0%} of its reach, "
        f"within its usual speed and acceleration. Safe: no error, overshoot or travel after a fault above {safe}, a "
        "tenth of the stroke. Time to hold: until the axis stays within 1 mm of its target. Swing: from the lowest to "
        "the highest position in the last half second of a rest."
    )
    page.table(table, "What an engineer signs")
    for take in takes:
        page.heading(take.scene.name.capitalize())
        axes = time_panels(("position, mm", "command, V"), height=4.0)
        signal(axes[0], take.time, 1e3 * take.reference, color=GREY, label="internal reference")
        signal(axes[0], take.time, 1e3 * take.position, color=BLUE, label="position")
        signal(axes[1], take.time, take.command, color=ORANGE)
        if take.scene.event in ("cable", "stop", "restart"):
            for one in axes:
                one.axvline(take.time[min(take.event, len(take.time) - 1)], color=GREY, linestyle=":")
        legend(axes[0])
        page.figure(axes, f"Position and command: {take.scene.name}", f"({take.scene.what})")
    return page


def write_rehearsal(output: Path, folder: Path, rig: Path | None, command: str) -> pd.DataFrame:
    """Rehearse, and write the page and the table; the table."""
    config, takes = rehearse(folder, rig)
    table = signed(config, takes)
    write_text(output / FILES[1], table.to_csv(index_label="scene", float_format="%.4g"))
    rehearsal_page(config, takes, table, folder.name).write(output / FILES[0], Origin.now(command))
    return table
