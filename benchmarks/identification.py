"""How well `hydro identify` finds hidden rigs: 20 s under the PID, noise, biases and a leak; intervals, held-back part.

Run: python benchmarks/identification.py [--rigs 40] [--rig NAME|FILE] [--without pressure_a pressure_b] [--validation]

Each seed hides a rig: its parameters, leak and biases of the sensors are drawn from the ranges of the rig file. The
code behind `hydro record` writes the recording, the code behind `hydro identify` reads it. Figures: test seeds.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hydro_agents.estimation.unknowns import BIASES, EXTERNAL_LEAKAGE, EXTERNAL_RESISTANCE, LEAKAGE
from hydro_agents.learning.opponents import opponent
from hydro_agents.recordings.simulated import record_axis
from hydro_agents.rigs.identify import Identification, identify
from hydro_agents.running.seeds import EVALUATION, THRESHOLDS
from hydro_env import HydroError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import write_yaml
from hydro_env.plant.parameters import PARAMETER_PATHS, to_vector
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import Rig, read_rig
from hydro_env.task.sensors import SENSOR_COLUMNS, SENSORS
from hydro_env.units import flow_from_resistance


def rig_with_ranges(name: str | None, folder: Path) -> Rig:
    """A rig file that leaves open all that an episode of its task draws."""
    config = task_config(None, rig=name)
    groups = config.plant.model_dump(mode="json")
    groups["randomisation"] = {
        path: drawn.model_dump(mode="json", exclude_defaults=True) for path, drawn in config.randomisation.items()
    }
    file = folder / "rig.yaml"
    write_yaml(file, groups)
    return read_rig(file)


def truth(config: TaskConfig, seed: int) -> dict[str, float]:
    """True values of all unknowns by name."""
    env = ServoHydraulicVectorEnv(1, config, info=False)
    env.reset(seed=[seed])
    values = dict(zip(PARAMETER_PATHS, to_vector(env.axes.parameters(0)).tolist(), strict=True))
    values |= dict(zip(BIASES, env.axes.column("bias")[0, SENSOR_COLUMNS].tolist(), strict=True))
    values[LEAKAGE] = float(env.axes.column("leak_flow")[0])
    values[EXTERNAL_LEAKAGE] = flow_from_resistance(values[EXTERNAL_RESISTANCE])
    env.close()
    return values


def one(seed: int, config: TaskConfig, rig: Rig, folder: Path, arguments: argparse.Namespace) -> Identification:
    """Record one hidden rig and identify it."""
    file = folder / f"{seed}.csv"
    controller = opponent(arguments.controller, config, "--controller")
    record_axis(file, config, controller, seed, family=arguments.family)
    if arguments.without:
        lines = file.read_text(encoding="utf-8").splitlines()
        cells = [line.split(",") for line in lines]
        keep = [place for place, head in enumerate(cells[0]) if head.split(" ")[0] not in arguments.without]
        file.write_text("\n".join(",".join(row[place] for place in keep) for row in cells) + "\n", encoding="utf-8")
    return identify(file, config, rig)


def main() -> None:
    """Identify the hidden rigs and print one line for each, then a table of all parameters."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="the first seed's place among the seeds")
    parser.add_argument("--rig", default=None, help="a rig whose ranges the hidden rigs are drawn from")
    parser.add_argument("--controller", default="pid")
    parser.add_argument("--duration", type=float, default=20.0, help="s")
    parser.add_argument("--family", default=None, help="of references; default: drawn")
    parser.add_argument("--without", nargs="+", default=[], choices=SENSORS[1:], help="sensors that are absent")
    parser.add_argument("--validation", action="store_true", help="validation seeds instead of test seeds")
    arguments = parser.parse_args()
    print(f"{os.cpu_count()} cores; load {os.getloadavg()[0]:.1f}")
    seeds = (THRESHOLDS if arguments.validation else EVALUATION).take(arguments.rigs, arguments.first)
    shares, times, refused, rows = [], [], 0, []
    with tempfile.TemporaryDirectory() as name:
        rig = rig_with_ranges(arguments.rig, Path(name))
        config = task_config(None, rig=rig.source, episode_duration=arguments.duration)
        for seed in seeds:
            began, cost = time.monotonic(), time.process_time()
            try:
                found = one(seed, config, rig, Path(name), arguments)
            except HydroError as error:
                refused += 1
                print(f"{seed}: {error}", flush=True)
                continue
            times.append((time.monotonic() - began, time.process_time() - cost))
            if not found.describes:
                refused += 1
            else:
                shares.append(found.share)
                true, fit = truth(config, seed), found.fit
                for unknown, low, high, left, known in zip(
                    fit.names, fit.low, fit.high, fit.remaining, fit.determined, strict=True
                ):
                    value = true[unknown]
                    rows.append((seed, unknown, known, low <= value <= high, left, _away(value, low, high)))
            here = [row for row in rows if row[0] == seed and row[2]]
            print(
                f"{seed}: {found.verdict()}; {sum(row[3] for row in here)} of {len(here)} intervals hold the truth, "
                f"farthest {max((row[5] for row in here), default=0.0):.1f} σ; "
                f"{int(found.fit.explained.sum())} of {len(found.fit.misfit)} windows explained, "
                f"widening {found.fit.widening:.2f}; {times[-1][0]:.0f} s, {times[-1][1]:.0f} s of one core",
                flush=True,
            )
    _report(rows, np.array(shares), np.array(times), refused, len(seeds))


def _away(value: float, low: float, high: float) -> float:
    """Distance of the truth from the middle of the interval, in standard deviations."""
    return abs(value - 0.5 * (low + high)) / max((high - low) / 3.92, 1e-300)


def _report(
    rows: list[tuple[int, str, Any, Any, Any, float]], shares: np.ndarray, times: np.ndarray, refused: int, count: int
) -> None:
    moved = shares[np.isfinite(shares)]
    print(f"\n{count} rigs, {refused} refused, {len(shares) - len(moved)} stood still on the held-back part")
    if len(moved):
        print(
            f"share of the position's variance: median {100 * np.median(moved):.3f} %, "
            f"lowest {100 * moved.min():.3f} %; at least 95 % in {np.mean(moved >= 0.95):.0%}, "
            f"at least 99 % in {np.mean(moved >= 0.99):.0%} of the rigs"
        )
    if len(times):
        print(f"time: median {np.median(times[:, 0]):.0f} s, longest {times[:, 0].max():.0f} s; "
              f"of one core {np.median(times[:, 1]):.0f} s, {times[:, 1].max():.0f} s")  # fmt: skip
    known = [row for row in rows if row[2]]
    if known:
        print(f"determined: {len(known) / len(rows):.1%} of the unknowns; within their 95 % interval: "
              f"{np.mean([row[3] for row in known]):.1%}")  # fmt: skip
        by_rig = [np.mean([row[3] for row in known if row[0] == seed]) for seed in {row[0] for row in known}]
        print(f"rigs with at least 90 % of their determined unknowns within: {np.mean(np.array(by_rig) >= 0.9):.0%}")
    print(f"\n{'unknown':32} determined  within  median uncertainty left")
    for name in dict.fromkeys(row[1] for row in rows):
        own = [row for row in rows if row[1] == name]
        sure = [row[3] for row in own if row[2]]
        within = f"{np.mean(sure):6.0%}" if sure else "     –"
        print(f"{name:32} {np.mean([row[2] for row in own]):9.0%}  {within}  {np.median([row[4] for row in own]):8.3f}")


if __name__ == "__main__":
    main()
