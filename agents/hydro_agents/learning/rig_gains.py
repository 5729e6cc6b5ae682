"""Gains of a rig that nobody tuned, from its file alone: one of a few sets in seconds, or a search of a minute.

A simulation of the rig judges them; its plants, leaks and references are those of a training.
"""

import contextlib
import hashlib
import math
import os
import sys
from collections.abc import Callable
from functools import cache
from itertools import cycle
from pathlib import Path

import numpy as np

from hydro_agents.controllers.registry import CONTROLLERS
from hydro_agents.learning.stable_gain import pids_from_figures
from hydro_agents.learning.tuning import Search, costs_of_sets, tune
from hydro_agents.running.jobs import digest_of_code
from hydro_agents.running.limit_cycles import counted_at_rest
from hydro_agents.running.seeds import STANDSTILLS
from hydro_env import ConfigurationError, TaskConfig, task_config
from hydro_env.files import Group, read_yaml, validate
from hydro_env.folders import config_folder

GainsFor = Callable[[str, TaskConfig], Group]  # of a kind and a task

CLEARLY = 0.9  # of the first set's error, for another set to be chosen; few cases favour some set by chance
CHOICE_CASES = 14  # of each set in :func:`chosen_gains`, beside the resting ones

NEARBY = 56  # candidates of :func:`searched_gains`
NEAR = {"pid": 0.05, "flow_linearising": 0.1}  # their first spread in parts of the search ranges
SEARCH_CASES = 42  # of each of these candidates
TRIALS = (1, 2, 3, 4)  # seeds of the other cases that decide in the end; the rig and its neighbours take turns
TRIAL_CASES = 84  # of each seed: many, because few plants swing
RESTS = 96  # standstills
PER_RINGING = {"pid": 15.0, "flow_linearising": 1.5}
"""What ringing at all of them adds to the logarithm of the error; the limit cycles of a PID are millimetres large."""
BETTER = 0.02  # lower logarithm of the error than the first set's, for others to take its place

BENDING = {"tip_share": 0.3, "tip_frequency": 2.0 * math.pi * 10.0, "tip_damping_ratio": 0.01}
"""A load that bends, as on many machines whose nameplates do not tell it."""


@cache
def gain_sets(kind: str, config: TaskConfig) -> list[Group]:
    """Sets of gains that may serve the rig of a task; the first is preferred.

    Those of a PID follow from the figures of the rig. Of another kind they serve different rigs: the default of the
    class, and what ships beside it.

    Raises:
        ConfigurationError: no PID follows from the figures.
    """
    if kind == "pid":
        return [*pids_from_figures(config)]
    group = CONTROLLERS[kind][1]
    sets = [group()]
    file = config_folder() / "agents" / f"{kind}_sets.yaml"
    if file.is_file():
        sets += [validate(group, values, file) for values in read_yaml(file)["sets"]]
    return sets


@cache
def chosen_gains(kind: str, config: TaskConfig) -> Group:
    """The set of :func:`gain_sets` that controls the simulated rig of the task best, if clearly so; in seconds."""
    sets = gain_sets(kind, config)
    if len(sets) > 1:
        errors = costs_of_sets(kind, sets, [config], CHOICE_CASES, 0)["costs"]
        if min(errors) < CLEARLY * errors[0]:
            return sets[np.argmin(errors)]
    return sets[0]


@cache
def searched_gains(kind: str, config: TaskConfig) -> Group:
    """Gains from a short search around :func:`chosen_gains`; it takes about a minute, once for a rig and its timing.

    They are kept on disk until the sources or the task change.
    """
    folder = Path(os.environ.get("HYDRO_CACHE_DIR", Path.home() / ".cache" / "hydro_env")) / "gains"
    key = f"{digest_of_code('hydro_agents')} {kind} {config!r}"
    file = folder / f"{kind}_{hashlib.sha256(key.encode()).hexdigest()[:24]}.yaml"
    with contextlib.suppress(ConfigurationError):  # none, or a damaged one
        return validate(CONTROLLERS[kind][1], read_yaml(file), file)
    found = gains_by_search(kind, config)
    with contextlib.suppress(ConfigurationError):  # no folder that can be written: the next command searches again
        found.to_yaml(file)
    return found


def gains_by_search(kind: str, config: TaskConfig) -> Group:
    """The best gains of a search.

    Fresh cases on the rig and its :func:`neighbours` decide between the best candidate of each generation, the choice
    and the first set: a search favours what some cases, and what its own plant, happen to forgive. Ringing and limit
    cycles after a step count against each.
    """
    print(f"hydro: {kind}: a simulation of the rig searches gains; about a minute", file=sys.stderr)
    chosen = chosen_gains(kind, config)
    found = [gain_sets(kind, config)[0], chosen]
    search = Search(chosen, NEARBY, cases=SEARCH_CASES, spread=NEAR[kind], separable=True)
    tune(kind, [config], search, progress=lambda best: found.append(best.gains))
    leaders = list(dict.fromkeys(found))  # a generation without a better candidate repeats the last one
    errors = np.zeros(len(leaders))
    for judge, seed in zip(cycle(neighbours(config)), TRIALS, strict=False):
        errors += np.log(costs_of_sets(kind, leaders, [judge], TRIAL_CASES, seed)["costs"]) / len(TRIALS)
    for number, gains in enumerate(leaders):
        counts = counted_at_rest(CONTROLLERS[kind][0](gains, config), config, STANDSTILLS, RESTS)
        errors[number] += PER_RINGING[kind] * max(counts["limit_cycles"], counts["ringing"]) / RESTS
    best = np.argmin(errors)
    return leaders[best if errors[best] < errors[0] - BETTER else 0]


def neighbours(config: TaskConfig) -> list[TaskConfig]:
    """The task, and the same with what its nameplates may not tell: a load that bends, the sharp edges of a lap."""
    plant, valve = config.plant, config.plant.valve
    found = [config]
    if not plant.structure.tip:
        found.append(task_config(config, plant=plant.replace(load=BENDING)))
    if not plant.structure.sharp_edges and valve.overlap == 0.0:
        lap = 0.5 * valve.underlap  # of the same flow at the null
        found.append(task_config(config, plant=plant.replace(valve={"underlap": 0.0, "overlap": -lap / (1.0 - lap)})))
    return found
