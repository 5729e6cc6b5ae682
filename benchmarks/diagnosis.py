"""What `hydro diagnose` answers on recordings of simulated axes: verdicts, size errors, intervals.

Run: python benchmarks/diagnosis.py [--only faults sensors handling errors clocks rest supply] [--share 1.0]

Each recording lasts 4 s (two windows), has a test seed of its own, and takes the whole way: file, checks, both
detectors, verdict. The shipped PID moves the axis; plant and family of references are drawn from the default task.
In the table ``supply`` the supply swings or sags as in the training of the leakage head, at the valve; its transducer
has an offset and noise of its own. In the table ``rest`` an axis works and then stands, under a proportional or the
flow-linearising controller; the two-stage detector, which remembers the work, reads it.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import Reading, Windows, measured_run
from hydro_agents.detection.disturbances import Disturbed, drawn
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.detection.operations import ACTING, MOTIONS, at_rest
from hydro_agents.learning.loading import shipped
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import DIAGNOSIS
from hydro_env import TaskConfig
from hydro_env.plant.states import State
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_rig.diagnosis.diagnose import diagnose
from hydro_rig.diagnosis.verdict import Kind, Limits, Verdict, judge
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.known_windows import leak_cases
from hydro_rig.estimation.model import noise_of
from hydro_rig.estimation.two_stage import TwoStageDetector
from hydro_rig.recordings.simulated import record_axis

TASK = TaskConfig(episode_duration=4.0)
STAND = at_rest(TaskConfig(episode_duration=180.0))
LOOKS = (2.0, 4.0), (60.0, 120.0, 180.0)
"""Ends of the windows that are read, s: of the work and of the standstill, one a minute. Its first three minutes stand
for twenty: later windows show the same but for the noise."""
WRONG_RIG = TASK.model_copy(update={"plant": TASK.plant.replace(cylinder={"rod_diameter": 0.024})})
QUIET = {name: {"noise": 0.5 * getattr(TASK.sensors, name).noise} for name in SENSORS}
LUGRE = TASK.model_copy(update={"plant": TASK.plant.replace(friction={"model": "lugre"})})

SUPPLY = State._fields.index("supply_pressure")
GAUGE_OFFSET, GAUGE_NOISE = (-0.5e5, 0.5e5), 0.3e5  # Pa, of the supply's transducer

UNITS = {"position [mm]": 1e3, "pressure_a [bar]": 1e-5, "pressure_b [bar]": 1e-5, "spool_position [%]": 100.0}
EXCHANGED = {"pressure_a [bar]": "pressure_b [bar]", "pressure_b [bar]": "pressure_a [bar]"}

Change = Callable[[pd.DataFrame], pd.DataFrame]


class Gauged(Disturbed):
    """A controller on one axis whose supply moves, and the pressure there at each of its samples."""

    def __init__(self, controller: Controller, seed: int) -> None:
        random, steps, period = np.random.default_rng(seed), TASK.steps, TASK.control_period
        kind = np.array([("supply swings", "supply sags")[seed % 2]])
        super().__init__(controller, drawn(random, kind, steps, period)._replace(direct=np.array([True])))
        self.pressure: list[float] = []
        self.error = random.uniform(*GAUGE_OFFSET) + GAUGE_NOISE * random.standard_normal(steps)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], Any]:
        """As before; note the pressure."""
        command = super().predict(observation, state, episode_start, deterministic)
        self.pressure.append(float(self._axes.state[0, SUPPLY]))
        return command

    def read(self, rows: int) -> Floats:
        """Readings of the transducer, bar."""
        return 1e-5 * (np.array(self.pressure[:rows]) + self.error[:rows])


class Axis(NamedTuple):
    """One row of a table: axes that are alike."""

    name: str
    recordings: int
    leak: float = 0.01  # l/min at 100 bar
    faults: Mapping[str, float] = {}
    task: TaskConfig = TASK
    change: Change | None = None  # what is done to the file
    supply: str = "constant"  # or "moves", "recorded"


def without(*signals: str) -> Change:
    """Columns that are missing."""
    return lambda table: table[[name for name in table if name.split()[0] not in signals]]


def with_errors(seed: int, error: Callable[[np.random.Generator, int], Floats]) -> Change:
    """Readings with an error: a function of a generator and a number of rows, in units of the data sheet's noise."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        changed, random = table.copy(), np.random.default_rng(seed)
        for (column, unit), noise in zip(UNITS.items(), noise_of(TASK), strict=True):
            if column in table:
                changed[column] += unit * float(noise) * error(random, len(table))
        return changed

    return change


def with_noise(factor: float, memory: float = 0.0) -> Change:
    """Readings with ``factor`` times the noise of the data sheet; with a ``memory`` in rows, it is coloured."""
    keep, size = math.exp(-1.0 / memory) if memory else 0.0, math.sqrt(factor**2 - 1.0)

    def error(random: np.random.Generator, rows: int) -> Floats:
        return np.asarray(lfilter([size * math.sqrt(1.0 - keep**2)], [1.0, -keep], random.standard_normal(rows)))

    return with_errors(1, error)


def spikes(random: np.random.Generator, rows: int) -> Floats:
    """Two readings of a hundred are wrong by about 20 times the noise."""
    struck = random.random(rows) < 0.02
    return struck * 20.0 * random.standard_normal(rows)


def with_rows_lost(table: pd.DataFrame) -> pd.DataFrame:
    """One row of twenty is missing, at random places."""
    return table[np.random.default_rng(3).random(len(table)) >= 0.05]


def drifting(table: pd.DataFrame) -> pd.DataFrame:
    """The sensor of pressure a drifts by 5 bar during the recording."""
    return table.assign(**{"pressure_a [bar]": table["pressure_a [bar]"] + np.linspace(0.0, 5.0, len(table))})


def command_moved(rows: int) -> Change:
    """The command is logged some rows later, or earlier, than assumed."""
    return lambda table: table.assign(**{"command [V]": table["command [V]"].shift(rows)}).iloc[
        abs(rows) : len(table) - abs(rows)
    ]


def logged_every(step: float) -> Change:
    """What a logger with a clock of its own writes: the readings at its rows, and the command that acts there."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        stamps = table["time [s]"].to_numpy()
        rows = np.arange(0.0, stamps[-1], step)
        return relogged(table, rows, np.searchsorted(stamps + TASK.command_latency, rows))

    return change


def relogged(table: pd.DataFrame, time: Floats, command_of: NDArray[np.int64]) -> pd.DataFrame:
    """The table at other times, s, with the commands of some of its rows."""
    stamps = table["time [s]"].to_numpy()
    columns = {name: np.interp(time, stamps, table[name]) for name in table}
    columns["command [V]"] = table["command [V]"].to_numpy()[np.minimum(command_of, len(stamps) - 1)]
    return pd.DataFrame(columns)


def stamped_late(by: float, sampled_there: bool) -> Change:
    """Stamps that jitter by up to ``by`` s; the readings are those of the stamps, or of rows at equal distances."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        stamps = table["time [s]"].to_numpy()
        late = np.sort(stamps + np.random.default_rng(4).uniform(-by, by, len(stamps)))
        if sampled_there:
            return relogged(table, late, np.searchsorted(stamps, late))
        return table.assign(**{"time [s]": late})

    return change


TABLES: dict[str, tuple[Axis, ...]] = {
    "faults": (
        Axis("healthy, 0.01 l/min", 30),
        *(Axis(f"leak of {leak:g} l/min", 12, leak) for leak in (0.05, 0.1, 0.3, 1.0)),
        Axis("null shift 1 %", 8, faults={"valve_null_shift": 0.01}),
        Axis("underlap + 3 %", 8, faults={"valve_underlap": 0.03}),
        Axis("rated flow × 0.7", 8, faults={"valve_flow": -0.3}),
        Axis("return line + 5 bar", 8, faults={"tank_pressure": 5e5}),
        Axis("external leak 1.5 l/min", 8, faults={"external_leak": 1.5}),
        Axis("offset of pressure sensor a, 3 %", 8, faults={"pressure_a_offset": 0.03}),
        Axis("offset of the spool sensor, −1 %", 8, faults={"spool_position_offset": -0.01}),
        Axis("hysteresis 2 %", 8, faults={"valve_hysteresis": 0.02}),
        Axis("pressure sensor b frozen", 8, faults={"pressure_b_freeze": 1.0}),
        Axis("gain of pressure sensor a, 1.05", 8, faults={"pressure_a_gain": 0.05}),
        Axis("LuGre friction, leak of 1 l/min", 6, 1.0, task=LUGRE),
    ),
    "sensors": tuple(
        Axis(f"{name}, {leak:g} l/min", 8, leak, change=without(*absent))
        for name, absent in (
            ("no spool position", ("spool_position",)),
            ("no position", ("position",)),
            ("no pressures", ("pressure_a", "pressure_b")),
            ("pressure b alone", ("pressure_a", "position", "spool_position")),
            ("position alone", ("pressure_a", "pressure_b", "spool_position")),
        )
        for leak in (0.01, 0.1, 0.5)
    ),
    "handling": (
        *(
            Axis(f"{motion}, {leak:g} l/min", 8, leak, task=MOTIONS[motion](TASK))
            for motion in ("standing still", "slow")
            for leak in (0.01, 0.1, 0.5)
        ),
        Axis("pressures exchanged, 0.5 l/min", 8, 0.5, change=lambda table: table.rename(columns=EXCHANGED)),
        Axis("every second row (10 ms), 0.5 l/min", 8, 0.5, change=lambda table: table.iloc[::2]),
    ),
    "errors": tuple(
        Axis(f"{name}, {leak:g} l/min", 8, leak, task=task, change=change)
        for name, task, change in (
            ("noise × 0.5", task_config(TASK, sensors=QUIET), None),
            ("noise × 1.3", TASK, with_noise(1.3)),
            ("noise × 3", TASK, with_noise(3.0)),
            ("coloured noise × 2", TASK, with_noise(2.0, memory=5.0)),
            ("2 % spikes", TASK, with_errors(2, spikes)),
            ("5 % of rows lost", TASK, with_rows_lost),
            ("pressure sensor a drifts by 5 bar", TASK, drifting),
            ("latency 2 ms", task_config(TASK, command_latency=2e-3), None),
            ("transducers of 3 ms", task_config(TASK, sensors={"pressure_rise_time": 3e-3}), None),
            ("command a row late", TASK, command_moved(1)),
            ("command a row early", TASK, command_moved(-1)),
            ("LuGre friction", LUGRE, None),
            ("rod of 24 mm, file says 28", WRONG_RIG, None),
        )
        for leak in (0.01, 0.3)
    ),
    "clocks": tuple(
        Axis(f"{name}, {leak:g} l/min", 8, leak, task=task, change=change)
        for name, task, change in (
            ("controller and log of 4.883 ms", task_config(TASK, control_period=1.0 / 204.8), None),
            ("a logger of 4.883 ms", TASK, logged_every(1.0 / 204.8)),
            ("a logger of 7.3 ms", TASK, logged_every(7.3e-3)),
            ("stamps jitter by 2 ms", TASK, stamped_late(2e-3, False)),
            ("stamps jitter by 4 ms", TASK, stamped_late(4e-3, False)),
            ("taken at stamps that jitter by 4 ms", TASK, stamped_late(4e-3, True)),
        )
        for leak in (0.01, 0.3)
    ),
    "rest": (
        Axis("leak of 0.1 l/min", 60, 0.1),
        Axis("leak of 0.3 l/min", 60, 0.3),
        Axis("healthy, 0.01 l/min", 60),
        Axis("null shift + 1.5 %", 60, faults={"valve_null_shift": 0.015}),
        Axis("null shift − 1.5 %", 60, faults={"valve_null_shift": -0.015}),
        Axis("underlap + 3.5 %", 60, faults={"valve_underlap": 0.035}),
        Axis("return line + 5 bar", 60, faults={"tank_pressure": 5e5}),
    ),
    "supply": tuple(
        Axis(f"supply {how}, {leak:g} l/min", 40, leak, supply=how)
        for how in ("recorded", "moves")
        for leak in (0.01, 0.3)
    ),
}


def standing(axis: Axis, seeds: range) -> list[Verdict]:
    """The answers on axes that have worked (``axis.task``) and then stood, half under each controller."""
    verdicts = []
    for acting, some in (("proportional", seeds[::2]), ("flow-linearising", seeds[1::2])):
        detector = TwoStageDetector(HeadDetector.load(), EstimatorDetector(restarts=0), remembers=True)
        cases, readings = leak_cases(some, len(some), axis.leak, axis.faults), []
        for task, ends in zip((axis.task, STAND), LOOKS, strict=True):
            signals, _ = measured_run(task, ACTING[acting].make(task, len(some), some[0]), cases)
            for end in ends:
                last = round(end / task.control_period)
                readings.append(detector.read(Windows.of(signals[:, :, last - 400 : last]), task))
        for row in range(len(some)):
            looks = [one.part(np.array([row])) for one in readings[len(LOOKS[0]) :]]
            looked = Reading(*map(np.concatenate, zip(*looks, strict=True)))
            verdicts.append(judge([], looked, None, Limits.of(TASK)))
    return verdicts


def diagnosed(axis: Axis, seeds: range, head: LeakageHead, folder: Path) -> list[Verdict]:
    """The verdict on one recording per seed."""
    controller, file, found = shipped("pid", axis.task), folder / "axis.csv", []
    for seed in seeds:
        moved = Gauged(controller, seed)
        acting = controller if axis.supply == "constant" else moved
        record_axis(file, axis.task, acting, seed, axis.leak, faults=axis.faults)
        if axis.supply == "recorded":
            table = pd.read_csv(file)
            table.assign(**{"supply_pressure [bar]": moved.read(len(table))}).to_csv(file, index=False)
        if axis.change is not None:
            axis.change(pd.read_csv(file)).to_csv(file, index=False)
        found.append(diagnose(file, TASK, head).verdict)
    return found


def row(axis: Axis, found: list[Verdict]) -> str:
    """One row of a table in Markdown; the name of a fault stands there without its size, to count equal answers."""
    verdicts = Counter(
        one.kind.value + (f" ({one.why.split(' (')[0]})" if one.why and one.kind is not Kind.UNKNOWN else "")
        for one in found
    )
    answers = ", ".join(f"{verdict} {count}" for verdict, count in verdicts.most_common())
    leaks = [one.leak for one in found if one.leak is not None]
    error = f"{np.median([abs(leak.value - axis.leak) for leak in leaks]):.2g}" if leaks else "–"
    inside = f"{sum(leak.low <= axis.leak <= leak.high for leak in leaks)} of {len(leaks)}" if leaks else "–"
    return f"| {axis.name} | {len(found)} | {answers} | {error} | {inside} |"


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(TABLES), default=list(TABLES))
    parser.add_argument("--share", type=float, default=1.0, help="of the recordings, for a quick look")
    arguments = parser.parse_args()
    head, skip = LeakageHead.load(pretrained_folder() / "leakage_head"), 0
    with tempfile.TemporaryDirectory() as folder:
        for name, axes in TABLES.items():
            if name in arguments.only:
                print(f"\n{name}\n\n| axis | recordings | verdicts | size error, median | interval holds |", flush=True)
                print("|---|---:|---|---:|---:|", flush=True)
            for axis in axes:
                if name in arguments.only:
                    count = max(round(arguments.share * axis.recordings), 1)
                    seeds = DIAGNOSIS.take(count, skip)
                    found = standing(axis, seeds) if name == "rest" else diagnosed(axis, seeds, head, Path(folder))
                    print(row(axis, found), flush=True)
                skip += axis.recordings


if __name__ == "__main__":
    main()
