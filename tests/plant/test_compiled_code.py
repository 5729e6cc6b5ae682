"""Compiled code: neighbours, threads and compilation leave a plant's numbers alone; the cache notices changes."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import hydro_env
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, equilibrium, simulate
from hydro_env.axes import Axes
from hydro_env.plant import compiler, kernel
from hydro_env.plant.analysis import fastest_rate_bound
from hydro_env.task import kernel as task_kernel
from hydro_env.task.configuration import task_config

STATE_AT_REST = np.array(list(equilibrium(PlantParameters())[0].values()))


def drawn_plants(count, seed=0):
    """Axes with ``count`` randomised plants at rest; the friction of some asks for shorter inner steps."""
    stiffness = {"friction.transition_velocity": {"log_uniform": [5e-5, 2e-3]}}
    axes = Axes(task_config(None, randomisation=task_config(None).model_dump()["randomisation"] | stiffness), count)
    for axis in range(count):
        axes.seed(axis, np.random.default_rng([seed, axis]))
    axes.begin(np.arange(count), np.empty((count, len(axes.observation_names)), np.float32))
    return axes


def test_a_plant_among_others_moves_exactly_as_it_does_alone():
    count, intervals, periods = 19, 2, 30
    axes = drawn_plants(count)
    rng = np.random.default_rng(1)
    durations = np.array([1e-3, 4e-3])
    inputs = 10.0 * rng.uniform(-1, 1, (periods, axes.blocks, intervals, kernel.LANES))
    rates = [fastest_rate_bound(axes.parameters(axis), STATE_AT_REST) for axis in range(count)]
    assert len({np.ceil(4e-3 * max(rate / kernel.STEP_LIMIT, 1 / 0.25e-3)) for rate in rates}) > 5
    together = axes.state.copy()
    peaks = np.empty((axes.blocks, kernel.N_PEAKS, kernel.LANES))
    for voltage in inputs:
        kernel.integrate(together, axes.coefficient, voltage, durations, 0.25e-3, peaks, 0, axes.blocks)
    assert np.abs(together[:, 0] - axes.state[:, 0]).max() > 1e-3  # they did move
    for axis in range(count):
        block, lane = divmod(axis, kernel.LANES)
        # Alone: in the first lane of a block, the others filled with plants of another stiffness.
        state = np.repeat(axes.state[0:1, :, 3:4], kernel.LANES, axis=2)
        coefficient = np.repeat(axes.coefficient[0:1, :, 3:4], kernel.LANES, axis=2)
        state[0, :, 0] = axes.state[block, :, lane]
        coefficient[0, :, 0] = axes.coefficient[block, :, lane]
        own_peaks = np.empty((1, kernel.N_PEAKS, kernel.LANES))
        for voltage in inputs:
            held = np.zeros((1, intervals, kernel.LANES))
            held[0, :, 0] = voltage[block, :, lane]
            kernel.integrate(state, coefficient, held, durations, 0.25e-3, own_peaks, 0, 1)
        np.testing.assert_array_equal(state[0, :, 0], together[block, :, lane])
        np.testing.assert_array_equal(own_peaks[0, :, 0], peaks[block, :, lane])


def test_only_the_given_blocks_move():
    axes = drawn_plants(24)
    state = axes.state.copy()
    peaks = np.zeros((3, kernel.N_PEAKS, kernel.LANES))
    voltage = np.full((3, 1, kernel.LANES), 5.0)
    kernel.integrate(state, axes.coefficient, voltage, np.array([5e-3]), 0.25e-3, peaks, 1, 2)
    np.testing.assert_array_equal(state[[0, 2]], axes.state[[0, 2]])
    assert (state[1, 0] != axes.state[1, 0]).all()


def test_threads_do_not_change_a_number():
    count, steps = 200, 60
    rng = np.random.default_rng(2)
    actions = rng.uniform(-1, 1, (steps, count, 1)).astype(np.float32)
    runs = []
    for threads in (1, 2, 3):
        envs = ServoHydraulicVectorEnv(count, threads=threads, episode_duration=0.2)
        rows = [envs.reset(seed=3)[0]]
        rewards = []
        for action in actions:
            observation, reward, *_ = envs.step(action)
            rows.append(observation)
            rewards.append(reward)
        assert (envs.axes._pool is not None) == (threads > 1)
        envs.close()
        runs.append((np.array(rows), np.array(rewards)))
    for observations, rewards in runs[1:]:
        np.testing.assert_array_equal(observations, runs[0][0])
        np.testing.assert_array_equal(rewards, runs[0][1])


SCRIPT = """
import json, sys, warnings
warnings.simplefilter("ignore", RuntimeWarning)  # unsigned numbers wrap around, as they must
import numpy as np
from hydro_env import PlantParameters, ServoHydraulicEnv, simulate
run = simulate(PlantParameters(), np.repeat([4.0, -3.0, 10.0], 5), 5e-3)
env = ServoHydraulicEnv()
rows = [env.reset(seed=5)[0].tolist()]
for number in range(6):
    rows.append(env.step(np.array([0.3 - 0.1 * number]))[0].tolist())
json.dump({"states": run.states.tolist(), "observations": rows}, sys.stdout)
"""


def test_the_same_source_uncompiled_gives_the_same_numbers():
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    answer = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True, timeout=120
    )
    uncompiled = json.loads(answer.stdout)
    run = simulate(PlantParameters(), np.repeat([4.0, -3.0, 10.0], 5), 5e-3)
    size = np.abs(run.states).max(axis=0)
    assert np.abs((np.array(uncompiled["states"]) - run.states) / size).max() < 1e-9
    env = hydro_env.ServoHydraulicEnv()
    rows = [env.reset(seed=5)[0]]
    rows += [env.step(np.array([0.3 - 0.1 * number]))[0] for number in range(6)]
    np.testing.assert_allclose(uncompiled["observations"], rows, rtol=0, atol=1e-6)


def test_source_stamp_changes_with_the_source(tmp_path, monkeypatch):
    (tmp_path / "plant").mkdir()
    source = tmp_path / "plant" / "equations.py"
    other = tmp_path / "plant" / "kernel.py"
    monkeypatch.setattr(compiler, "__file__", str(tmp_path / "plant" / "compiler.py"))
    source.write_text("a = 1\n")
    other.write_text("b = 1\n")
    stamp = compiler.source_stamp("plant/equations.py")
    both = compiler.source_stamp("plant/equations.py", "plant/kernel.py")
    assert stamp == compiler.source_stamp("plant/equations.py")
    assert 0 <= stamp < 2**63
    assert stamp != both
    source.write_text("a = 2\n")
    assert compiler.source_stamp("plant/equations.py") != stamp
    source.write_text("a = 1\n")
    assert compiler.source_stamp("plant/equations.py") == stamp
    other.write_text("b = 2\n")
    assert compiler.source_stamp("plant/equations.py", "plant/kernel.py") != both


@pytest.mark.parametrize("function", [task_kernel.begin_episodes, task_kernel.step_axes, kernel.integrate])
def test_the_cache_is_keyed_by_the_source_stamp_alone(function):
    """A compiled function as closure variable would be another key in every process: compiled anew each time."""
    cells = dict(zip(function.py_func.__code__.co_freevars, function.py_func.__closure__, strict=True))
    assert set(cells) == {"stamp"}
    assert isinstance(cells["stamp"].cell_contents, int)


def test_every_kind_of_action_array_uses_one_compiled_step():
    """A second signature would compile for seconds in the middle of an episode."""
    env = hydro_env.ServoHydraulicEnv()
    env.reset(seed=0)
    env.step(np.zeros(1, dtype=np.float32))
    compiled = len(task_kernel.step_axes.signatures)
    fixed = np.zeros(1, dtype=np.float32)
    fixed.flags.writeable = False
    for action in (np.zeros(1), [0.5], np.ones(1, dtype=np.int64), np.zeros((2, 1))[::2, 0], fixed):
        env.step(action)
    envs = ServoHydraulicVectorEnv(5)
    envs.reset(seed=0)
    for action in (np.zeros((5, 1)), np.zeros((5, 1), np.float32), np.zeros((1, 5)).T, [[0.0]] * 5):
        envs.step(action)
    assert len(task_kernel.step_axes.signatures) == compiled
