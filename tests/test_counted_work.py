"""Work that is counted, not timed: vector instructions, calls of Python functions, memory, compiled functions."""

import gc
import json
import os
import re
import subprocess
import sys
import tracemalloc
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pytest

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv

ROOT = Path(__file__).parents[1]

FIRST_STEP = """
import json, sys
import numpy as np
from numba.core.event import install_recorder
import hydro_env
from hydro_env.task import kernel
with install_recorder("numba:compile") as recorder:
    env = hydro_env.ServoHydraulicEnv()
    env.reset(seed=0)
    env.step(np.zeros(1))
code = list(kernel.step_axes.dispatcher.inspect_asm().values()) if "assembly" in sys.argv else []
print(json.dumps({"compiled": len(recorder.buffer) // 2, "assembly": code}))
"""


@pytest.fixture(scope="module")
def first_steps(tmp_path_factory):
    """What was compiled for a first step with an empty cache, with the assembly of a step, and once more after it."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("cache"))}
    answers = []
    for arguments in (["assembly"], []):  # code from the cache cannot be inspected
        command = [sys.executable, "-c", FIRST_STEP, *arguments]
        run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        assert run.returncode == 0, run.stderr
        answers.append(json.loads(run.stdout))
    return answers


def wide_registers():
    """Names of the widest vector registers of this processor, as assembly writes them; None where it has none.

    With AVX-512 both widths count: for some processors LLVM prefers the half, at which they run faster.
    """
    features = llvm.get_host_cpu_features()
    if not llvm.get_process_triple().startswith("x86_64"):
        return None
    return "[yz]mm" if features.get("avx512f") else "ymm" if features.get("avx") else None


def test_the_integration_uses_the_widest_vector_instructions(first_steps):
    """Products of whole registers of doubles must outnumber those of single ones, with square roots and quotients."""
    register = wide_registers()
    if register is None:
        pytest.skip("this processor has no vector instructions that are known here")
    (code,) = first_steps[0]["assembly"]
    packed = {name: len(re.findall(rf"\bv{name}pd\b[^\n]*%{register}", code)) for name in ("mul", "sqrt", "div")}
    scalar = len(re.findall(r"\bv?mulsd\b", code))
    assert packed["mul"] > 100, packed
    assert packed["mul"] > scalar / 4, (packed, scalar)  # episodes and sensors are scalar
    assert packed["sqrt"] >= 8, packed
    assert packed["div"] >= 8, packed


def calls_of(function):
    """Calls of Python functions and of C functions while ``function`` runs."""
    counted = {"call": 0, "c_call": 0}

    def count(frame, event, argument):
        if event in counted:
            counted[event] += 1

    sys.setprofile(count)
    try:
        function()
    finally:
        sys.setprofile(None)
    return counted


def begun(count, **settings):
    envs = ServoHydraulicVectorEnv(count, threads=1, **settings)
    envs.reset(seed=0)
    actions = np.zeros((count, 1), np.float32)
    envs.step(actions)
    return envs, actions


def test_no_python_call_per_axis():
    counts = []
    for count in (16, 1024):
        envs, actions = begun(count)
        counts.append(calls_of(lambda envs=envs, actions=actions: envs.step(actions)))
    assert counts[0] == counts[1]
    assert counts[0]["call"] <= 40, counts


def test_few_python_calls_in_a_step_of_one_axis():
    env = ServoHydraulicEnv()
    env.reset(seed=0)
    action = np.zeros(1, np.float32)
    env.step(action)
    counted = calls_of(lambda: env.step(action))
    assert counted["call"] <= 20, counted
    assert counted["c_call"] <= 40, counted


def memory_of(step, count):
    """Bytes that are held after ``count`` more steps, and the most that were at any time, both beyond the start."""
    gc.collect()
    tracemalloc.start()
    try:
        for _ in range(10):
            step()
        gc.collect()
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for _ in range(count):
            step()
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return after - before, peak - before


def test_a_step_leaves_nothing_behind_and_takes_only_what_it_returns():
    envs, actions = begun(1024, info=False)
    for _ in range(3):
        returned = envs.step(actions)
    row = envs.axes.observation.nbytes
    arrays = sum(array.nbytes for array in returned[:4])
    growth, peak = memory_of(lambda: envs.step(actions), 100)
    assert growth < 4096  # nothing grows with the number of steps
    # Besides what is returned: the last observation that is kept, the commands as float64, and small change.
    assert peak < arrays + row + 3 * 8 * 1024 + 8192


def test_a_step_of_one_axis_leaves_nothing_behind():
    env = ServoHydraulicEnv()
    env.reset(seed=0)
    action = np.zeros(1, np.float32)
    growth, peak = memory_of(lambda: env.step(action), 300)
    assert growth < 4096  # the same after 300 steps and after 900
    assert peak < 16384  # the integrator's working memory, given back after each step


def test_few_functions_are_compiled_before_the_first_step(first_steps):
    cold, warm = (answer["compiled"] for answer in first_steps)
    assert 0 < cold <= 172
    assert warm == 0  # everything came from the cache
