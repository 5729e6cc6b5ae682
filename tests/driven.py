"""Axes under a controller, without what a run of cases records."""

import numpy as np

from hydro_env import ServoHydraulicVectorEnv


def commands(controller, task, count=4, steps=30):
    """Commands of a controller on drawn axes, (steps, count, 1)."""
    env = ServoHydraulicVectorEnv(count, task, info=False)
    observation, _ = env.reset(seed=3)
    memory, given = None, []
    for step in range(steps):
        action, memory = controller.predict(observation, memory, np.full(count, step == 0))
        given.append(action)
        observation, *_ = env.step(action)
    return np.array(given)
