"""Speed of this checkout relative to another one, measured alternately in one run.

Run: python benchmarks/paired.py OTHER_CHECKOUT [--rounds 15] [--seconds 0.3] [--only single ...] [--cpu] [--floor 0.97]

Each checkout runs in a process of its own and waits while the other one measures. In every round each of them
measures each rate once; the order within a pair changes from round to round. A ratio above 1 means that this checkout
is faster. This checkout given as the other one shows how large the noise is. ``--cpu`` divides by processor time
instead of wall time: use it where other programs load the machine.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
ENVIRONMENT_ID = "ServoHydraulic-v0"
NAMES = ("single", "vector", "kernel", "ppo")


def rates() -> dict[str, Callable[[float], float]]:
    """The measurements as functions of their duration (s), made of each checkout's own code."""
    import gymnasium as gym

    from benchmarks.environment_rows import single_rate, vector_rate
    from benchmarks.kernel_rows import BareKernel
    from benchmarks.table import rate
    from benchmarks.training_rows import default_study, native_model

    bare, settings = BareKernel(1024, 1), default_study()
    model, _ = native_model(settings, settings.ppo)
    steps = settings.ppo.axes * settings.ppo.steps_per_rollout
    return {
        "single": lambda seconds: single_rate(gym.make(ENVIRONMENT_ID), seconds),
        "vector": lambda seconds: vector_rate(gym.make_vec(ENVIRONMENT_ID, num_envs=1024), seconds),
        "kernel": lambda seconds: rate(bare.advance, seconds),
        "ppo": lambda seconds: steps * rate(lambda: int(bool(model.learn(steps))), seconds),
    }


def serve(checkout: Path, seconds: float) -> None:
    """Print one measured rate for each name read from standard input."""
    import hydro_env

    if not Path(hydro_env.__file__).resolve().is_relative_to(checkout.resolve()):
        raise SystemExit(f"{checkout}: hydro_env was imported from {hydro_env.__file__}")
    measures = rates()
    print("ready", flush=True)
    for line in sys.stdin:
        print(measures[line.strip()](seconds), flush=True)


class Checkout:
    """A process that measures one checkout."""

    def __init__(self, folder: Path, options: list[str]) -> None:
        self.folder = folder
        command = [sys.executable, str(Path(__file__).resolve()), str(folder), "--serve", *options]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(folder / "agents")])}
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=folder, env=environment
        )
        self._answer()

    def measure(self, name: str) -> float:
        """One rate, per second."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{name}\n")
        self.process.stdin.flush()
        return float(self._answer())

    def _answer(self) -> str:
        assert self.process.stdout is not None
        answer = self.process.stdout.readline()
        if not answer:
            raise SystemExit(f"{self.folder}: cannot be measured; its error is printed above")
        return answer


def main() -> int:
    """Measure, print the table; 1 if a median ratio is below the floor."""
    parser = argparse.ArgumentParser(description="Speed of this checkout relative to another one.")
    parser.add_argument("other", type=Path, help="folder of the other checkout")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=0.3, help="duration of one measurement")
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--cpu", action="store_true", help="per second of processor time, not of wall time")
    parser.add_argument("--floor", type=float, default=0.0, help="exit with 1 if a median ratio is lower")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        if options.cpu:
            time.perf_counter = time.process_time
        serve(options.other, options.seconds)
        return 0
    if not (options.other / "hydro_env").is_dir():
        parser.error(f"{options.other}: no checkout of this project, it has no folder hydro_env")
    passed = ["--seconds", str(options.seconds), *(["--cpu"] if options.cpu else [])]
    checkouts = [Checkout(folder, passed) for folder in (HERE, options.other.resolve())]
    measured: dict[str, list[tuple[float, float]]] = {name: [] for name in options.only}
    for number in range(options.rounds):
        for name, pairs in measured.items():
            own, other = checkouts
            if number % 2:
                second, first = other.measure(name), own.measure(name)
            else:
                first, second = own.measure(name), other.measure(name)
            pairs.append((first, second))
    print("| rate, 1/s | this checkout | other checkout | ratio, median | middle half | lowest–highest |")
    print("|---|---:|---:|---:|---|---|")
    lowest = float("inf")
    for name, pairs in measured.items():
        rate, other_rate = (statistics.median(values) for values in zip(*pairs, strict=True))
        ratios = [first / second for first, second in pairs]
        low, median, high = statistics.quantiles(ratios, n=4) if len(ratios) > 1 else ratios * 3
        print(
            f"| {name} | {rate:,.0f} | {other_rate:,.0f} | {median:.3f} | {low:.3f}–{high:.3f} "
            f"| {min(ratios):.3f}–{max(ratios):.3f} |"
        )
        lowest = min(lowest, median)
    print(f"{options.rounds} rounds, {'processor' if options.cpu else 'wall'} time, {os.cpu_count()} cores")
    return int(lowest < options.floor)


if __name__ == "__main__":
    sys.exit(main())
