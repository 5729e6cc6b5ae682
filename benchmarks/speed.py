"""Speed and start-up of the environment and of PPO, beside Gymnasium's own environments.

Run: python -m benchmarks.speed [--only kernel environment training start inference] [--output results/speed.csv]

The measurements of a group take turns, round by round; a ratio is the median of the ratios within a round. It takes a
quarter of an hour. Compare rows, not figures of another day.
"""

import itertools
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd

from benchmarks import command_line
from hydro_agents.evaluation.study import default_study
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_env, make_features, make_model
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.machine import machine_description, package_versions
from hydro_agents.running.text import markdown
from hydro_env import ENVIRONMENT_ID, ServoHydraulicVectorEnv
from hydro_env.files import write_text
from hydro_env.plant import kernel

ROOT = Path(__file__).resolve().parents[1]
ROUNDS, SECONDS = 5, 0.5  # SECONDS: of one measurement of a rate
SIZES = (1, 64, 1024, 4096, 16_384)  # plants or axes side by side
TRAINING_STEPS, CALLS = 500_000, 20_000  # CALLS: of a controller
FIRST_STEP = f"""
import gymnasium, hydro_env
env = gymnasium.make("{ENVIRONMENT_ID}")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


class Row(NamedTuple):
    """One figure: its name, what measures it once, its unit, and the row of the group beside which it stands."""

    name: str
    measure: Callable[[], float]
    unit: str
    beside: str = ""


def rate(work: Callable[[], int]) -> float:
    """Units of work per second. ``work`` returns the number of units that it did; its first call is not timed."""
    work()
    done, began = 0, time.perf_counter()
    while True:
        done += work()
        passed = time.perf_counter() - began
        if passed >= SECONDS:
            return done / passed


def kernel_rate(count: int, threads: int) -> float:
    """Control periods per second of plants drawn as in the environment: the integrator alone, a square wave of ±1 V."""
    env = ServoHydraulicVectorEnv(count, info=False, threads=1)
    env.reset(seed=0)
    config, voltage, periods = env.config, np.ones((count, 2)), itertools.count(1)
    durations = np.tile([config.command_latency, config.control_period - config.command_latency], (count, 1))
    peaks = np.zeros((count, kernel.N_PEAKS))
    plants = kernel.Plants(env.axes.state.copy(), env.axes.coefficient.copy(), voltage, durations, peaks)
    accuracy = kernel.Accuracy(float(config.maximum_step), float(config.tolerance))
    parts = list(itertools.pairwise([count * part // threads for part in range(threads + 1)]))
    with ThreadPoolExecutor(threads) as pool:

        def advance() -> int:
            list(pool.map(lambda part: kernel.integrate(plants, accuracy, *part), parts))
            if next(periods) % 20 == 0:
                np.negative(voltage, out=voltage)
            return count

        return rate(advance)


def kernel_rows() -> list[Row]:
    """The integrator alone, by plants and threads."""
    rows = []
    for count in SIZES:
        alone = f"plants: {count:,}"
        rows.append(Row(alone, partial(kernel_rate, count, 1), "plant periods/s"))
        if count >= 64:
            rows.append(Row(f"{alone}, 2 threads", partial(kernel_rate, count, 2), "plant periods/s", alone))
    return rows


def single_rate(make: Callable[[], gym.Env[Any, Any]]) -> float:
    """Steps per second of one environment under its zero action, resets included."""
    env = make()
    env.reset(seed=0)
    action = env.action_space.sample() * 0

    def work() -> int:
        for _ in range(500):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return 500

    result = rate(work)
    env.close()
    return result


def vector_rate(make: Callable[[], Any]) -> float:
    """Environment steps per second of a vector environment under small random actions, restarts included."""
    env = make()
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

    result = rate(work)
    env.close()
    return result


def single_axis() -> gym.Env[Any, Any]:
    """One axis through ``gym.make``, in a worker process too."""
    return gym.make(f"hydro_env:{ENVIRONMENT_ID}")


def environment_rows() -> list[Row]:
    """One axis and N axes beside Gymnasium's environments and its vectors of single axes."""
    own = "one axis"
    rows = [
        Row("Pendulum-v1", partial(single_rate, partial(gym.make, "Pendulum-v1")), "steps/s"),
        Row(own, partial(single_rate, single_axis), "steps/s", "Pendulum-v1"),
    ]
    for count in SIZES[1:]:
        peer = f"CartPole-v1, N = {count:,}"
        for name, environment, beside in ((peer, "CartPole-v1", ""), (f"axes, N = {count:,}", ENVIRONMENT_ID, peer)):
            make = partial(gym.make_vec, environment, num_envs=count)
            rows.append(Row(name, partial(vector_rate, make), "axis steps/s", beside))
    processes = partial(gym.vector.AsyncVectorEnv, [single_axis] * 16, context="spawn")
    rows.append(Row("AsyncVectorEnv of 16 single axes", partial(vector_rate, processes), "axis steps/s", own))
    return rows


def training_speed() -> float:
    """Steps per second of PPO as ``make study`` trains it."""
    study = default_study()
    trained = study.controllers[study.trained[0]]
    base: Any = study.make(trained.corrects or "")
    ppo = trained.settings
    assert isinstance(ppo, PPOSettings)
    model = make_model(make_env(study.task, ppo, make_features(study.task, ppo, base), 0), ppo, 0)
    model.learn(ppo.axes * ppo.steps_per_rollout)  # warm
    began = time.perf_counter()
    model.learn(TRAINING_STEPS)
    return float(model.num_timesteps / (time.perf_counter() - began))


def fresh_process(code: str, cached: bool = True) -> float:
    """Wall time in s of Python code in a new process, with the machine code of before or without any."""
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "agents")])}
    with tempfile.TemporaryDirectory() as empty:
        if not cached:
            variables["NUMBA_CACHE_DIR"] = empty
        began = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True, env=variables)
        return time.perf_counter() - began


def start_rows() -> list[Row]:
    """Import, and time to the first step with a filled and with an empty cache of machine code."""
    imported, warm = "import hydro_env", "first step, compiled before"
    return [
        Row("import gymnasium", partial(fresh_process, "import gymnasium"), "s"),
        Row(imported, partial(fresh_process, imported), "s", "import gymnasium"),
        Row(warm, partial(fresh_process, FIRST_STEP), "s", imported),
        Row("first step, empty cache", partial(fresh_process, FIRST_STEP, False), "s", warm),
    ]


def call_of_the_policy() -> float:
    """Median time from observation to command on one axis, ms."""
    env = single_axis()
    env.reset(seed=0)
    observations = [env.step(np.zeros(1, dtype=np.float32))[0] for _ in range(256)]
    env.close()
    policy, memory, times = PolicyController.load(pretrained_folder() / "policy"), None, []
    for number in range(CALLS):
        began = time.perf_counter()
        _, memory = policy.predict(observations[number % 256], memory)
        times.append(1e3 * (time.perf_counter() - began))
    return statistics.median(times)


GROUPS: dict[str, Callable[[], list[Row]]] = {
    "kernel": kernel_rows,
    "environment": environment_rows,
    "training": lambda: [Row("PPO of stable-baselines3", training_speed, "steps/s")],
    "start": start_rows,
    "inference": lambda: [Row("policy: median", call_of_the_policy, "ms")],
}


def measured(group: str, rows: Sequence[Row]) -> pd.DataFrame:
    """Measure the rows in turn, round by round: median, lowest, highest, and ratio to the row beside it."""
    values: dict[str, list[float]] = {row.name: [] for row in rows}
    for number in range(ROUNDS):
        for row in rows:
            print(f"{group}: round {number + 1} of {ROUNDS}, {row.name}", file=sys.stderr, flush=True)
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
    given = command_line(__doc__, only=GROUPS, output=Path("results/speed.csv"))
    print(f"{machine_description()}; {', '.join(map(' '.join, package_versions().items()))}\n")
    tables = []
    for name in given.only:
        tables.append(measured(name, GROUPS[name]()))
        write_text(given.output, pd.concat(tables).to_csv(index=False))
        shown = tables[-1].drop(columns="group")
        shown = shown.map(lambda value: f"{value:.4g}" if isinstance(value, float) else value)
        print(markdown(list(shown.columns), shown.values.tolist(), left=(0, 1, 5)), end="\n\n", flush=True)


if __name__ == "__main__":
    main()
