"""References of long, continuous operation: an axis moves, creeps and stands, in changing families of references.

An episode holds one family and begins at rest. The reference of an axis at work consists of stretches of 10 to 60 s,
each with its own family, at full speed, at a sixteenth of it, or standing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.looks import Activity
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.reference_signals import FAMILIES

SHARES = {Activity.STANDING: 0.2, Activity.SLOW: 0.2, Activity.MOVING: 0.6}
PACE = {Activity.STANDING: 0.0, Activity.SLOW: 1.0 / 16.0, Activity.MOVING: 1.0}
STRETCH = (10.0, 60.0)
"""Duration of a stretch in s, drawn log-uniformly."""

FADE = 2.0
"""Time in s in which the reference passes from one family to the next."""


def working_references(
    config: TaskConfig, seeds: NDArray[np.int64], then: tuple[float, Activity] | None = None
) -> NDArray[np.float64]:
    """References of N axes at work, m, (N, samples of an episode with its preview).

    Args:
        config: the task; its episode is as long as the operation.
        seeds: seeds of the axes (N,); the references stay within the limits of the plants that they draw.
        then: a time in s, and the activity of each axis from then on.
    """
    names = [name for name in FAMILIES if name != "user" and config.references.weights.get(name, 0.0) > 0.0]
    env = ServoHydraulicVectorEnv(len(seeds), config, info=False)
    families = []
    for name in names:
        env.reset(seed=[int(seed) for seed in seeds], options={"reference": name})
        families.append(env.axes.reference.copy())
    env.close()
    rows = [
        _joined(
            [family[axis] for family in families], config.control_period, np.random.default_rng([int(seed), 1]), then
        )
        for axis, seed in enumerate(seeds)
    ]
    return np.array(rows)


def _joined(
    families: list[NDArray[np.float64]],
    period: float,
    generator: np.random.Generator,
    then: tuple[float, Activity] | None,
) -> NDArray[np.float64]:
    samples = len(families[0])
    row = np.empty(samples)
    clocks = np.zeros(len(families))  # in samples: where each family goes on
    first, held = 0, families[0][0]
    activities, shares = list(SHARES), list(SHARES.values())
    while first < samples:
        duration = np.exp(generator.uniform(*np.log(STRETCH)))
        family = int(generator.integers(len(families)))
        activity = activities[generator.choice(len(shares), p=shares)]
        last = min(first + max(round(duration / period), 1), samples)
        if then is not None:
            change = round(then[0] / period)
            if first >= change:
                activity, last = then[1], samples
            else:
                last = min(last, change)
        ahead = clocks[family] + PACE[activity] * np.arange(last - first)
        stretch = np.interp(ahead, np.arange(samples), families[family])
        share = np.minimum(np.arange(last - first) * period / FADE, 1.0)
        weight = share**3 * (10.0 + share * (6.0 * share - 15.0))
        row[first:last] = held + weight * (stretch - held)
        clocks[family] = ahead[-1] + PACE[activity]
        first, held = last, row[last - 1]
    return row
