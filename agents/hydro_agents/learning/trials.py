"""The cases on which gains are tuned, and what each candidate costs on them.

A controller must also rest well: pauses with a move at their end, slow runs and small steps count as three further
families. There an oscillation of its own costs most. Errors are those that the position sensor shows without its noise:
no controller sees the sensor's bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.running.seeds import LEARNING
from hydro_env import REFERENCE_FAMILIES, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.sensors import CHANNELS
from hydro_env.types import Floats

LEAK_LEVELS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
"""l/min at 100 bar; every candidate runs with each leak in each family."""

RESTING = ("pause", "creep", "staircase")
"""Further families of every candidate, in episodes of :data:`REST`, of which the end counts; each with
:data:`REST_LEAKS`."""

REST, JUDGED = 5.0, 1.5  # s
REST_LEAKS = (0.03, 0.3, 2.0)  # l/min at 100 bar

EFFORT_TIME = 3e-3
"""s; the squared change of the command in a period costs as much as the travel at full speed in this time."""

REFUSED = 1e3  # m; cost of an invalid or failing candidate
_POSITION = CHANNELS.index("position")


@dataclass(frozen=True)
class TuningCases:
    """The training cases of every candidate, each (N,); N should be a multiple of families × leak levels."""

    seeds: tuple[int, ...]
    leakage_flow_lpm: tuple[float, ...]
    families: tuple[str, ...]

    @classmethod
    def of(cls, config: TaskConfig, count: int, seed: int = 0) -> TuningCases:
        """``count`` cases of the training seeds; families and leak levels are spread evenly over them."""
        known = [name for name in REFERENCE_FAMILIES if config.references.weights.get(name, 0.0) > 0.0]
        seeds, levels = LEARNING.training(seed, count), len(LEAK_LEVELS)
        # With fewer cases than pairs, the families take turns: none is missing.
        turns = levels if count >= levels * len(known) else 1
        return cls(
            tuple(seeds),
            tuple(LEAK_LEVELS[index % levels] for index in range(count)),
            tuple(known[(index // turns) % len(known)] for index in range(count)),
        )

    @classmethod
    def resting(cls, seed: int = 0) -> TuningCases:
        """The cases of the families :data:`RESTING`."""
        pairs = [(leak, family) for family in RESTING for leak in REST_LEAKS]
        leaks, families = zip(*pairs, strict=True)
        return cls(tuple(LEARNING.training(seed, len(pairs))), leaks, families)

    def __len__(self) -> int:
        return len(self.seeds)


@dataclass(frozen=True)
class Score:
    """Costs of a candidate on the training cases, in m; each includes the cost of command changes."""

    mean: float  # mean over the cases of the task of the mean absolute error
    equal: float  # geometric mean over the families, resting ones too, of the mean over their cases


def costs_of(
    config: TaskConfig, cases: TuningCases, controllers: Sequence[Controller | None], judged: float | None = None
) -> Floats:
    """Mean absolute error in the sensor's frame plus cost of command changes, m, (candidates, cases).

    The candidates run side by side: each drives its slice of one vector environment, on the same cases. A failed axis
    costs the length of the stroke in every remaining period. A candidate that is ``None``, raises an error or returns a
    command that is not finite costs :data:`REFUSED`.

    Args:
        config: the task.
        cases: the same for every candidate.
        controllers: the candidates.
        judged: s, end of each episode whose errors count; default: all.
    """
    size, candidates = len(cases), len(controllers)
    first = 0 if judged is None else config.steps - round(judged / config.control_period)
    price = EFFORT_TIME * float(np.mean(speed_limits(config.plant)))
    with closing(ServoHydraulicVectorEnv(candidates * size, config, autoreset_mode="NextStep", info=False)) as env:
        leaks = np.tile(cases.leakage_flow_lpm, candidates)
        options = {"leakage_flow_lpm": leaks, "reference": list(cases.families) * candidates}
        observation, _ = env.reset(seed=list(cases.seeds) * candidates, options=options)
        axes = env.axes
        reference = axes.reference[:, : config.steps + 1] - axes.column("bias")[:, _POSITION, None]
        before = axes.column("command").copy()
        memories: list[Any] = [None] * candidates
        able = np.array([controller is not None for controller in controllers])
        alive, total = np.ones(len(before), dtype=np.bool_), np.zeros(len(before))
        action = np.zeros((len(before), 1), dtype=np.float32)
        for step in range(config.steps):
            started = np.full(size, step == 0)
            action[:] = 0.0
            for number, controller in enumerate(controllers):
                part = slice(number * size, (number + 1) * size)
                if controller is None or not able[number]:
                    continue
                try:
                    commands, memories[number] = controller.predict(observation[part], memories[number], started)
                    able[number] = np.isfinite(commands).all()
                except Exception:
                    able[number] = False
                if able[number]:
                    action[part] = commands
            observation, _, terminated, _, _ = env.step(action)
            command = np.clip(action[:, 0].astype(np.float64), -1.0, 1.0)
            error = np.abs(reference[:, step + 1] - axes.column("position"))
            if step >= first:
                total += np.where(alive, error + price * (command - before) ** 2, config.plant.cylinder.stroke)
            before = command
            alive &= ~terminated
    result = (total / (config.steps - first)).reshape(candidates, size)
    result[~able] = REFUSED
    return result


def scored(costs: Sequence[Floats], cases: Sequence[TuningCases]) -> list[Score]:
    """:class:`Score` of each candidate from :func:`costs_of`; the sums depend on the number of candidates."""
    parts = [
        rows[:, np.array(own.families) == family].mean(axis=1)
        for own, rows in zip(cases, costs, strict=True)
        for family in dict.fromkeys(own.families)
    ]
    equal = np.exp(np.mean(np.log(parts), axis=0))
    return [Score(float(mean), float(value)) for mean, value in zip(costs[0].mean(axis=1), equal, strict=True)]


def over_tasks(costed: Sequence[Sequence[Score]]) -> list[Score]:
    """The scores of each candidate on one task, or their geometric means over several."""
    if len(costed) == 1:
        return list(costed[0])
    logs = np.log([[(score.mean, score.equal) for score in row] for row in costed])
    return [Score(float(mean), float(equal)) for mean, equal in np.exp(logs.mean(axis=0))]
