"""The cases on which gains are tuned, and what each candidate costs on them.

A controller must also rest well: pauses with a move at their end, slow runs and small steps count as three further
families. There an oscillation of its own costs most. Errors are those that the position sensor shows without its noise:
no controller sees the sensor's bias.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import LEARNING
from hydro_env import REFERENCE_FAMILIES, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.paces import full_speed
from hydro_env.task.sensors import CHANNELS
from hydro_env.types import Floats

LEAK_LEVELS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)  # l/min at 100 bar; every candidate runs with each in each family

RESTING = ("pause", "creep", "staircase")
"""Further families of every candidate, in episodes of :data:`REST`, of which the end counts; each with
:data:`REST_LEAKS`."""

REST, JUDGED = 5.0, 1.5  # s
REST_LEAKS = (0.03, 0.3, 2.0)  # l/min at 100 bar

EFFORT_TIME = 3e-3  # s; the squared change of the command in a period costs the travel at full speed in this time
REFUSED = 1e3  # m; cost of an invalid or failing candidate
_POSITION = CHANNELS.index("position")


def tuning_cases(config: TaskConfig, count: int, seed: int = 0) -> Cases:
    """``count`` training cases of every candidate; families and leak levels are spread evenly over them.

    The count should be a multiple of families × leak levels.
    """
    known = [name for name in REFERENCE_FAMILIES if config.references.weights.get(name, 0.0) > 0.0]
    index, levels = np.arange(count), len(LEAK_LEVELS)
    # With fewer cases than pairs, the families take turns: none is missing.
    turns = levels if count >= levels * len(known) else 1
    seeds = np.array(LEARNING.training(seed, count))
    return Cases(seeds, np.array(LEAK_LEVELS)[index % levels], np.array(known)[(index // turns) % len(known)])


def resting_cases(seed: int = 0) -> Cases:
    """The cases of the families :data:`RESTING`."""
    leaks, families = np.tile(REST_LEAKS, len(RESTING)), np.repeat(RESTING, len(REST_LEAKS))
    return Cases(np.array(LEARNING.training(seed, len(leaks))), leaks, families)


def costs_of(
    config: TaskConfig, cases: Cases, controllers: Sequence[Controller | None], judged: float | None = None
) -> Floats:
    """Mean absolute error in the sensor's frame plus cost of command changes, m, (candidates, cases).

    The candidates run side by side: each drives its slice of one vector environment, on the same cases. A failed axis
    costs the length of the stroke in every remaining period. A candidate that is ``None``, raises an error or returns a
    command that is not finite costs :data:`REFUSED`. Of each episode the last ``judged`` seconds count; default: all.
    """
    size, candidates = len(cases), len(controllers)
    first = 0 if judged is None else config.steps - round(judged / config.control_period)
    price = EFFORT_TIME * full_speed(config.plant)
    env = ServoHydraulicVectorEnv(candidates * size, config, autoreset_mode="NextStep", info=False)
    options = {name: np.tile(values, candidates).tolist() for name, values in cases.options.items()}
    observation, _ = env.reset(seed=cases.seeds.tolist() * candidates, options=options)
    axes = env.axes
    reference = axes.reference[:, : config.steps + 1] - axes.column("bias")[:, _POSITION, None]
    before = axes.column("command").copy()
    acting = {place: one for place, one in enumerate(controllers) if one is not None}
    memories: dict[int, Any] = {}
    alive, total = np.ones(len(before), dtype=bool), np.zeros(len(before))
    for step in range(config.steps):
        action = np.zeros((len(before), 1), dtype=np.float32)
        for place, controller in [*acting.items()]:
            part, memory = slice(place * size, (place + 1) * size), memories.get(place)
            try:
                commands, memories[place] = controller.predict(observation[part], memory, np.full(size, step == 0))
                action[part] = np.asarray_chkfinite(commands)
            except Exception:
                del acting[place]
        observation, _, terminated, _, _ = env.step(action)
        command = axes.column("command").copy()
        error = np.abs(reference[:, step + 1] - axes.column("position"))
        if step >= first:
            total += np.where(alive, error + price * (command - before) ** 2, config.plant.cylinder.stroke)
        before = command
        alive &= ~terminated
    result = (total / (config.steps - first)).reshape(candidates, size)
    result[[place for place in range(candidates) if place not in acting]] = REFUSED
    return result


def mean_logarithm(costs: Sequence[Floats], cases: Sequence[Cases]) -> Floats:
    """Mean logarithms of the costs of the candidates of :func:`costs_of`, (candidates,).

    Each family, resting ones too, weighs the same, with the mean over its cases.
    """
    parts = []
    for own, rows in zip(cases, costs, strict=True):
        families = np.array(own.options["reference"])
        for family in dict.fromkeys(families.tolist()):
            parts.append(rows[:, families == family].mean(axis=1))
    return np.asarray(np.log(parts).mean(axis=0))
