"""Rows measure what they say: counts and cheap rows give sane figures."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.environment_rows import BareKernel, single_rate, vector_rate
from benchmarks.resource_rows import array_bytes, inference_cases, memory_cases
from benchmarks.table import QUICK, fresh_process
from benchmarks.training_rows import time_in
from hydro_env import ServoHydraulicVectorEnv

TINY = dataclasses.replace(QUICK, runs=1, seconds=0.005, kernel_sizes=(1, 16), vector_sizes=(2,), calls=200)


def test_bare_kernel_advances():
    kernel = BareKernel(16, 2)
    first = kernel.state.copy()
    assert kernel.advance() == 16
    assert not np.array_equal(kernel.state, first)
    kernel.close()


def test_rates_of_environments():
    assert single_rate(gym.make("ServoHydraulic-v0"), 0.01, 20) > 100
    for mode in ("NextStep", "SameStep", "Disabled"):
        env = gym.make_vec("ServoHydraulic-v0", num_envs=2, autoreset_mode=mode, episode_duration=0.05)
        assert vector_rate(env, 0.01) > 100


def test_cheap_rows_are_positive():
    for case in inference_cases(TINY):
        values = case.measure(0)
        assert len(values) == len(case.rows)
        assert all(np.isfinite(values))
        assert min(values) > 0.0


def test_memory_of_arrays():
    env = ServoHydraulicVectorEnv(64)
    assert array_bytes(env) > 64 * 400 * 8  # at least the reference
    (arrays,) = memory_cases(TINY, 512)
    assert 3000 < arrays.measure(0)[0] < 20_000


def test_fresh_process_reports_its_failure():
    assert fresh_process("print(7)")[1].strip() == "7"
    with pytest.raises(RuntimeError, match="ValueError: no"):
        fresh_process("raise ValueError('no')")


def test_timed_functions_are_put_back():
    class Worker:
        def work(self):
            return 3

    worker = Worker()
    with time_in((worker, "work", "work")) as seconds:
        assert worker.work() == 3
    assert seconds["work"] > 0.0
    assert "work" not in vars(worker)
