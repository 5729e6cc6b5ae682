"""Work that is counted, not timed: calls of Python functions, and memory."""

import sys

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
