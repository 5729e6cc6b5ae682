"""Rows of memory, start-up and inference."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.benchmark.table import Case, Row, UnavailableError
from agents.benchmark.timing import Extent, fresh_process
from agents.leakage.head import LeakageHead, MonitoredController
from agents.learning.policy import PolicyController
from agents.running.folders import pretrained_folder
from hydro_env import ENVIRONMENT_ID, ServoHydraulicVectorEnv

_RESIDENT_CODE = """
import gymnasium, numpy as np, hydro_env
def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * __import__("resource").getpagesize()
def run(count):
    env = gymnasium.make_vec("{env_id}", num_envs=count, threads=1)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros((count, 1), dtype=np.float32))
    return env
small = run(8)
before = resident()
large = run({count})
print((resident() - before) / {count})
"""
_FIRST_STEP_CODE = """
import gymnasium, hydro_env
env = gymnasium.make("{env_id}")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


def array_bytes(env: ServoHydraulicVectorEnv) -> int:
    """Bytes of all NumPy arrays that a vector environment holds."""
    seen: dict[int, int] = {}

    def note(values: Iterable[Any]) -> None:
        for value in values:
            if isinstance(value, np.ndarray):
                seen[id(value)] = value.nbytes if value.base is None else 0
            elif isinstance(value, tuple):
                note(value)

    for owner in (env, env.axes, env.axes.options):
        note(vars(owner).values())
    return sum(seen.values())


def memory_cases(extent: Extent) -> list[Case]:
    """Memory of one axis."""
    count = extent.memory_axes

    def arrays(run: int) -> Sequence[float]:
        env = ServoHydraulicVectorEnv(count)
        env.reset(seed=0)
        size = array_bytes(env) / count
        env.close()
        return (size,)

    def resident(run: int) -> Sequence[float]:
        if not Path("/proc/self/statm").exists():
            raise UnavailableError("not measured: this system has no /proc")
        return (float(fresh_process(_RESIDENT_CODE.format(env_id=ENVIRONMENT_ID, count=count))[1]),)

    size = f"N = {count:,}"
    return [
        Case((Row("arrays of one axis", "bytes", note=size),), arrays, 1),
        Case(
            (Row("growth of resident memory per axis", "bytes", "arrays of one axis", f"{size}, fresh process"),),
            resident,
            extent.runs,
        ),
    ]


def start_cases(extent: Extent) -> list[Case]:
    """Import, and time to the first step with an empty and with a filled cache of machine code; fresh processes."""
    code = _FIRST_STEP_CODE.format(env_id=ENVIRONMENT_ID)

    def process(text: str) -> Callable[[int], Sequence[float]]:
        return lambda run: (fresh_process(text)[0],)

    folder = tempfile.TemporaryDirectory(prefix="hydro-benchmark-")

    def cold(run: int) -> Sequence[float]:
        with tempfile.TemporaryDirectory(prefix="hydro-benchmark-") as empty:
            return (fresh_process(code, {"NUMBA_CACHE_DIR": empty})[0],)

    def warm(run: int) -> Sequence[float]:
        if not os.listdir(folder.name):
            fresh_process(code, {"NUMBA_CACHE_DIR": folder.name})
        return (fresh_process(code, {"NUMBA_CACHE_DIR": folder.name})[0],)

    bare, gymnasium = "python, nothing imported", "import gymnasium"
    return [
        Case((Row(bare, "s"),), process("pass"), extent.runs),
        Case((Row(gymnasium, "s", bare),), process("import gymnasium"), extent.runs),
        Case((Row("import hydro_env", "s", gymnasium),), process("import hydro_env"), extent.runs),
        Case((_import_row(),), lambda run: (import_time("hydro_env"),), extent.runs),
        Case(
            (Row("first step, warm cache", "s", "import hydro_env", "import, gym.make, reset, step"),),
            warm,
            extent.runs,
        ),
        Case(
            (Row("first step, cold cache", "s", "first step, warm cache", "everything compiled anew"),),
            cold,
            min(3, extent.runs),
        ),
    ]


def _import_row() -> Row:
    return Row("import hydro_env, by -X importtime", "s", note="what it imports included, interpreter start not")


def import_time(module: str) -> float:
    """Seconds that the import of a module takes, what it imports included, by ``python -X importtime``."""
    code = [sys.executable, "-X", "importtime", "-c", f"import {module}"]
    root = str(Path(__file__).resolve().parents[2])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}
    text = subprocess.run(code, capture_output=True, text=True, check=True, env=environment).stderr
    line = next(line for line in text.splitlines() if line.rsplit("|", 1)[-1].strip() == module)
    return 1e-6 * int(line.split("|")[1])


def inference_cases(extent: Extent) -> list[Case]:
    """Time from observation to command, and of the leakage head, on one axis, against the control period."""
    policy = PolicyController.load(pretrained_folder() / "policy")
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    monitored = MonitoredController(policy, head)
    env = gym.make(ENVIRONMENT_ID)
    env.reset(seed=0)
    observations = [env.step(np.zeros(1, dtype=np.float32))[0] for _ in range(256)]
    period = 1e3 * policy.features.layout.control_period
    env.close()

    def act() -> Callable[[int], Any]:
        memory: list[Any] = [None]

        def call(number: int) -> None:
            _, memory[0] = policy.predict(observations[number % 256], memory[0])

        return call

    def watch() -> Callable[[int], Any]:
        memory: list[Any] = [None]
        for number in range(head.settings.window):
            _, memory[0] = monitored.predict(observations[number % 256], memory[0])

        def call(number: int) -> None:
            _, memory[0] = monitored.predict(observations[number % 256], memory[0])
            monitored.estimate(memory[0])

        return call

    return [
        _inference_case("policy", act, extent.calls, period, extent.runs),
        _inference_case("policy and leakage head", watch, extent.calls // 10, period, extent.runs),
    ]


def _inference_case(
    name: str, prepare: Callable[[], Callable[[int], Any]], calls: int, period: float, runs: int
) -> Case:
    def measure(run: int) -> Sequence[float]:
        call = prepare()
        for number in range(50):
            call(number)
        times = []
        for number in range(calls):
            began = time.perf_counter()
            call(number)
            times.append(1e3 * (time.perf_counter() - began))
        median, late = statistics.median(times), float(np.quantile(times, 0.999))
        return median, late, 100.0 * late / period

    note = f"{calls:,} calls, one axis, at every control period"
    rows = (
        Row(f"{name}: median", "ms", note=note),
        Row(f"{name}: 99.9th percentile", "ms"),
        Row(f"{name}: 99.9th percentile", f"% of {period:g} ms"),
    )
    return Case(rows, measure, runs)
