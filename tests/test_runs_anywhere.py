"""It runs where the fast path cannot: no folder for the cache, an older processor, other processes, no compiler."""

import functools
import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

import hydro_env
from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv

ROOT = Path(__file__).parents[1]
STEPS = 40
EPISODE = f"""
import json, sys, warnings
warnings.simplefilter("ignore", RuntimeWarning)  # uncompiled unsigned numbers wrap around, as they must
import gymnasium as gym
import hydro_env
env = gym.make("hydro_env:ServoHydraulic-v0", **json.loads(sys.argv[1]))
rows = [env.reset(seed=5)[0].tolist()]
for number in range({STEPS}):
    rows.append(env.step([0.8 if number % 10 < 5 else -0.4])[0].tolist())
from hydro_env.task import kernel
stats = getattr(kernel.step_axes.dispatcher, "stats", None)
print(json.dumps({{"rows": rows, "kept": bool(stats and stats.cache_path), "module": hydro_env.__file__}}))
"""


EXACT = {"sensors": {"enabled": False}}
"""Without 16-bit steps, which would make a whole step of a difference in the last digit."""


def episode_here(**task):
    env = gym.make("ServoHydraulic-v0", **task)
    rows = [env.reset(seed=5)[0].tolist()]
    for number in range(STEPS):
        rows.append(env.step([0.8 if number % 10 < 5 else -0.4])[0].tolist())
    return np.array(rows)


def episode_elsewhere(folder=ROOT, task=None, **variables):
    """The same episode in a fresh process with other environment variables, from the package in ``folder``."""
    answer = subprocess.run(
        [sys.executable, "-c", EPISODE, json.dumps(task or {})],
        env={**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", **variables},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    found = json.loads(answer.stdout)
    assert Path(found["module"]).parents[1] == Path(folder)
    return np.array(found["rows"]), found["kept"]


def test_without_any_folder_for_the_cache(tmp_path):
    """A file where each folder would have to be: that denies root as well, whom permissions would not."""
    shutil.copytree(ROOT / "hydro_env", tmp_path / "hydro_env", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in (tmp_path / "hydro_env").rglob("*.py"):
        (folder.parent / "__pycache__").touch()
    (tmp_path / "file").touch()
    nowhere = str(tmp_path / "file" / "folder")
    variables = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "IPYTHONDIR"), nowhere)
    rows, kept = episode_elsewhere(tmp_path, **variables)
    assert not kept
    np.testing.assert_array_equal(rows, episode_here())


def test_on_a_processor_without_wide_registers(tmp_path):
    """No instruction beyond SSE4.2: the same within rounding.

    Not the same bits: a processor that multiplies and adds in one instruction rounds once where another rounds twice.
    What holds on one processor, bit for bit, whatever the number of axes, their order and threads, is tested below.
    """
    older = {"NUMBA_CPU_NAME": "x86-64-v2", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)}
    rows, kept = episode_elsewhere(task=EXACT, **older)
    assert kept
    np.testing.assert_allclose(rows, episode_here(**EXACT), rtol=0, atol=1e-6)


def test_without_compiling():
    rows, _ = episode_elsewhere(task=EXACT, NUMBA_DISABLE_JIT="1")
    np.testing.assert_allclose(rows, episode_here(**EXACT), rtol=0, atol=1e-6)


COMMANDS = np.random.default_rng(3).uniform(-1, 1, (30, 2, 1)).astype(np.float32)
MAKE = functools.partial(gym.make, "hydro_env:ServoHydraulic-v0", episode_duration=0.1)


def gymnasium_numbers(envs):
    numbers = [envs.reset(seed=11)[0]]
    for action in COMMANDS:
        observation, reward, terminated, truncated, _ = envs.step(action)
        numbers += [observation.copy(), reward, terminated, truncated]
    envs.close()
    return numbers


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_processes_of_gymnasium(context):
    alone = gymnasium_numbers(SyncVectorEnv([MAKE] * 2))
    for mine, other in zip(alone, gymnasium_numbers(AsyncVectorEnv([MAKE] * 2, context=context)), strict=True):
        np.testing.assert_array_equal(mine, other)


def sb3_numbers(envs):
    envs.seed(11)
    numbers = [envs.reset()]
    for action in COMMANDS:
        envs.step_async(action)
        observation, reward, done, _ = envs.step_wait()
        numbers += [observation.copy(), np.float32(reward), done.copy()]  # only one of the two rounds rewards
    envs.close()
    return numbers


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes_of_stable_baselines3(method):
    alone = sb3_numbers(DummyVecEnv([MAKE] * 2))
    for mine, other in zip(alone, sb3_numbers(SubprocVecEnv([MAKE] * 2, start_method=method)), strict=True):
        np.testing.assert_array_equal(mine, other)


def test_in_a_thread():
    found = []
    thread = threading.Thread(target=lambda: found.append(episode_here()))
    thread.start()
    thread.join()
    np.testing.assert_array_equal(found[0], episode_here())


def test_two_environments_by_turns():
    def run(envs):
        rows = [[env.reset(seed=20 + number)[0]] for number, env in enumerate(envs)]
        for action in COMMANDS[:, 0]:
            for env, own in zip(envs, rows, strict=True):
                own.append(env.step(action)[0])
        return np.array(rows)

    by_turns = run([ServoHydraulicEnv(), ServoHydraulicEnv(control_period=0.002)])
    np.testing.assert_array_equal(by_turns[0], run([ServoHydraulicEnv()])[0])
    other = ServoHydraulicEnv(control_period=0.002)
    rows = [other.reset(seed=21)[0], *(other.step(action)[0] for action in COMMANDS[:, 0])]
    np.testing.assert_array_equal(by_turns[1], rows)


@pytest.fixture(scope="module")
def many():
    """1000 axes through 12 steps and one restart, with one thread: observations, rewards, commands."""
    rng = np.random.default_rng(4)
    commands = rng.uniform(-1, 1, (12, 1000, 1)).astype(np.float32)
    return commands, vector_numbers(commands, 1)


def vector_numbers(commands, threads):
    envs = ServoHydraulicVectorEnv(commands.shape[1], threads=threads, episode_duration=0.04)
    observations, rewards = [envs.reset(seed=9)[0]], []
    for action in commands:
        observation, reward, *_ = envs.step(action)
        observations.append(observation)
        rewards.append(reward)
    threaded = envs.axes._pool is not None
    envs.close()
    return np.array(observations), np.array(rewards), threaded


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("count", [1, 7, 8, 9, 64, 1000])
def test_bit_for_bit_whatever_the_number_of_axes_blocks_and_threads(many, count, threads):
    commands, (observations, rewards, _) = many
    mine = vector_numbers(commands[:, :count], threads)
    assert mine[2] == (threads == 2 and count == 1000)
    np.testing.assert_array_equal(mine[0], observations[:, :count])
    np.testing.assert_array_equal(mine[1], rewards[:, :count])


def test_nothing_heavy_is_loaded_before_it_is_needed():
    code = (
        "import sys, pickle, gymnasium as gym, hydro_env;"
        "assert gym.spec('ServoHydraulic-v0').entry_point == 'hydro_env.env:ServoHydraulicEnv';"
        "heavy = {'numba', 'llvmlite', 'scipy', 'pydantic', 'yaml', 'torch', 'matplotlib', 'pygame', 'hydro_agents'};"
        "found = heavy & set(sys.modules); assert not found, found;"
        "assert set(hydro_env.__all__) <= set(dir(hydro_env));"
        "from hydro_env import PlantParameters, TaskConfig, LEAKAGE_CLASSES;"
        "found = (heavy - {'pydantic', 'yaml'}) & set(sys.modules); assert not found, found;"
        "assert pickle.loads(pickle.dumps(TaskConfig())) == TaskConfig();"
        "env = gym.make('ServoHydraulic-v0'); env.reset(seed=0); env.step([0.0]);"
        "assert 'scipy.integrate' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_every_public_name_can_be_had():
    for name in hydro_env.__all__:
        assert getattr(hydro_env, name) is not None
    with pytest.raises(AttributeError, match="'hydro_env' has no attribute 'nothing'"):
        _ = hydro_env.nothing
