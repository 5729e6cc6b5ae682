"""An own reference is followed by axes on which nothing changes on its own."""

import numpy as np

from hydro_agents.running.tasks import own_reference
from hydro_env import ServoHydraulicVectorEnv, TaskConfig


def test_leak_faults_and_force_stay_as_they_are_drawn():
    changing = {"probability": 1.0, "schedule": "growth"}
    config = TaskConfig(
        leakage={"schedule": "growth"},
        disturbance={"kind": "step"},
        faults={"valve_null_shift": changing, "sensor_offset": changing},
    )
    task = own_reference(config, np.zeros(41))
    env = ServoHydraulicVectorEnv(3, task, info=False, autoreset_mode="Disabled")
    env.reset(seed=[1, 2, 3])
    leak, fault, force = _now(env)
    assert np.count_nonzero(fault) == 6, "both faults are there from the start"
    for _ in range(30):
        env.step(np.zeros((3, 1), dtype=np.float32))
        for now, before in zip(_now(env), (leak, fault, force), strict=True):
            np.testing.assert_array_equal(now, before)


def _now(env):
    axes = env.axes
    force = [axes.external_force(axis) for axis in range(3)]
    return axes.column("leak_flow").copy(), axes.column("fault").copy(), np.array(force)
