"""Work that is counted, not timed: calls of Python functions, and memory."""

import gc
import sys
import tracemalloc

import numpy as np

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv


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


def test_few_python_calls_in_a_step_and_none_per_axis():
    counts = []
    for count in (16, 1024):
        envs, actions = begun(count)
        counts.append(calls_of(lambda envs=envs, actions=actions: envs.step(actions)))
    assert counts[0] == counts[1]
    assert counts[0]["call"] <= 40, counts
    env = ServoHydraulicEnv()
    env.reset(seed=0)
    env.step(actions[0])
    counted = calls_of(lambda: env.step(actions[0]))
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
    env = ServoHydraulicEnv()
    env.reset(seed=0)
    growth, peak = memory_of(lambda: env.step(actions[0]), 300)
    assert growth < 4096  # the same after 300 steps and after 900
    assert peak < 16384  # the integrator's working memory, given back after each step
