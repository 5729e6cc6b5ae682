"""Error of the fast integrator against the reference solver over random plants, inputs and leaks.

Run: python benchmarks/accuracy.py [plants]
"""

import sys
import time

import numpy as np

from hydro_env import ServoHydraulicVectorEnv, simulate
from hydro_env.plant.equations import STATE_NAMES


def main(plants: int = 20) -> None:
    """Print the largest error of each state, in parts of its range along the run."""
    env = ServoHydraulicVectorEnv(plants)
    env.reset(seed=4_000_000)
    generator = np.random.default_rng(0)
    steps = (0.5e-3, 0.25e-3, 0.125e-3)
    errors = {step: [] for step in steps}
    seconds = dict.fromkeys(("radau", *steps), 0.0)
    for method in ("rk4", "radau"):  # compiles, so that compiling is not timed
        simulate(env.axes.parameters(0), [0.0], 5e-3, method=method)
    for axis in range(plants):
        parameters = env.axes.parameters(axis)
        voltage = np.repeat(np.clip(generator.normal(0.0, 1.5, 10), -5, 5), 8)
        began = time.perf_counter()
        exact = simulate(parameters, voltage, 5e-3, method="radau").states
        seconds["radau"] += time.perf_counter() - began
        spread = np.maximum(np.ptp(exact, axis=0), 1e-12)
        for step in steps:
            began = time.perf_counter()
            fast = simulate(parameters, voltage, 5e-3, maximum_step=step).states
            seconds[step] += time.perf_counter() - began
            errors[step].append(np.abs(fast - exact).max(axis=0) / spread)
    print(f"{plants} random plants, 0.4 s each; largest error of a state, in parts of its range (median, worst plant)")
    for step in steps:
        table = np.array(errors[step])
        print(f"\ninner step {1e3 * step:g} ms, {seconds['radau'] / seconds[step]:.0f} times faster than Radau")
        for row, name in enumerate(STATE_NAMES):
            print(f"  {name:16s} {np.median(table[:, row]):.1e}  {table[:, row].max():.1e}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
