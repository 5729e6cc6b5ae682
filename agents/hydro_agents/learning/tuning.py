"""Tunes the gains of any classical controller by CMA-ES on training plants with all leak levels and families.

Source: Hansen & Ostermeier, *Completely derandomized self-adaptation in evolution strategies*, Evolutionary Computation
9(2), 2001; the package ``cmaes``. Every kind gets the same optimiser, budget and training cases.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from joblib import Parallel, delayed, effective_n_jobs

from hydro_agents.controllers.base import Controller, search_space
from hydro_agents.controllers.registry import CONTROLLERS
from hydro_agents.learning.trials import JUDGED, REST, costs_of, resting_cases, summed_up, tuning_cases
from hydro_agents.running.jobs import Columns, Job, run_here
from hydro_env import ConfigurationError, PlantParameters, TaskConfig, task_config
from hydro_env.files import Group, validate
from hydro_env.mistakes import unknown
from hydro_env.types import Floats

if TYPE_CHECKING:
    from cmaes import CMA, SepCMA

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
        return np.where(self._logarithmic, np.log(np.where(self._logarithmic, values, 1.0)), values)

    def point(self, gains: Group) -> Floats:
        """Gains as a point of the cube, (n,); a gain outside its search range is clipped to it."""
        values = np.clip([float(getattr(gains, name)) for name in self.names], *self._ends)
        return np.clip((self._scaled(values) - self._low) / self._width, 0.0, 1.0)

    def values(self, point: Floats) -> dict[str, float]:
        """The gains at a point of the cube, by name."""
        scaled = self._low + self._width * np.clip(point, 0.0, 1.0)
        values = np.where(self._logarithmic, np.exp(np.where(self._logarithmic, scaled, 0.0)), scaled)
        return dict(zip(self.names, values.tolist(), strict=True))


class Tuned(NamedTuple):
    """The best candidate so far."""

    gains: Group
    cost: float  # m, see :func:`~hydro_agents.learning.trials.summed_up`
    evaluations: int


class Search(NamedTuple):
    """How a search goes."""

    evaluations: int = EVALUATIONS  # number of candidates, rounded up to whole generations
    seed: int = 0  # of the optimiser and of the training cases

    cases: int = 42  # training cases of each candidate; a multiple of leak levels × families gives each the same number
    start: Group | None = None  # default: the defaults of the class; what is not searched keeps these values
    population: int = 14  # candidates per generation
    spread: float = 0.2  # of the first generation, in parts of the search ranges

    separable: bool = False
    """Learn no correlations. Then the search is the same on every processor, because it needs no eigenvectors, whose
    last digits differ; gains have six digits."""


USUAL = Search()


def tune(
    kind: str,
    config: TaskConfig | Sequence[TaskConfig],
    search: Search = USUAL,
    folder: Path | None = None,
    progress: Callable[[Tuned], None] | None = None,
) -> Tuned:
    """Tune the gains of a kind of :data:`~hydro_agents.controllers.registry.CONTROLLERS`.

    Args:
        kind: the controller.
        config: the task; of several tasks the geometric mean of the costs counts.
        search: how the search goes.
        folder: keeps the costs of every generation, and gives those that it has: an interrupted search goes on
            bit-equal.
        progress: called after every generation with the best candidate so far.

    Raises:
        ConfigurationError: the kind is unknown, or no candidate can control the axis.
    """
    if kind not in CONTROLLERS:
        raise ConfigurationError(f"kind '{kind}': {unknown(kind, CONTROLLERS)}")
    group = CONTROLLERS[kind][1]
    start = search.start or group()
    tasks = [config] if isinstance(config, TaskConfig) else list(config)
    space = Space(group, tasks[0].plant)
    optimiser = _optimiser(space, start, search)
    best = None
    for generation in range(-(-search.evaluations // search.population)):
        points = [optimiser.ask() for _ in range(search.population)]
        gains = [_gains(start, space.values(point), search.separable) for point in points]
        job = Job(costs_of_sets, kind, (gains, tasks, search.cases, search.seed), kind)
        costs = run_here(job, folder)["costs"].tolist()
        optimiser.tell(list(zip(points, costs, strict=True)))
        evaluations = (generation + 1) * search.population
        leader = int(np.argmin(costs))
        leading = gains[leader]
        if leading is not None and (best is None or costs[leader] < best.cost):
            best = Tuned(leading, costs[leader], evaluations)
        if best is not None:
            best = best._replace(evaluations=evaluations)
            if progress is not None:
                progress(best)
    if best is None:
        raise ConfigurationError(f"{kind}: none of {search.evaluations} candidates could control the axis")
    return best


def _optimiser(space: Space, start: Group, search: Search) -> "CMA | SepCMA":
    from cmaes import CMA, SepCMA  # loads scipy.stats

    strategy = SepCMA if search.separable else CMA
    bounds = np.tile([0.0, 1.0], (len(space.names), 1))
    point = space.point(start)
    return strategy(point, search.spread, bounds=bounds, seed=search.seed, population_size=search.population)


def _gains(start: Group, values: Mapping[str, float], rounded: bool) -> Group | None:
    """The gains of a candidate, ``rounded`` to six digits; ``None`` if they are invalid."""
    if rounded:
        values = {name: float(f"{value:.6g}") for name, value in values.items()}
    with suppress(ConfigurationError):
        return validate(type(start), {**start.model_dump(), **values}, "candidate")
    return None


# The costs of candidates ---------------------------------------------------------------------------------------------


def costs_of_sets(
    kind: str, gains: Sequence[Group | None], tasks: Sequence[TaskConfig], cases: int, seed: int
) -> Columns:
    """The ``costs`` of some sets of gains, of several tasks the geometric means; each worker costs a part of the sets.

    A set ``None`` is refused. ``cases`` is their number for each set, beside the resting ones.
    """
    count = min(effective_n_jobs(None), len(gains))
    calls = []
    for part in range(count):
        own = gains[len(gains) * part // count : len(gains) * (part + 1) // count]
        calls.append(delayed(cost_candidates)(kind, own, tasks, cases, seed))
    parts = Parallel(n_jobs=count)(calls)
    # Sums come after all parts are joined: their last bit depends on the number of candidates.
    costs = [np.concatenate(rows) for rows in zip(*parts, strict=True)]
    found = []
    for number, task in enumerate(tasks):
        both = tuning_cases(task, cases, seed + number), resting_cases(seed + number)
        found.append(summed_up(costs[2 * number : 2 * number + 2], both))
    return {"costs": found[0] if len(tasks) == 1 else np.exp(np.log(found).mean(axis=0))}


def cost_candidates(
    kind: str, gains: Sequence[Group | None], tasks: Sequence[TaskConfig], cases: int, seed: int
) -> list[Floats]:
    """Costs of some candidates of a kind, (candidates, cases), on each task: of its cases, and of the resting ones."""
    costs = []
    for number, task in enumerate(tasks):
        controllers = [_controller(kind, one, task) for one in gains]
        still = task_config(task, episode_duration=REST)
        costs.append(costs_of(task, tuning_cases(task, cases, seed + number), controllers))
        costs.append(costs_of(still, resting_cases(seed + number), controllers, JUDGED))
    return costs


def _controller(kind: str, gains: Group | None, config: TaskConfig) -> Controller | None:
    """The controller of a candidate; ``None`` if it cannot be made (an unsolvable Riccati equation, say)."""
    with warnings.catch_warnings(action="ignore"), suppress(Exception):
        return CONTROLLERS[kind][0](gains, config) if gains is not None else None
    return None
