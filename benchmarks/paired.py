"""Speed of this checkout relative to another one, measured alternately in one run.

Run: python benchmarks/paired.py OTHER_CHECKOUT [--rounds 15] [--seconds 0.3]

In every round each checkout measures each rate once, in a process of its own; their order changes from round to round.
A ratio above 1 means that this checkout is faster. This checkout given as the other one shows how large the noise is.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]
NAMES = ("one axis", "1024 axes", "kernel", "PPO")


def rates(seconds: float) -> list[float]:
    """The rates by :data:`NAMES`: measured by the functions of this checkout, with the packages of the folder."""
    import gymnasium as gym

    import hydro_agents
    import hydro_env

    for package in (hydro_env, hydro_agents):
        assert Path(str(package.__file__)).resolve().is_relative_to(Path.cwd()), package.__file__
    sys.path.insert(0, str(HERE))
    from benchmarks.speed import BareKernel, native_model, rate, single_rate, vector_rate

    bare, (model, ppo) = BareKernel(1024, 1), native_model()
    steps = ppo.axes * ppo.steps_per_rollout
    return [
        single_rate(gym.make("hydro_env:ServoHydraulic-v0"), seconds),
        vector_rate(gym.make_vec("ServoHydraulic-v0", num_envs=1024), seconds),
        rate(bare.advance, seconds),
        steps * rate(lambda: int(bool(model.learn(steps))), seconds),
    ]


def measured_in(checkout: Path, seconds: float) -> list[float]:
    """Rates of a checkout, from a fresh process."""
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(checkout), str(checkout / "agents")])}
    command = [sys.executable, __file__, str(checkout), "--once", "--seconds", str(seconds)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, cwd=checkout, env=variables, check=True)
    found: list[float] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> None:
    """Measure, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="folder of the other checkout")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=0.3, help="duration of one measurement")
    parser.add_argument("--once", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.once:
        print(json.dumps(rates(given.seconds)))
        return
    folders = [HERE, given.other.resolve()]
    rounds = []
    for number in range(given.rounds):
        first = number % 2
        found = {place: measured_in(folders[place], given.seconds) for place in (first, 1 - first)}
        rounds.append([found[0], found[1]])
    values = np.array(rounds)  # (rounds, checkouts, rates)
    ratios = values[:, 0] / values[:, 1]
    print("| rate, 1/s | this checkout | other checkout | ratio, median | lowest–highest |\n|---|---:|---:|---:|---|")
    for place, name in enumerate(NAMES):
        own, other = np.median(values[:, :, place], axis=0)
        least, middle, most = np.quantile(ratios[:, place], (0.0, 0.5, 1.0))
        print(f"| {name} | {own:,.0f} | {other:,.0f} | {middle:.3f} | {least:.3f}–{most:.3f} |")


if __name__ == "__main__":
    main()
