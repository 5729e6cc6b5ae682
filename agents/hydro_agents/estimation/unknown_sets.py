"""Sets of unknowns in addition to the leak: from none to a worn valve, sensor gains and forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hydro_agents.estimation.names import BIASES, GAINS, LEAKAGE, STARTS
from hydro_agents.estimation.priors import Prior, prior_of
from hydro_agents.estimation.unknowns import default_unknowns, priors_of
from hydro_env import ConfigurationError, TaskConfig

LEAK_ALONE, PLANT_KNOWN, TASK, WORN_VALVE, EVERYTHING = (
    "the leak alone",
    "start and biases too",
    "the plant too",
    "a worn valve too",
    "gains and forces too",
)
"""Names of the sets; each contains the previous one."""

_WEAR = {"valve.null_shift": (0.01, False), "valve.underlap": (0.03, False), "valve.rated_flow": (0.2, True)}
"""Standard deviation of a worn valve's parameters, of full stroke or (if true) of the logarithm."""

_FURTHER = (*GAINS, "supply.tank_pressure", "load.external_force")


class UnknownSet(NamedTuple):
    """Some unknowns, and factors on the standard deviations of their priors."""

    unknowns: tuple[str, ...]
    widths: Mapping[str, float]


class UnknownSets(NamedTuple):
    """Sets of unknowns by name, and the priors of all their unknowns."""

    sets: Mapping[str, UnknownSet]
    priors: Mapping[str, Prior]


def unknown_sets(config: TaskConfig, more: Sequence[str] = ()) -> UnknownSets:
    """The sets for a task; ``more`` adds a set with these unknowns in addition to the task's.

    Raises:
        ConfigurationError: an unknown of ``more`` does not exist, occurs twice, or is already an unknown of the task.
    """
    task = default_unknowns(config)
    for name in more:
        prior_of(config, name)
        if name in task or list(more).count(name) > 1:
            what = "is among the unknowns of the task" if name in task else "is given twice"
            raise ConfigurationError(f"unknown '{name}': {what}")
    own = {name: prior_of(config, name) for name in _WEAR}
    worn = {name: _widened(prior, *_WEAR[name]) for name, prior in own.items()}
    names = tuple(dict.fromkeys((*task, *worn, *_FURTHER, *more)))
    priors = priors_of(config, names, worn)
    as_drawn = {name: _linear(own[name], worn[name]) / worn[name].deviation for name in worn}
    start = tuple(name for name in task if name in (*BIASES, *STARTS))
    sets = {
        LEAK_ALONE: UnknownSet((LEAKAGE,), {}),
        PLANT_KNOWN: UnknownSet((LEAKAGE, *start), {}),
        TASK: UnknownSet(task, as_drawn),
        WORN_VALVE: UnknownSet(tuple(dict.fromkeys((*task, *worn))), {}),
        EVERYTHING: UnknownSet(tuple(dict.fromkeys((*task, *worn, *_FURTHER))), {}),
    }
    if more:
        sets[f"the plant and {', '.join(more)} too"] = UnknownSet((*task, *more), as_drawn)
    return UnknownSets(sets, priors)


def _widened(prior: Prior, deviation: float, logarithmic: bool) -> Prior:
    """The prior of a worn valve; a wider range of the task is kept."""
    wide = Prior(prior.mean, deviation, logarithmic and prior.mean > 0.0)
    return Prior(wide.mean, max(deviation, _linear(prior, wide)), wide.logarithmic)


def _linear(prior: Prior, like: Prior) -> float:
    """Standard deviation of a prior in the scale of another prior of the same unknown, to first order."""
    if prior.logarithmic == like.logarithmic:
        return prior.deviation
    return prior.deviation * prior.mean if prior.logarithmic else prior.deviation / prior.mean
