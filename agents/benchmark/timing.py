"""How things are timed: a rate over a given time, a fresh process, and how much is measured in all."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""The folder from which ``hydro_env`` and ``agents`` are imported, for fresh processes."""


@dataclass(frozen=True)
class Extent:
    """How much is measured."""

    runs: int = 5
    seconds: float = 0.5  # that one rate is measured for
    kernel_sizes: tuple[int, ...] = (1, 8, 64, 512, 4096, 65_536)
    vector_sizes: tuple[int, ...] = (16, 64, 256, 1024, 4096, 16_384)
    cost_sizes: tuple[int, ...] = (256, 1024, 4096, 16_384, 65_536)
    solver_periods: int = 40
    accuracy_rigs: int = 240
    training_steps: int = 1_000_000
    single_training_steps: int = 65_536
    training_runs: int = 3
    seeds: int = 5
    plants: int = 4  # per leak level and kind of reference, for the comparison with the PID
    memory_axes: int = 65_536
    calls: int = 20_000


FULL = Extent()
QUICK = Extent(
    runs=3,
    seconds=0.1,
    kernel_sizes=(1, 64, 4096),
    vector_sizes=(16, 1024),
    cost_sizes=(256, 4096),
    solver_periods=8,
    accuracy_rigs=40,
    training_steps=131_072,
    single_training_steps=4096,
    training_runs=2,
    seeds=2,
    plants=2,
    memory_axes=8192,
    calls=2000,
)


def rate(work: Callable[[], int], seconds: float) -> float:
    """Units of work per second: ``work`` does some and says how many; called once before, untimed."""
    work()
    done, began = 0, time.perf_counter()
    while True:
        done += work()
        passed = time.perf_counter() - began
        if passed >= seconds:
            return done / passed


def fresh_process(code: str, environment: Mapping[str, str] | None = None) -> tuple[float, str]:
    """Run Python code in a process of its own; returns wall time (s) and what it printed.

    Raises:
        RuntimeError: it failed; the message is its last line.
    """
    path = os.pathsep.join(part for part in (str(ROOT), os.environ.get("PYTHONPATH", "")) if part)
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": path, **(environment or {})},
    )
    seconds = time.perf_counter() - began
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["the process failed"])[-1])
    return seconds, done.stdout
