"""Rows of memory, start-up and inference."""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.table import Case, Extent, Row, fresh_process, one_row
from hydro_agents.detection.head import LeakageHead
from hydro_agents.learning.policy import PolicyController
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ENVIRONMENT_ID, ServoHydraulicVectorEnv

MEMORY_AXES = 65_536
_FIRST_STEP_CODE = f"""
import gymnasium, hydro_env
env = gymnasium.make("{ENVIRONMENT_ID}")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


def array_bytes(env: ServoHydraulicVectorEnv) -> int:
    """Bytes of all NumPy arrays that a vector environment holds, views not counted."""
    values = [value for owner in (env, env.axes, env.axes.options) for value in vars(owner).values()]
    values += [part for value in values if isinstance(value, tuple) for part in value]
    sizes = {id(array): array.nbytes for array in values if isinstance(array, np.ndarray) and array.base is None}
    return sum(sizes.values())


def memory_cases(extent: Extent, count: int = MEMORY_AXES) -> list[Case]:
    """Memory per axis of a vector environment with ``count`` axes."""

    def arrays() -> float:
        env = ServoHydraulicVectorEnv(count)
        env.reset(seed=0)
        env.close()
        return array_bytes(env) / count

    return [one_row("arrays of one axis", "bytes", arrays, 1, note=f"N = {count:,}")]


def start_cases(extent: Extent) -> list[Case]:
    """Import, and time to the first step with an empty and with a filled cache of machine code; fresh processes."""
    folder = tempfile.TemporaryDirectory(prefix="hydro-benchmark-")

    def process(name: str, code: str, against: str = "") -> Case:
        return one_row(name, "s", lambda: fresh_process(code)[0], extent.runs, against)

    def first_step(cache: str) -> float:
        return fresh_process(_FIRST_STEP_CODE, {"NUMBA_CACHE_DIR": cache})[0]

    def cold() -> float:
        with tempfile.TemporaryDirectory(prefix="hydro-benchmark-") as empty:
            return first_step(empty)

    def warm() -> float:
        if not os.listdir(folder.name):
            first_step(folder.name)
        return first_step(folder.name)

    own, filled = "import hydro_env", "first step, warm cache"
    return [
        process("python, nothing imported", "pass"),
        process("import gymnasium", "import gymnasium", "python, nothing imported"),
        process(own, own, "import gymnasium"),
        one_row(filled, "s", warm, extent.runs, own, "import, gym.make, reset, step"),
        one_row("first step, cold cache", "s", cold, min(3, extent.runs), filled, "everything compiled again"),
    ]


def inference_cases(extent: Extent) -> list[Case]:
    """Time from observation to command on one axis, with and without the leakage head."""
    policy = PolicyController.load(pretrained_folder() / "policy")
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    head.interval = 1  # a new estimate at every control period
    env = gym.make(ENVIRONMENT_ID)
    env.reset(seed=0)
    observations = [env.step(np.zeros(1, dtype=np.float32))[0] for _ in range(256)]
    period = 1e3 * policy.features.layout.control_period
    env.close()

    class Watched:
        """The policy, with the head beside it."""

        def predict(self, observation: Any, memory: Any) -> tuple[Any, Any]:
            acting, watching = memory or (None, None)
            command, acting = policy.predict(observation, acting)
            _, watching = head.predict(observation, watching)
            return command, (acting, watching)

    def case(name: str, controller: Any, calls: int) -> Case:
        def measure(run: int) -> Sequence[float]:
            memory, times = None, []
            for number in range(head.settings.window + calls):  # the head's window fills first
                began = time.perf_counter()
                _, memory = controller.predict(observations[number % 256], memory)
                if number >= head.settings.window:
                    times.append(1e3 * (time.perf_counter() - began))
            late = float(np.quantile(times, 0.999))
            return statistics.median(times), late, 100.0 * late / period

        note = f"{calls:,} calls, one axis, at every control period"
        late = f"{name}: 99.9th percentile"
        rows = Row(f"{name}: median", "ms", note=note), Row(late, "ms"), Row(late, f"% of {period:g} ms")
        return Case(rows, measure, extent.runs)

    return [
        case("policy", policy, extent.calls),
        case("policy and leakage head", Watched(), extent.calls // 10),
    ]
