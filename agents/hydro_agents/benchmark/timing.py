"""Measures times: rates, fresh processes, function calls; and defines the extent of the benchmark."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).resolve().parents[3]
"""The folder from which ``hydro_env`` and ``hydro_agents`` are imported, for fresh processes."""


@dataclass(frozen=True)
class Extent:
    """Extent of the benchmark."""

    runs: int
    seconds: float  # duration of one measurement of a rate
    kernel_sizes: Sequence[int]
    vector_sizes: Sequence[int]
    cost_sizes: Sequence[int]
    solver_periods: int
    accuracy_rigs: int
    training_steps: int
    calls: int


FULL = Extent(
    runs=5,
    seconds=0.5,
    kernel_sizes=(1, 8, 64, 512, 4096, 65_536),
    vector_sizes=(16, 64, 256, 1024, 4096, 16_384),
    cost_sizes=(256, 1024, 4096, 16_384, 65_536),
    solver_periods=40,
    accuracy_rigs=240,
    training_steps=1_000_000,
    calls=20_000,
)
QUICK = Extent(3, 0.1, (1, 64, 4096), (16, 1024), (256, 4096), 8, 40, 131_072, 2000)


def rate(work: Callable[[], int], seconds: float) -> float:
    """Units of work per second. ``work`` returns the number of units that it did; its first call is not timed."""
    work()
    done, began = 0, time.perf_counter()
    while True:
        done += work()
        passed = time.perf_counter() - began
        if passed >= seconds:
            return done / passed


def fresh_process(code: str, environment: Mapping[str, str] | None = None, *options: str) -> tuple[float, str, str]:
    """Run Python code in a new process; returns wall time (s), standard output and standard error.

    Raises:
        RuntimeError: the code failed; the message is the last line of its output.
    """
    path = os.pathsep.join([str(ROOT), str(ROOT / "agents"), *filter(None, [os.environ.get("PYTHONPATH")])])
    variables = {**os.environ, "PYTHONPATH": path, **(environment or {})}
    began = time.perf_counter()
    done = subprocess.run([sys.executable, *options, "-c", code], capture_output=True, text=True, env=variables)
    seconds = time.perf_counter() - began
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["the process failed"])[-1])
    return seconds, done.stdout, done.stderr


@contextmanager
def time_in(*functions: tuple[Any, str, str]) -> Iterator[Mapping[str, float]]:
    """Seconds spent in functions (owner, attribute, name), by name; a nested call counts in both functions."""
    seconds: defaultdict[str, float] = defaultdict(float)

    def timed(plain: Callable[..., Any], name: str) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            began = time.perf_counter()
            try:
                return plain(*args, **kwargs)
            finally:
                seconds[name] += time.perf_counter() - began

        return call

    with ExitStack() as stack:
        for owner, attribute, name in functions:
            stack.enter_context(mock.patch.object(owner, attribute, timed(getattr(owner, attribute), name)))
        yield seconds
