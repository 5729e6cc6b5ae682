"""Speed of this checkout relative to another one, measured alternately in one run.

Run: python benchmarks/paired.py OTHER_CHECKOUT [--rounds 15] [--seconds 0.3] [--only single ...] [--cpu]

In every round each checkout measures each rate once, in a process of its own; their order changes from round to round.
A ratio above 1 means that this checkout is faster. This checkout given as the other one shows how large the noise is.
``--cpu`` divides by processor time instead of wall time: use it where other programs load the machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]
ENVIRONMENT_ID = "ServoHydraulic-v0"
NAMES = ("single", "vector", "kernel", "ppo")


def rates() -> dict[str, Callable[[float], float]]:
    """The measurements as functions of their duration (s): the functions of this checkout, the code of the other."""
    import gymnasium as gym

    import hydro_agents
    import hydro_env

    for package in (hydro_env, hydro_agents):
        if not Path(str(package.__file__)).resolve().is_relative_to(Path.cwd()):
            raise SystemExit(f"{package.__name__} was imported from {package.__file__}")
    sys.path.insert(0, str(HERE))
    from benchmarks.speed import BareKernel, native_model, rate, single_rate, vector_rate

    bare, (model, ppo) = BareKernel(1024, 1), native_model()
    steps = ppo.axes * ppo.steps_per_rollout
    return {
        "single": lambda seconds: single_rate(gym.make(ENVIRONMENT_ID), seconds),
        "vector": lambda seconds: vector_rate(gym.make_vec(ENVIRONMENT_ID, num_envs=1024), seconds),
        "kernel": lambda seconds: rate(bare.advance, seconds),
        "ppo": lambda seconds: steps * rate(lambda: int(bool(model.learn(steps))), seconds),
    }


def measured_in(checkout: Path, options: list[str]) -> list[float]:
    """Rates of a checkout, from a fresh process."""
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(checkout), str(checkout / "agents")])}
    command = [sys.executable, str(Path(__file__).resolve()), str(checkout), "--once", *options]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, cwd=checkout, env=variables, check=False)
    if done.returncode:
        raise SystemExit(f"{checkout}: cannot be measured; its error is printed above")
    found: list[float] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Measure, print the table."""
    parser = argparse.ArgumentParser(description="Speed of this checkout relative to another one.")
    parser.add_argument("other", type=Path, help="folder of the other checkout")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=0.3, help="duration of one measurement")
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--cpu", action="store_true", help="per second of processor time, not of wall time")
    parser.add_argument("--once", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.once:
        if given.cpu:
            time.perf_counter = time.process_time
        measures = rates()
        print(json.dumps([measures[name](given.seconds) for name in given.only]))
        return
    if not (given.other / "hydro_env").is_dir():
        parser.error(f"{given.other}: no checkout of this project, it has no folder hydro_env")
    options = ["--seconds", str(given.seconds), "--only", *given.only, *(["--cpu"] if given.cpu else [])]
    folders = [HERE, given.other.resolve()]
    rounds = []
    for number in range(given.rounds):
        order = (1, 0) if number % 2 else (0, 1)
        found = {place: measured_in(folders[place], options) for place in order}
        rounds.append((found[0], found[1]))
    values = np.array(rounds)  # (rounds, checkouts, rates)
    ratios = values[:, 0] / values[:, 1]
    print("| rate, 1/s | this checkout | other checkout | ratio, median | middle half | lowest–highest |")
    print("|---|---:|---:|---:|---|---|")
    for place, name in enumerate(given.only):
        least, low, middle, high, most = np.quantile(ratios[:, place], (0.0, 0.25, 0.5, 0.75, 1.0))
        own, other = np.median(values[:, :, place], axis=0)
        print(f"| {name} | {own:,.0f} | {other:,.0f} | {middle:.3f} | {low:.3f}–{high:.3f} | {least:.3f}–{most:.3f} |")
    print(f"{given.rounds} rounds, {'processor' if given.cpu else 'wall'} time, {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
