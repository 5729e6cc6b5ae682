"""How exactly `hydro leak-test` reads a leak when the wear of the valve is unknown: found, size, intervals.

Run: python benchmarks/leak_test.py [--axes 16] [--leak 0 0.005 0.01 0.05] [--duration 60] [--folder FOLDER]

The plan is made once for the default rig. Each seed draws an axis: plant, wear of the valve (null shift, underlap,
rated flow, edge ratio), pressure of the return line, noise and biases of the sensors; all are unknown to the reading.
The axis runs the test, the recording is written as CSV and read by the code behind the command. A leak counts as found
if it lies above zero by 2.33 of its own standard deviations: 1 % false alarms, if these are right. Figures: test seeds.
"""

import time
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks import command_line, kept_rows
from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.running.seeds import LEAK_TESTS
from hydro_agents.running.text import markdown
from hydro_env import TaskConfig
from hydro_env.files import write_text
from hydro_env.task.configuration import task_config
from hydro_rig.diagnosis.leak_test import Plan, plan, read_leak_test, simulated
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.recordings.simulated import recording_csv

FIND = 2.326  # quantile of the normal distribution: 1 % false alarms
HEADER = ("leak", "axes", "answered", "found", "error, median", "largest", "in 90 % interval")


def reading(config: TaskConfig, test: Plan, seed: int, leak: float, folder: Path) -> dict[str, float]:
    """Run the test on one axis and read it."""
    axis = simulated(test.task, test.steps, 1, leak, range(seed, seed + 1))
    recording = folder / f"{seed}.csv"
    time_stamps = config.control_period * np.arange(axis.signals.shape[2], dtype=np.float64)
    write_text(recording, recording_csv(time_stamps, axis.signals[0]))
    began = time.process_time()
    found, quantities = read_leak_test(recording, config)
    recording.unlink()
    row = {"seed": seed, "leak": leak, "core_s": time.process_time() - began}
    if not quantities:
        return row | {"value": np.nan, "deviation": np.nan, "explained": 0.0}
    seal = quantities[LEAKAGE]
    row |= {"value": seal.value, "deviation": (seal.high - seal.low) / (2.0 * HALF_WIDTH)}
    return row | {"explained": float(found.reading.answers.mean())}


def summary(leak: float, rows: pd.DataFrame) -> list[str]:
    """One line of the table."""
    answered = rows[rows["value"].notna() & (rows["explained"] > 0.5)]
    error, deviation = (answered["value"] - leak).abs(), answered["deviation"]
    found, inside = answered["value"] > FIND * deviation, error <= HALF_WIDTH * deviation
    counts = [str(number) for number in (len(rows), len(answered), int(found.sum()))]
    return [f"{leak:g}", *counts, f"{error.median():.5f}", f"{error.max():.5f}", str(int(inside.sum()))]


def main() -> None:
    """Run the tests, then print a table by leak."""
    leaks_asked, folder = [0.0, 0.005, 0.01, 0.05], Path("results/leak_test")
    given = command_line(__doc__, axes=16, leak=leaks_asked, duration=60.0, folder=folder)
    config = task_config(None)
    test = plan(config, given.duration)
    print(test.line())
    leaks: dict[int, float] = {}  # by seed; every leak has axes of its own
    for place, leak in enumerate(given.leak):
        leaks |= dict.fromkeys(LEAK_TESTS.take(given.axes, 1000 * place), leak)
    given.folder.mkdir(parents=True, exist_ok=True)

    def rows_of(seed: int) -> list[dict[str, float]]:
        return [reading(config, test, seed, leaks[seed], given.folder)]

    rows = kept_rows(given.folder / "axes.csv", "seed", list(leaks), rows_of)
    print(markdown(HEADER, [summary(float(leak), part) for leak, part in rows.groupby("leak")]))


if __name__ == "__main__":
    main()
