"""Tunes the gains of any classical controller by CMA-ES on training plants with all leak levels and families.

Source: Hansen & Ostermeier, *Completely derandomized self-adaptation in evolution strategies*, Evolutionary Computation
9(2), 2001; the package ``cmaes``. Every kind gets the same optimiser, budget and training cases.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from cmaes import CMA, SepCMA
from joblib import effective_n_jobs

from hydro_agents.controllers.base import Controller, search_space
from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.registry import CONTROLLERS
from hydro_agents.learning.stable_gain import pids_from_figures
from hydro_agents.learning.trials import JUDGED, REST, Score, costs_of, over_tasks, resting_cases, scored, tuning_cases
from hydro_agents.running.cases import Cases
from hydro_agents.running.folders import config_folder
from hydro_agents.running.jobs import Columns, Job, run_jobs
from hydro_agents.running.limit_cycles import counted_at_rest
from hydro_agents.running.seeds import STANDSTILLS
from hydro_env import ConfigurationError, PlantParameters, TaskConfig
from hydro_env.files import Group, read_text, read_yaml, validate, write_text
from hydro_env.mistakes import unknown
from hydro_env.task.configuration import task_config
from hydro_env.types import Floats

Objective = Literal["mean", "equal"]
GainsFor = Callable[[str, TaskConfig], Group]  # of a kind and a task

POPULATION = 14  # number of candidates per generation
EVALUATIONS = 2800
_SIGMA = 0.2
CLEARLY = 0.9  # of the first set's error, for another set to be chosen; few cases favour some set by chance
CHOICE_CASES = 14  # of each set in :func:`chosen_gains`, beside the resting ones
NEARBY = 56  # candidates of :func:`searched_gains`
NEAR = {"pid": 0.05, "flow_linearising": 0.1}  # their first spread in parts of the search ranges
SEARCH_CASES = 42  # of each of these candidates
TRIALS = (1, 2, 3, 4)  # seeds of the other cases that decide in the end
TRIAL_CASES = 84  # of each seed: many, because few plants swing
RESTS = 96  # standstills
PER_LIMIT_CYCLE = {"pid": 15.0, "flow_linearising": 1.5}
"""What a limit cycle at all of them adds to the logarithm of the error; that of a PID is millimetres large."""


class Space:
    """The search space of a class of gains as a unit cube; fields with ``logarithmic`` have a logarithmic scale."""

    def __init__(self, gains: type[Group], plant: PlantParameters) -> None:
        space = search_space(gains, plant)
        self.names = tuple(space)
        ends = np.array([(low, high) for low, high, _ in space.values()])
        self._logarithmic = np.array([logarithmic for _, _, logarithmic in space.values()])
        scaled = self._scaled(ends.T)
        self._low, self._width = scaled[0], scaled[1] - scaled[0]

    def _scaled(self, values: Floats) -> Floats:
        return np.where(self._logarithmic, np.log(np.where(self._logarithmic, values, 1.0)), values)

    def point(self, gains: Group) -> Floats:
        """Gains as a point of the cube, (n,); a gain outside its search range is clipped to it."""
        values = np.array([float(getattr(gains, name)) for name in self.names])
        tiny = np.exp(self._low)
        scaled = self._scaled(np.where(self._logarithmic, np.maximum(values, tiny), values))
        point: Floats = np.clip((scaled - self._low) / self._width, 0.0, 1.0)
        return point

    def values(self, point: Floats) -> dict[str, float]:
        """The gains at a point of the cube, by name."""
        scaled = self._low + self._width * np.clip(point, 0.0, 1.0)
        values = np.where(self._logarithmic, np.exp(np.where(self._logarithmic, scaled, 0.0)), scaled)
        return dict(zip(self.names, values.tolist(), strict=True))


class Tuned(NamedTuple):
    """The best candidate so far."""

    gains: Group
    score: Score
    evaluations: int


def tune(
    kind: str,
    config: TaskConfig | Sequence[TaskConfig],
    objective: Objective = "equal",
    evaluations: int = EVALUATIONS,
    seed: int = 0,
    cases: int = 42,
    start: Group | None = None,
    log: Path | None = None,
    resume: bool = False,
    progress: Callable[[Tuned], None] | None = None,
    population: int = POPULATION,
    spread: float = _SIGMA,
    separable: bool = False,
) -> Tuned:
    """Tune the gains of a kind of :data:`~hydro_agents.controllers.registry.CONTROLLERS`.

    Args:
        kind: the controller.
        config: the task; of several tasks the geometric mean of the scores counts.
        objective: ``mean`` (mean absolute error) or ``equal`` (geometric mean over the families); see :class:`Score`.
        evaluations: total number of candidates, rounded up to whole generations.
        seed: of the optimiser and of the training cases.
        cases: training cases of each candidate; a multiple of leak levels × families gives each the same number.
        start: gains from which the search starts; their class's defaults by default. Fields that are not searched keep
            these values.
        log: CSV file with the costs of every generation. It is also the checkpoint.
        resume: continue from ``log``; the result is bit-equal to that of an uninterrupted run.
        progress: called after every generation with the best candidate so far.
        population: candidates per generation.
        spread: of the first generation, in parts of the search ranges.
        separable: learn no correlations. Then the search is the same on every processor, because it needs no
            eigenvectors, whose last digits differ; gains have six digits.

    Raises:
        ConfigurationError: the kind is unknown, or the log is damaged or was written with other settings.
    """
    if kind not in CONTROLLERS:
        raise ConfigurationError(f"kind '{kind}': {unknown(kind, CONTROLLERS)}")
    group = CONTROLLERS[kind][1]
    tasks = [config] if isinstance(config, TaskConfig) else list(config)
    space, base = Space(group, tasks[0].plant), start or group()
    described = [task.model_dump(mode="json") for task in tasks]
    settings = {
        "kind": kind,
        "objective": objective,
        "seed": seed,
        "cases": cases,
        "population": population,
        "start": base.model_dump(mode="json"),
        "task": described[0] if len(tasks) == 1 else hashlib.sha256(json.dumps(described).encode()).hexdigest(),
    }
    rows = _read(log, settings) if log is not None and resume else []
    resumed = len(rows)
    bounds = np.tile([0.0, 1.0], (len(space.names), 1))
    strategy = SepCMA if separable else CMA
    optimiser = strategy(space.point(base), spread, bounds=bounds, seed=seed, population_size=population)
    best: Tuned | None = None
    generations = -(-evaluations // population)
    for generation in range(generations):
        points = [optimiser.ask() for _ in range(population)]
        found = [space.values(point) for point in points]
        if separable:
            found = [{name: float(f"{value:.6g}") for name, value in values.items()} for values in found]
        gains = [_gains(group, {**base.model_dump(), **values}) for values in found]
        known = generation < len(rows)
        if not known:
            rows.append(_costed(kind, gains, tasks, cases, seed, generation > resumed))
        scores = rows[generation]
        costs = [getattr(score, objective) for score in scores]
        leader = int(np.argmin(costs))
        leading = gains[leader]
        if leading is not None and (best is None or costs[leader] < getattr(best.score, objective)):
            best = Tuned(leading, scores[leader], 0)
        optimiser.tell(list(zip(points, costs, strict=True)))
        if log is not None and not known:
            _write(log, settings, rows)
        if best is not None and progress is not None and not known:
            progress(best._replace(evaluations=(generation + 1) * population))
    if best is None:
        raise ConfigurationError(f"{kind}: none of {generations * population} candidates could control the axis")
    return best._replace(evaluations=generations * population)


def gain_sets(kind: str, config: TaskConfig) -> list[Group]:
    """Sets of gains that may serve the rig of a task; the first is preferred.

    Those of a PID follow from the figures of the rig. Of another kind they serve different rigs: the default of the
    class, and what ships beside it.

    Raises:
        ConfigurationError: no PID follows from the figures.
    """
    if kind == "pid":
        if (key := repr(config)) not in _PIDS:
            _PIDS[key] = pids_from_figures(config)
        return [*_PIDS[key]]
    group = CONTROLLERS[kind][1]
    file = config_folder() / "agents" / f"{kind}_sets.yaml"
    others = read_yaml(file)["sets"] if file.is_file() else []
    return [group(), *(validate(group, values, str(file)) for values in others)]


def chosen_gains(kind: str, config: TaskConfig) -> Group:
    """The set of :func:`gain_sets` that controls the simulated rig of the task best, if clearly so; it takes seconds.

    The simulation knows the rig's file alone: its plants, leaks and references are those of a training.
    """
    key = kind, repr(config)
    if key not in _CHOSEN:
        sets = gain_sets(kind, config)
        errors = [score.equal for score in rig_scores(kind, sets, config)] if len(sets) > 1 else [1.0]
        clearly = min(errors) < CLEARLY * errors[0]
        _CHOSEN[key] = sets[int(np.argmin(errors)) if clearly else 0]
    return _CHOSEN[key]


def searched_gains(kind: str, config: TaskConfig) -> Group:
    """Gains from a short search around :func:`chosen_gains`; it takes about a minute.

    Fresh cases decide between the best candidate of each generation, the choice and the first set: a search favours
    what some cases happen to like. Limit cycles at rest count against each. Like the choice it knows the rig's file
    alone.
    """
    key = kind, repr(config)
    if key not in _SEARCHED:
        print(f"hydro: {kind}: a simulation of the rig searches gains; about a minute", file=sys.stderr)
        found = [gain_sets(kind, config)[0], chosen := chosen_gains(kind, config)]

        def progress(best: Tuned) -> None:
            found.append(best.gains)

        tune(
            kind,
            config,
            evaluations=NEARBY,
            cases=SEARCH_CASES,
            start=chosen,
            spread=NEAR[kind],
            separable=True,
            progress=progress,
        )
        leaders = list(dict.fromkeys(found))  # a generation without a better candidate repeats the last one
        trials = [_costed(kind, leaders, [config], TRIAL_CASES, seed, False) for seed in TRIALS]
        errors = np.log([[score.equal for score in trial] for trial in trials]).mean(axis=0)
        controllers = [CONTROLLERS[kind][0](gains, config) for gains in leaders]
        rests = [counted_at_rest(controller, config, STANDSTILLS, RESTS) for controller in controllers]
        errors += PER_LIMIT_CYCLE[kind] * np.array([counts["limit_cycles"] for counts in rests]) / RESTS
        _SEARCHED[key] = leaders[int(np.argmin(errors))]
    return _SEARCHED[key]


def rig_scores(kind: str, sets: Sequence[Group], config: TaskConfig) -> list[Score]:
    """Scores of some sets of gains on the rig of a task."""
    return _costed(kind, sets, [config], CHOICE_CASES, 0, False)


_PIDS: dict[str, list[PIDGains]] = {}
_CHOSEN: dict[tuple[str, str], Group] = {}
_SEARCHED: dict[tuple[str, str], Group] = {}


def _costed(
    kind: str, gains: Sequence[Group | None], tasks: Sequence[TaskConfig], cases: int, seed: int, at_once: bool
) -> list[Score]:
    """The scores of a generation; each job costs a part of the candidates."""
    count = min(effective_n_jobs(None), len(gains))
    bounds = [len(gains) * part // count for part in range(count + 1)]
    jobs = {
        str(begin): Job(cost_candidates, None, (kind, list(gains[begin:end]), list(tasks), cases, seed))
        for begin, end in itertools.pairwise(bounds)
    }
    results, _ = run_jobs(jobs, None, None, None, at_once and count > 1)
    for result in results.values():
        if result.error:
            raise ConfigurationError(result.error)
    # Sums come after all parts are joined: their last bit depends on the number of candidates.
    costs = {name: np.concatenate([results[key].metrics[name] for key in jobs]) for name in results["0"].metrics}
    scores = []
    for number, task in enumerate(tasks):
        scores.append(scored([costs[f"{number}"], costs[f"{number} rest"]], _cases(task, cases, seed + number)))
    return over_tasks(scores)


def _cases(task: TaskConfig, count: int, seed: int) -> tuple[Cases, Cases]:
    return tuning_cases(task, count, seed), resting_cases(seed)


def cost_candidates(
    _: None, kind: str, gains: Sequence[Group | None], tasks: Sequence[TaskConfig], cases: int, seed: int
) -> Columns:
    """Costs of some candidates of a kind, (candidates, cases): ``0`` and ``0 rest`` of the first task, ``1``, …

    A candidate that is ``None`` is refused.
    """
    costs: Columns = {}
    for number, task in enumerate(tasks):
        moving, resting = _cases(task, cases, seed + number)
        controllers = [_controller(kind, one, task) for one in gains]
        costs[f"{number}"] = costs_of(task, moving, controllers)
        costs[f"{number} rest"] = costs_of(task_config(task, episode_duration=REST), resting, controllers, JUDGED)
    return costs


def _gains(group: type[Group], values: Mapping[str, Any]) -> Group | None:
    """The gains of a candidate; ``None`` if they are invalid."""
    with suppress(ConfigurationError):
        return validate(group, values, "candidate")
    return None


def _controller(kind: str, gains: Group | None, config: TaskConfig) -> Controller | None:
    """The controller of a candidate; ``None`` if it cannot be made (an unsolvable Riccati equation, say)."""
    with warnings.catch_warnings(action="ignore"), suppress(Exception):
        return CONTROLLERS[kind][0](gains, config) if gains is not None else None
    return None


# The log ------------------------------------------------------------------------------------------------------------


def _write(log: Path, settings: Mapping[str, Any], rows: Sequence[Sequence[Score]]) -> None:
    lines = [f"# {json.dumps(settings)}", "generation,candidate,mean,equal"]
    for generation, costed in enumerate(rows):
        lines += [f"{generation},{number},{score.mean!r},{score.equal!r}" for number, score in enumerate(costed)]
    write_text(log, "\n".join([*lines, ""]))


def _read(log: Path, settings: Mapping[str, Any]) -> list[list[Score]]:
    """The generations of a log.

    Raises:
        ConfigurationError: the log is damaged or belongs to other settings.
    """
    try:
        first, _, *lines = read_text(log).splitlines()
        written = json.loads(first.removeprefix("# "))
        if not isinstance(written, dict):
            raise ValueError("its first line holds no settings")
        for name, value in json.loads(json.dumps(settings)).items():
            if written.get(name) != value:
                raise ConfigurationError(f"{log}: was written with another {name}; --overwrite begins anew")
        rows = np.loadtxt(lines, delimiter=",", ndmin=2).reshape(-1, settings["population"], 4)
        if not np.array_equal(rows[..., :2], np.moveaxis(np.indices(rows.shape[:2]), 0, -1)):
            raise ValueError("a row is out of order")
    except ConfigurationError:
        raise
    except ValueError as error:
        raise ConfigurationError(f"{log}: is damaged ({error}); --overwrite begins anew") from None
    return [[Score(*pair) for pair in generation] for generation in rows[..., 2:].tolist()]
