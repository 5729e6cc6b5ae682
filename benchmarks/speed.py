"""Speed and start-up of the environment and of PPO, beside Gymnasium's own environments.

Run: python -m benchmarks.speed [--only GROUP ...] [--quick] [--output results/speed.csv]

The measurements of a group take turns, round by round; a ratio is the median of the ratios within a round. It takes a
quarter of an hour, a minute with ``--quick``. Compare rows, not figures of another day.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from benchmarks import command_line
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_env, make_features, make_model
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.machine import machine_description, package_versions
from hydro_agents.running.text import markdown
from hydro_agents.study.settings import default_study
from hydro_env import ENVIRONMENT_ID, ServoHydraulicVectorEnv
from hydro_env.files import write_text
from hydro_env.plant import kernel

ROOT = Path(__file__).resolve().parents[1]


class Extent(NamedTuple):
    """Extent of the measurement."""

    rounds: int
    seconds: float  # of one measurement of a rate
    sizes: Sequence[int]  # plants or axes side by side
    training_steps: int
    calls: int  # of a controller


FULL = Extent(5, 0.5, (1, 64, 1024, 4096, 16_384), 500_000, 20_000)
QUICK = Extent(3, 0.1, (1, 1024), 65_536, 2000)


class Row(NamedTuple):
    """One figure: its name, what measures it once, its unit, and the row of the group beside which it stands."""

    name: str
    measure: Callable[[], float]
    unit: str
    beside: str = ""


def rate(work: Callable[[], int], seconds: float) -> float:
    """Units of work per second. ``work`` returns the number of units that it did; its first call is not timed."""
    work()
    done, began = 0, time.perf_counter()
    while True:
        done += work()
        passed = time.perf_counter() - began
        if passed >= seconds:
            return done / passed


# The integrator -------------------------------------------------------------------------------------------------------
class BareKernel:
    """N plants drawn as in the environment, advanced by the integrator alone under a square wave of ±1 V."""

    def __init__(self, count: int, threads: int) -> None:
        env = ServoHydraulicVectorEnv(count, info=False, threads=1)
        env.reset(seed=0)
        config = env.config
        self.state = env.axes.state.copy()
        self._voltage = np.ones((count, 2))
        durations = np.tile([config.command_latency, config.control_period - config.command_latency], (count, 1))
        peaks = np.zeros((count, kernel.N_PEAKS))
        self._plants = kernel.Plants(self.state, env.axes.coefficient.copy(), self._voltage, durations, peaks)
        self._accuracy = kernel.Accuracy(float(config.maximum_step), float(config.tolerance))
        self._parts = list(pairwise([count * part // threads for part in range(threads + 1)]))
        self._pool = ThreadPoolExecutor(threads)
        self._periods = 0

    def advance(self) -> int:
        """One control period of all plants; returns the number of plants."""
        list(self._pool.map(self._integrate, self._parts))
        self._periods += 1
        if self._periods % 20 == 0:
            self._voltage *= -1.0
        return len(self.state)

    def _integrate(self, part: tuple[int, int]) -> None:
        kernel.integrate(self._plants, self._accuracy, *part)

    def close(self) -> None:
        """Stop the worker threads."""
        self._pool.shutdown()


def kernel_rows(extent: Extent) -> list[Row]:
    """The integrator alone, by plants and threads."""

    def measure(count: int, threads: int) -> float:
        bare = BareKernel(count, threads)
        found = rate(bare.advance, extent.seconds)
        bare.close()
        return found

    rows = []
    for count in extent.sizes:
        alone = f"plants: {count:,}"
        rows.append(Row(alone, partial(measure, count, 1), "plant periods/s"))
        if count >= 64:
            rows.append(Row(f"{alone}, 2 threads", partial(measure, count, 2), "plant periods/s", alone))
    return rows


# Environments ---------------------------------------------------------------------------------------------------------
def single_rate(env: gym.Env[Any, Any], seconds: float, steps: int = 500) -> float:
    """Steps per second of one environment under its zero action, resets included."""
    env.reset(seed=0)
    action = env.action_space.sample() * 0

    def work() -> int:
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps

    result = rate(work, seconds)
    env.close()
    return result


def vector_rate(env: Any, seconds: float) -> float:
    """Environment steps per second of a vector environment under small random actions, restarts included."""
    count: int = env.num_envs
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = env.action_space.sample()
    if actions.dtype.kind == "f":
        actions = (0.1 * actions).astype(np.float32)
    batch: int = max(1, 1024 // count)

    def work() -> int:
        for _ in range(batch):
            env.step(actions)
        return batch * count

    result = rate(work, seconds)
    env.close()
    return result


def single_axis() -> gym.Env[Any, Any]:
    """One axis through ``gym.make``, in a worker process too."""
    return gym.make(f"hydro_env:{ENVIRONMENT_ID}")


def environment_rows(extent: Extent) -> list[Row]:
    """One axis and N axes beside Gymnasium's environments and its vectors of single axes."""

    def single(make: Callable[[], gym.Env[Any, Any]]) -> float:
        return single_rate(make(), extent.seconds)

    def many(make: Callable[[], Any]) -> float:
        return vector_rate(make(), extent.seconds)

    own = "one axis"
    rows = [
        Row("Pendulum-v1", partial(single, partial(gym.make, "Pendulum-v1")), "steps/s"),
        Row(own, partial(single, single_axis), "steps/s", "Pendulum-v1"),
    ]
    for count in extent.sizes[1:]:
        peer = f"CartPole-v1, N = {count:,}"
        for name, environment, beside in ((peer, "CartPole-v1", ""), (f"axes, N = {count:,}", ENVIRONMENT_ID, peer)):
            make = partial(gym.make_vec, environment, num_envs=count)
            rows.append(Row(name, partial(many, make), "axis steps/s", beside))
    processes = partial(gym.vector.AsyncVectorEnv, [single_axis] * 16, context="spawn")
    rows.append(Row("AsyncVectorEnv of 16 single axes", partial(many, processes), "axis steps/s", own))
    return rows


# Training, start, inference -------------------------------------------------------------------------------------------
def native_model() -> tuple[OnPolicyAlgorithm, PPOSettings]:
    """PPO as ``make study`` trains it, and its settings."""
    study = default_study()
    name = study.trained[0]
    base: Any = study.make(study.controllers[name].corrects or "")
    ppo = study.controllers[name].settings
    assert isinstance(ppo, PPOSettings)
    return make_model(make_env(study.task, ppo, make_features(study.task, ppo, base), 0), ppo, 0), ppo


def training_rows(extent: Extent) -> list[Row]:
    """Speed of PPO."""

    def measure() -> float:
        model, ppo = native_model()
        model.learn(ppo.axes * ppo.steps_per_rollout)  # warm
        began = time.perf_counter()
        model.learn(extent.training_steps)
        return model.num_timesteps / (time.perf_counter() - began)

    return [Row("PPO of stable-baselines3", measure, "steps/s")]


FIRST_STEP = f"""
import gymnasium, hydro_env
env = gymnasium.make("{ENVIRONMENT_ID}")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


def fresh_process(code: str, cache: str | None = None) -> float:
    """Wall time in s of Python code in a new process; ``cache`` is the folder of the machine code.

    Raises:
        subprocess.CalledProcessError: the code failed.
    """
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "agents")])}
    if cache is not None:
        variables["NUMBA_CACHE_DIR"] = cache
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, env=variables)
    return time.perf_counter() - began


def start_rows(extent: Extent) -> list[Row]:
    """Import, and time to the first step with a filled and with an empty cache of machine code."""

    def cold() -> float:
        with tempfile.TemporaryDirectory() as empty:
            return fresh_process(FIRST_STEP, empty)

    imported, warm = "import hydro_env", "first step, compiled before"
    return [
        Row("import gymnasium", partial(fresh_process, "import gymnasium"), "s"),
        Row(imported, partial(fresh_process, imported), "s", "import gymnasium"),
        Row(warm, partial(fresh_process, FIRST_STEP), "s", imported),
        Row("first step, empty cache", cold, "s", warm),
    ]


def inference_rows(extent: Extent) -> list[Row]:
    """Time from observation to command on one axis."""
    env = gym.make(ENVIRONMENT_ID)
    env.reset(seed=0)
    observations = [env.step(np.zeros(1, dtype=np.float32))[0] for _ in range(256)]
    env.close()
    policy = PolicyController.load(pretrained_folder() / "policy")

    def measure() -> float:
        memory, times = None, []
        for number in range(extent.calls):
            began = time.perf_counter()
            _, memory = policy.predict(observations[number % 256], memory)
            times.append(1e3 * (time.perf_counter() - began))
        return statistics.median(times)

    return [Row("policy: median", measure, "ms")]


GROUPS: dict[str, Callable[[Extent], list[Row]]] = {
    "kernel": kernel_rows,
    "environment": environment_rows,
    "training": training_rows,
    "start": start_rows,
    "inference": inference_rows,
}


def measured(group: str, rows: Sequence[Row], rounds: int) -> pd.DataFrame:
    """Measure the rows in turn, round by round: median, lowest, highest, and ratio to the row beside it."""
    values: dict[str, list[float]] = {row.name: [] for row in rows}
    for number in range(rounds):
        for row in rows:
            print(f"{group}: round {number + 1} of {rounds}, {row.name}", file=sys.stderr, flush=True)
            values[row.name].append(row.measure())
    table = []
    for row in rows:
        own = values[row.name]
        line = {"group": group, "row": row.name, "unit": row.unit, "median": statistics.median(own)}
        line |= {"lowest": min(own), "highest": max(own), "beside": row.beside, "ratio": np.nan}
        if row.beside:
            line["ratio"] = statistics.median(np.divide(own, values[row.beside]))
        table.append(line)
    return pd.DataFrame(table)


def main() -> None:
    """Measure the groups, keep the table after each, and print it."""
    given = command_line(__doc__, only=GROUPS, quick=False, output=Path("results/speed.csv"))
    extent = QUICK if given.quick else FULL
    print(f"{machine_description()}; {', '.join(map(' '.join, package_versions().items()))}\n")
    tables = []
    for name in given.only:
        tables.append(measured(name, GROUPS[name](extent), extent.rounds))
        table = pd.concat(tables)
        write_text(given.output, table.to_csv(index=False))
        shown = (
            tables[-1].drop(columns="group").map(lambda value: f"{value:.4g}" if isinstance(value, float) else value)
        )
        print(markdown(list(shown.columns), shown.values.tolist(), left=(0, 1, 5)), end="\n\n", flush=True)


if __name__ == "__main__":
    main()
