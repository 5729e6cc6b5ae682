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

ASSEMBLY = """
import sys
from hydro_env.plant import kernel
from hydro_env.task import kernel as task
import numpy as np
import hydro_env
env = hydro_env.ServoHydraulicEnv()
env.reset(seed=0)
env.step(np.zeros(1))
(code,) = task.step_axes.dispatcher.inspect_asm().values()
sys.stdout.write(code)
"""


def wide_registers():
    """Names of the widest vector registers of this processor, as assembly writes them; None where it has none.

    With AVX-512 both widths count: for some processors LLVM prefers the half, at which they run faster.
    """
    features = llvm.get_host_cpu_features()
    if not llvm.get_process_triple().startswith("x86_64"):
        return None
    return "[yz]mm" if features.get("avx512f") else "ymm" if features.get("avx") else None


def test_the_integration_uses_the_widest_vector_instructions(tmp_path):
    """Products of whole registers of doubles must outnumber those of single ones, with square roots and quotients."""
    register = wide_registers()
    if register is None:
        pytest.skip("this processor has no vector instructions that are known here")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}  # code from the cache cannot be inspected
    run = subprocess.run([sys.executable, "-c", ASSEMBLY], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    packed = {name: len(re.findall(rf"\bv{name}pd\b[^\n]*%{register}", run.stdout)) for name in ("mul", "sqrt", "div")}
    scalar = len(re.findall(r"\bv?mulsd\b", run.stdout))
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
    assert growth < 4096
    assert peak < 16384  # the integrator's working memory, given back after each step


COMPILED = """
import json, os
import numpy as np
from numba.core.event import install_recorder
from numba.core import codegen
machine_code = []
original = codegen.JITCodeLibrary._finalize_specific
def finalize(self):
    machine_code.append(self.name)
    return original(self)
codegen.JITCodeLibrary._finalize_specific = finalize
import hydro_env
with install_recorder("numba:compile") as recorder:
    env = hydro_env.ServoHydraulicEnv()
    env.reset(seed=0)
    env.step(np.zeros(1))
print(json.dumps({"code": machine_code, "typed": len(recorder.buffer) // 2}))
"""


def test_few_functions_are_compiled_before_the_first_step(tmp_path):
    """Machine code for the two kernels and for what numba itself brings; the rest is only translated for them."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COMPILED]
    runs = []
    for _ in range(2):
        run = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        assert run.returncode == 0, run.stderr
        runs.append(json.loads(run.stdout))
    cold, warm = runs
    assert len([name for name in cold["code"] if name.startswith("_build.")]) == 2, cold["code"]
    assert len(cold["code"]) <= 24, cold["code"]
    assert cold["typed"] <= 110, cold["typed"]
    assert warm["typed"] == 0  # everything came from the cache
