"""How exactly `hydro leak-test` reads a leak when the wear of the valve is unknown: found, size, intervals, bound.

Run: python benchmarks/leak_test.py [--axes 16] [--leak 0 0.005 0.01 0.05] [--rig NAME|FILE] [--duration 60]
                                    [--stop both] [--validation] [--folder FOLDER]

The plan is made once for the rig. Each seed draws an axis: plant, wear of the valve (null shift, underlap, rated flow,
edge ratio), pressure of the return line, noise and biases of the sensors; all are unknown to the reading. The axis
runs the test, the recording is written as CSV and read by the code behind the command. A leak counts as found if it
lies above zero by 2.33 of its own standard deviations: 1 % false alarms, if these are right. Figures: test seeds.
Results in a folder are read again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from hydro_agents.running.seeds import LEAK_TESTS, THRESHOLDS
from hydro_env import TaskConfig
from hydro_env.files import write_text
from hydro_env.task.configuration import task_config
from hydro_rig.diagnosis.leak_test_plan import FIND, Plan, plan, simulated
from hydro_rig.diagnosis.leak_test_reading import read_leak_test
from hydro_rig.diagnosis.leak_test_steps import LeakTestSettings
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.recordings.simulated import recording_csv

VALIDATION_SKIP = 60_000  # seeds of validation before those of this benchmark


def judged(config: TaskConfig, test: Plan, seed: int, leak: float, folder: Path) -> dict[str, float]:
    """Run the test on one axis and read it."""
    axis = simulated(test.task, test.best.steps, 1, leak, range(seed, seed + 1))
    recording = folder / f"{seed}-{leak:g}.csv"
    time_stamps = config.control_period * np.arange(axis.signals.shape[2], dtype=np.float64)
    write_text(recording, recording_csv(time_stamps, axis.signals[0]))
    began = time.process_time()
    found = read_leak_test(recording, config)
    recording.unlink()
    result = {"seed": seed, "leak": leak, "core": time.process_time() - began}
    if found.fit is None:
        return result | {"value": np.nan, "deviation": np.nan, "bound": np.nan, "explained": 0.0}
    z = {
        name: (quantity.value - float(axis.value(name)[0])) / quantity.deviation
        for name, quantity in found.fit.quantities.items()
        if name != LEAKAGE
    }
    return result | {
        "value": found.fit.seal.value,
        "deviation": found.fit.seal.deviation,
        "bound": found.fit.seal.bound,
        "explained": found.fit.common.explained / len(found.windows),
        "others_within": float(np.mean([abs(one) <= 1.645 for one in z.values()])),
    }


def main() -> None:
    """Run the tests and print one line for each, then a table by leak."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--axes", type=int, default=16, help="of each leak")
    parser.add_argument("--leak", type=float, nargs="+", default=[0.0, 0.005, 0.01, 0.05], help="l/min at 100 bar")
    parser.add_argument("--rig", default=None)
    parser.add_argument("--duration", type=float, default=60.0, help="s")
    parser.add_argument("--stop", default="both", choices=["both", "extended", "retracted"])
    parser.add_argument("--validation", action="store_true", help="validation seeds instead of test seeds")
    parser.add_argument("--folder", type=Path, default=None, help="for the results, which it keeps")
    arguments = parser.parse_args()
    config = task_config(None, rig=arguments.rig)
    test = plan(config, LeakTestSettings.of(config, duration=arguments.duration, stop=arguments.stop))
    best = test.best
    print(f"{best.form.name}; bound {best.mean_bound:.2g}, worst {best.largest_bound:.2g} l/min at 100 bar")
    results = []
    with tempfile.TemporaryDirectory() as name:
        folder = arguments.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(arguments.axes):
            for place, leak in enumerate(arguments.leak):
                skip = place * 1000 + number  # every leak has axes of its own
                seed = (
                    THRESHOLDS.take(1, VALIDATION_SKIP + skip) if arguments.validation else LEAK_TESTS.take(1, skip)
                )[0]
                kept = folder / f"{seed}-{leak:g}.json"
                if not kept.exists():
                    write_text(kept, json.dumps(judged(config, test, seed, leak, folder)))
                results.append(json.loads(kept.read_text(encoding="utf-8")))
                one = results[-1]
                print(
                    f"{seed} {leak:g}: {one['value']:.5f} ± {one['deviation']:.5f}, bound {one['bound']:.5f}, "
                    f"{one['explained']:.0%} of the windows explained, {one['core']:.0f} s of one core",
                    flush=True,
                )
    _report(results)


def _report(results: list[dict[str, float]]) -> None:
    print(
        "\n| leak | axes | answered | found | error, median | largest | in 90 % interval | bound | error over bound |"
    )
    print("|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    for leak in sorted({one["leak"] for one in results}):
        rows = [one for one in results if one["leak"] == leak]
        value, deviation, bound = (np.array([one[name] for one in rows]) for name in ("value", "deviation", "bound"))
        answered = np.isfinite(value) & np.array([one["explained"] > 0.5 for one in rows])
        value, deviation, bound = value[answered], deviation[answered], bound[answered]
        error = value - leak
        within = np.abs(error) <= 1.645 * deviation
        ratio = np.sqrt(np.mean(error**2) / np.mean(bound**2))
        print(
            f"| {leak:g} | {len(rows)} | {len(value)} | {int((value > FIND * deviation).sum())} | "
            f"{np.median(np.abs(error)):.5f} | {np.abs(error).max():.5f} | {int(within.sum())} | "
            f"{np.median(bound):.5f} | {ratio:.2g} |"
        )


if __name__ == "__main__":
    main()
