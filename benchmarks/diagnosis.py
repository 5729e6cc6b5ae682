"""What `hydro diagnose` answers on recordings of simulated axes: verdicts, size errors, intervals.

Run: python benchmarks/diagnosis.py [--share 1.0]

``--share`` of the recordings, for a quick look. Each lasts 4 s (two windows), has a test seed of its own, and takes the
whole way: file, checks, both detectors, verdict. The shipped PID moves the axis; plant and family of
references are drawn from the default task. Recordings with errors of every kind: hostile_inputs.py.
"""

import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import command_line
from hydro_agents.learning.loading import shipped
from hydro_agents.running.seeds import DIAGNOSIS
from hydro_env import TaskConfig
from hydro_rig.diagnosis.diagnose import diagnose
from hydro_rig.diagnosis.verdict import Kind, Verdict
from hydro_rig.recordings.simulated import record_axis

TASK = TaskConfig(episode_duration=4.0)
LUGRE = TASK.model_copy(update={"plant": TASK.plant.replace(friction={"model": "lugre"})})


class Axis(NamedTuple):
    """One row of a table: axes that are alike."""

    name: str
    recordings: int
    leak: float = 0.01  # l/min at 100 bar
    faults: Mapping[str, float] = {}
    task: TaskConfig = TASK


AXES = (
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
)


def diagnosed(axis: Axis, seeds: range, folder: Path) -> list[Verdict]:
    """The verdict on one recording per seed."""
    controller, file = shipped("pid", axis.task), folder / "axis.csv"
    found = []
    for seed in seeds:
        record_axis(file, axis.task, controller, seed, axis.leak, faults=axis.faults)
        found.append(diagnose(file, TASK).verdict)
    return found


def row(axis: Axis, found: list[Verdict]) -> str:
    """One row of a table in Markdown; the name of a fault stands there without its size, to count equal answers."""
    verdicts: Counter[str] = Counter()
    for one in found:
        told = one.why and one.kind is not Kind.UNKNOWN
        verdicts[one.kind + (f" ({one.why.split(' (')[0]})" if told else "")] += 1
    answers = ", ".join(f"{verdict} {count}" for verdict, count in verdicts.most_common())
    leaks = [one.leak for one in found if one.leak is not None]
    error = f"{np.median([abs(leak.value - axis.leak) for leak in leaks]):.2g}" if leaks else "–"
    inside = f"{sum(leak.low <= axis.leak <= leak.high for leak in leaks)} of {len(leaks)}" if leaks else "–"
    return f"| {axis.name} | {len(found)} | {answers} | {error} | {inside} |"


def main() -> None:
    """Print the table."""
    given = command_line(__doc__, share=1.0)
    skip = 0
    print("| axis | recordings | verdicts | size error, median | interval holds |\n|---|---:|---|---:|---:|")
    with tempfile.TemporaryDirectory() as folder:
        for axis in AXES:
            seeds = DIAGNOSIS.take(max(round(given.share * axis.recordings), 1), skip)
            print(row(axis, diagnosed(axis, seeds, Path(folder))), flush=True)
            skip += axis.recordings


if __name__ == "__main__":
    main()
