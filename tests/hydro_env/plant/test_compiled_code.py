"""Compiled code: neighbours, threads and compilation leave a plant's numbers alone; the cache notices changes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

import hydro_env
from hydro_env import ServoHydraulicVectorEnv, compiling
from hydro_env.axes import Axes
from hydro_env.plant import kernel
from hydro_env.plant.states import N_STATES
from hydro_env.task import kernel as task_kernel
from hydro_env.task.configuration import task_config


def drawn_plants(count, seed=0):
    """Axes with ``count`` randomised plants at rest; the friction of some asks for shorter inner steps."""
    stiffness = {"friction.transition_velocity": {"log_uniform": [5e-5, 2e-3]}}
    axes = Axes(task_config(None, randomisation=task_config(None).model_dump()["randomisation"] | stiffness), count)
    for axis in range(count):
        axes.seed(axis, np.random.default_rng([seed, axis]))
    axes.begin(np.arange(count))
    # Arrays of their own, for which the kernel alone is compiled already.
    axes.state, axes.coefficient = axes.state.copy(), axes.coefficient.copy()
    return axes


DURATIONS = np.array([1e-3, 4e-3])
ROOT = Path(hydro_env.__file__).parents[1]


def advance(state, coefficients, voltage, durations, peaks, first, last):
    plants = kernel.Plants(state, coefficients, voltage, np.tile(durations, (len(state), 1)), peaks)
    kernel.integrate(plants, kernel.Accuracy(), first, last)


@pytest.mark.parametrize("count", [2, 17])
def test_a_plant_among_others_moves_exactly_as_it_does_alone(count):
    periods = 20
    axes = drawn_plants(count)
    inputs = 10.0 * np.random.default_rng(1).uniform(-1, 1, (periods, count, 2))
    together, peaks = axes.state.copy(), np.empty((count, kernel.N_PEAKS))
    taken = np.zeros(count)
    for voltage in inputs:
        advance(together, axes.coefficient, voltage, DURATIONS, peaks, 0, count)
        taken += peaks[:, kernel.STEPS]
    assert np.abs(together[:, 0] - axes.state[:, 0]).max() > 1e-3  # they did move
    assert len(set(taken)) > count / 2  # each in its own steps
    for axis in range(count):
        state, own_peaks = axes.state[axis : axis + 1].copy(), np.empty((1, kernel.N_PEAKS))
        for voltage in inputs:
            held = voltage[axis : axis + 1]
            advance(state, axes.coefficient[axis : axis + 1], held, DURATIONS, own_peaks, 0, 1)
        np.testing.assert_array_equal(state[0], together[axis])
        np.testing.assert_array_equal(own_peaks[0], peaks[axis])


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300])
def test_a_broken_state_ends_and_harms_no_neighbour(value):
    count = 20
    axes = drawn_plants(count)
    voltage = np.full((count, 2), 3.0)
    clean, peaks = axes.state.copy(), np.empty((count, kernel.N_PEAKS))
    advance(clean, axes.coefficient, voltage, DURATIONS, peaks, 0, count)
    for row in range(N_STATES):
        state = axes.state.copy()
        state[7, row] = value
        advance(state, axes.coefficient, voltage, DURATIONS, peaks, 0, count)
        others = np.arange(count) != 7
        np.testing.assert_array_equal(state[others], clean[others])
        assert not (np.abs(state[7] - clean[7]) <= 1e-12).all()


SCRIPT = """
import json, sys, warnings
warnings.simplefilter("ignore", RuntimeWarning)  # unsigned numbers wrap around, as they must
import numpy as np
from hydro_env import PlantParameters, ServoHydraulicEnv, simulate
run = simulate(PlantParameters(), np.repeat([4.0, -3.0, 10.0], 2), 5e-3)
env = ServoHydraulicEnv()
rows = [env.reset(seed=5)[0].tolist()]
rows += [env.step(np.array([0.3 - 0.1 * number]))[0].tolist() for number in range(3)]
numbers = {"states": run.states.tolist(), "observations": rows}
if __name__ == "__main__":
    json.dump(numbers, sys.stdout)
"""


def test_the_same_source_uncompiled_gives_the_same_numbers():
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    uncompiled = json.loads(subprocess.check_output([sys.executable, "-c", SCRIPT], env=environment, text=True))
    exec(SCRIPT, compiled := {"__name__": "here"})
    states = np.array(compiled["numbers"]["states"])
    size = np.maximum(np.abs(states).max(axis=0), 1e-9)
    assert np.abs((np.array(uncompiled["states"]) - states) / size).max() < 1e-9
    np.testing.assert_allclose(uncompiled["observations"], compiled["rows"], rtol=0, atol=1e-6)


def test_kernels_of_another_package_depend_on_all_of_its_files(tmp_path):
    """Numba looks at the file of a kernel alone: without the digest, old machine code would outlive an upgrade."""
    before = compiling.digest_of_sources(tmp_path)
    (tmp_path / "called.py").write_text("x = 1")
    assert compiling.digest_of_sources(tmp_path) != before == compiling.SOURCES


def build(sources):
    def double(values):
        assert sources >= 0
        return 2.0 * values.sum()

    return compiling.compiled(double)


@pytest.fixture
def run_cheap_kernel(tmp_path, monkeypatch, capsys):
    """A function that begins a kernel anew; it returns the files of the cache, and what was said on the console."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def run():
        compiling._announce.cache_clear()
        assert build(compiling.SOURCES)(np.ones(3)) == 6.0
        return sorted(tmp_path.rglob("*.nb[ic]")), capsys.readouterr().err

    return run


def test_the_cache_is_made_once_read_silently_and_a_damaged_one_made_again(run_cheap_kernel):
    files, said = run_cheap_kernel()
    assert len(files) == 2
    assert "compiling" in said
    content = {file: file.read_bytes() for file in files}
    assert run_cheap_kernel() == (files, "")
    for damage, ending in ((bytes(range(256)) * 8, ".nbi"), (b"x", ".nbc")):
        for file in files:
            file.write_bytes(damage if file.suffix == ending else content[file])
        dropped, _ = run_cheap_kernel()
        assert damage not in [file.read_bytes() for file in dropped]
        again = dropped if len(dropped) == 2 else run_cheap_kernel()[0]
        assert again == files


def test_every_kind_of_action_array_uses_one_compiled_step():
    """A second signature would compile for seconds in the middle of an episode."""
    env = hydro_env.ServoHydraulicEnv()
    env.reset(seed=0)
    env.step(np.zeros(1, dtype=np.float32))
    compiled = len(task_kernel.step_axes.dispatcher.signatures)
    fixed = np.zeros(1, dtype=np.float32)
    fixed.flags.writeable = False
    for action in (np.zeros(1), [0.5], np.ones(1, dtype=np.int64), np.zeros((2, 1))[::2, 0], fixed):
        env.step(action)
    envs = ServoHydraulicVectorEnv(5)
    envs.reset(seed=0)
    for action in (np.zeros((5, 1)), np.zeros((5, 1), np.float32), np.zeros((1, 5)).T, [[0.0]] * 5):
        envs.step(action)
    assert len(task_kernel.step_axes.dispatcher.signatures) == compiled
