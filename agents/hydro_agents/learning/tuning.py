"""Tunes the gains of any classical controller by CMA-ES on training plants with all leak levels and families.

Source: Hansen & Ostermeier, *Completely derandomized self-adaptation in evolution strategies*, Evolutionary Computation
9(2), 2001; the package ``cmaes``. Every kind gets the same optimiser, budget and training cases.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed, effective_n_jobs

from hydro_agents.controllers.base import Controller, search_space
from hydro_agents.controllers.registry import CONTROLLERS
from hydro_agents.learning.trials import JUDGED, REST, costs_of, mean_logarithm, resting_cases, tuning_cases
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import Columns, Job, run_here
from hydro_env import ConfigurationError, PlantParameters, TaskConfig, task_config
from hydro_env.files import Group, validate
from hydro_env.types import Floats

EVALUATIONS = 2800


class Space:
    """The search space of a class of gains as a unit cube; fields with ``logarithmic`` have a logarithmic scale."""

    def __init__(self, gains: type[Group], plant: PlantParameters) -> None:
        space = search_space(gains, plant)
        self.names = tuple(space)
        self._ends, logarithmic = np.array([row[:2] for row in space.values()]).T, [row[2] for row in space.values()]
        self._logarithmic = np.array(logarithmic)
        self._low, high = self._scaled(self._ends)
        self._width = high - self._low

    def _scaled(self, values: Floats) -> Floats:
        return np.log(values, out=values.copy(), where=self._logarithmic)

    def point(self, gains: Group) -> Floats:
        """Gains as a point of the cube, (n,); a gain outside its search range is clipped to it."""
        values = np.clip([float(getattr(gains, name)) for name in self.names], *self._ends)
        return (self._scaled(values) - self._low) / self._width

    def values(self, point: Floats) -> dict[str, float]:
        """The gains at a point of the cube, by name."""
        scaled = self._low + self._width * point
        values = np.exp(scaled, out=scaled.copy(), where=self._logarithmic)
        return dict(zip(self.names, values.tolist(), strict=True))


class Tuned(NamedTuple):
    """The best candidate so far."""

    gains: Group
    cost: float  # m, see :func:`~hydro_agents.learning.trials.mean_logarithm`
    evaluations: int


class Search(NamedTuple):
    """How a search goes."""

    start: Group  # what is not searched keeps these values
    evaluations: int  # number of candidates, rounded up to whole generations
    seed: int = 0  # of the optimiser and of the training cases

    cases: int = 42  # training cases of each candidate; a multiple of leak levels × families gives each the same number
    population: int = 14  # candidates per generation
    spread: float = 0.2  # of the first generation, in parts of the search ranges

    separable: bool = False
    """Learn no correlations. Then the search is the same on every processor, because it needs no eigenvectors, whose
    last digits differ; gains have six digits."""


def tune(
    kind: str,
    tasks: Sequence[TaskConfig],
    search: Search,
    folder: Path | None = None,
    progress: Callable[[Tuned], None] | None = None,
) -> Tuned:
    """Tune the gains of a kind of :data:`~hydro_agents.controllers.registry.CONTROLLERS`.

    Args:
        kind: the controller.
        tasks: of several the geometric mean of the costs counts.
        search: how the search goes.
        folder: keeps the costs of every generation, and gives those that it has: an interrupted search goes on
            bit-equal.
        progress: called after every generation with the best candidate so far.

    Raises:
        ConfigurationError: no candidate can control the axis.
    """
    from cmaes import CMA, SepCMA  # loads scipy.stats

    space = Space(type(search.start), tasks[0].plant)
    optimiser = (SepCMA if search.separable else CMA)(
        space.point(search.start),
        search.spread,
        bounds=np.tile([0.0, 1.0], (len(space.names), 1)),
        seed=search.seed,
        population_size=search.population,
    )
    best = None
    for done in range(0, search.evaluations, search.population):
        points = [optimiser.ask() for _ in range(search.population)]
        gains = [_gains(search.start, space.values(point), search.separable) for point in points]
        job = Job(costs_of_sets, kind, (gains, tasks, search.cases, search.seed), kind)
        costs = run_here(job, folder)["costs"].tolist()
        optimiser.tell(list(zip(points, costs, strict=True)))
        leader = int(np.argmin(costs))
        leading = gains[leader]
        if leading is not None and (best is None or costs[leader] < best.cost):
            best = Tuned(leading, costs[leader], 0)
        if best is not None:
            best = best._replace(evaluations=done + search.population)
            if progress is not None:
                progress(best)
    if best is None:
        raise ConfigurationError(f"{kind}: none of {search.evaluations} candidates could control the axis")
    return best


def _gains(start: Group, values: Mapping[str, float], rounded: bool) -> Group | None:
    """The gains of a candidate, ``rounded`` to six digits; ``None`` if they are invalid."""
    if rounded:
        values = {name: float(f"{value:.6g}") for name, value in values.items()}
    with suppress(ConfigurationError):
        return validate(type(start), {**start.model_dump(), **values}, "candidate")
    return None


# The costs of candidates ---------------------------------------------------------------------------------------------

Trial = tuple[TaskConfig, Cases, float | None]  # a task, its cases, and what counts of each episode: its last seconds


def costs_of_sets(
    kind: str, gains: Sequence[Group | None], tasks: Sequence[TaskConfig], cases: int, seed: int
) -> Columns:
    """The ``costs`` of some sets of gains, of several tasks the geometric means; each worker costs a part of the sets.

    A set ``None`` is refused. ``cases`` is their number for each set, beside the resting ones.
    """
    trials: list[Trial] = []
    for number, task in enumerate(tasks, seed):
        trials.append((task, tuning_cases(task, cases, number), None))
        trials.append((task_config(task, episode_duration=REST), resting_cases(number), JUDGED))
    count = min(effective_n_jobs(None), len(gains))
    calls = []
    for part in np.array_split(np.arange(len(gains)), count):
        calls.append(delayed(_costs)(kind, [gains[place] for place in part], trials))
    # Sums come after all parts are joined: their last bit depends on the number of candidates.
    costs = [np.concatenate(rows) for rows in zip(*Parallel(n_jobs=count)(calls), strict=True)]
    found = []
    for first in range(0, len(trials), 2):
        both = slice(first, first + 2)
        found.append(mean_logarithm(costs[both], [listed for _, listed, _ in trials[both]]))
    return {"costs": np.exp(np.mean(found, axis=0))}


def _costs(kind: str, gains: Sequence[Group | None], trials: Sequence[Trial]) -> list[Floats]:
    """Costs of some candidates of a kind, (candidates, cases), in each trial."""
    costs = []
    for task, cases, judged in trials:
        controllers = [_controller(kind, one, task) for one in gains]
        costs.append(costs_of(task, cases, controllers, judged))
    return costs


def _controller(kind: str, gains: Group | None, config: TaskConfig) -> Controller | None:
    """The controller of a candidate; ``None`` if it cannot be made (an unsolvable Riccati equation, say)."""
    with warnings.catch_warnings(action="ignore"), suppress(Exception):
        return CONTROLLERS[kind][0](gains, config) if gains is not None else None
    return None
