"""A test move: the short move within limits of travel and speed with the lowest bound for a leak."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from cmaes import CMA
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.estimation.information import WORN_VALVE, information, sigma, unknown_sets
from hydro_agents.estimation.known_windows import KnownWindows, known_windows, leak_cases
from hydro_agents.running.seeds import LEARNING
from hydro_agents.running.tasks import own_reference
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.plant.analysis import reachable_range, speed_limits
from hydro_env.plant.parameters import from_vector
from hydro_env.task.configuration import LEAKAGE_LIMIT

Array = NDArray[np.float64]

STROKES = 4  # the last one returns to the start
LEAST_SPEED = 0.1  # smallest speed of a stroke, as a share of the largest
LEAST_HOLD = 0.02  # smallest share of the time at rest for each hold, before normalisation to a sum of 1
_IMPOSSIBLE = 1e3  # cost of a move that is too long or fails; far above the logarithm of any standard deviation


class MoveSettings(Group):
    """Limits of the move, and the size of the search."""

    duration: float = Field(2.0, ge=0.2, le=60.0, description="s")
    travel: float | None = Field(
        None, gt=0.0, le=10.0, description="m, between the outermost positions; default: the task's largest step"
    )
    speed: float | None = Field(None, gt=0.0, le=100.0, description="m/s; default: that of the task's references")
    leak: float = Field(0.3, ge=0.0, le=LEAKAGE_LIMIT, description="l/min at 100 bar, for which the move is designed")
    plants: int = Field(6, ge=2, le=1000, description="of the training seeds")
    evaluations: int = Field(240, ge=1, le=1_000_000, description="number of moves that the search tries")
    seed: int = Field(0, ge=0, le=2**32 - 1, description="of the search")


class Limits(NamedTuple):
    """Limits of a move, SI."""

    low: float  # m, lowest position that every plant reaches
    high: float  # m
    travel: float  # m
    speed: float  # m/s
    acceleration: float  # m/s²
    duration: float  # s


class Stroke(NamedTuple):
    """A hold, and the smooth stroke that follows it."""

    hold: float  # s
    start: float  # m
    end: float  # m
    duration: float  # s


class Move(NamedTuple):
    """Strokes with a hold before each, and a hold at the end."""

    strokes: tuple[Stroke, ...]
    last_hold: float  # s

    @property
    def duration(self) -> float:
        """s"""
        return sum(one.hold + one.duration for one in self.strokes) + self.last_hold

    def reference(self, period: float) -> Array:
        """Positions in m, one per control period from 0 to the end; quintic strokes, at rest at both ends."""
        time = period * np.arange(round(self.duration / period) + 1)
        result, begin = np.full(len(time), self.strokes[0].start), 0.0
        for stroke in self.strokes:
            begin += stroke.hold
            share = np.clip((time - begin) / max(stroke.duration, 1e-9), 0.0, 1.0)
            smooth = share**3 * (10.0 + share * (6.0 * share - 15.0))
            result += (stroke.end - stroke.start) * smooth
            begin += stroke.duration
        return result


def limits_of(config: TaskConfig, settings: MoveSettings) -> Limits:
    """Limits of the move on the plants of the task.

    The nominal plant and every plant of the design reach the positions with the share of the task's references.

    Raises:
        ConfigurationError: travel or speed is beyond the rig.
    """
    share = config.references.range_share
    largest = config.references.largest_amplitude
    plants = [config.plant, *(from_vector(vector) for vector in _plants(config, settings))]
    ranges = np.array([reachable_range(plant) for plant in plants]) * share
    low, high = max(ranges[:, 0].max(), -largest), min(ranges[:, 1].min(), largest)
    fastest = config.references.speed_share * min(speed_limits(config.plant, config.plant.load.external_force))
    travel = settings.travel if settings.travel is not None else min(config.references.step_range[1], high - low)
    speed = settings.speed if settings.speed is not None else fastest
    if not 0.0 < travel <= high - low:
        raise ConfigurationError(
            f"--travel {1e3 * travel:g} mm: must be above 0 and at most {1e3 * (high - low):.3g} mm: the plants reach "
            f"{1e3 * low:.3g} to {1e3 * high:.3g} mm"
        )
    if speed > fastest:
        raise ConfigurationError(
            f"--speed {1e3 * speed:g} mm/s: must be at most {1e3 * fastest:.3g} mm/s, "
            f"{config.references.speed_share:.0%} of the rig's speed"
        )
    return Limits(low, high, travel, speed, config.references.acceleration_limit, settings.duration)


def move_from(numbers: Array, limits: Limits) -> Move | None:
    """The move of a vector of numbers from 0 to 1; ``None`` if its strokes take longer than the duration.

    The numbers are: place of the travel, start and ends of the strokes within it, speed of each stroke, share of each
    hold.
    """
    place, targets, speeds, holds = np.split(numbers, [1, 1 + STROKES, 1 + 2 * STROKES])
    lowest = limits.low + place[0] * (limits.high - limits.low - limits.travel)
    points = lowest + limits.travel * np.append(targets, targets[0])
    distance = np.abs(np.diff(points))
    speed = limits.speed * (LEAST_SPEED + (1.0 - LEAST_SPEED) * speeds)
    # The quintic's peaks: 1.875 distance/duration and 5.774 distance/duration².
    durations = np.maximum(1.875 * distance / speed, np.sqrt(5.774 * distance / limits.acceleration))
    rest = limits.duration - durations.sum()
    if rest < 0.0:
        return None
    waits = rest * (holds + LEAST_HOLD) / (holds + LEAST_HOLD).sum()
    strokes = [Stroke(*map(float, row)) for row in zip(waits[:-1], points[:-1], points[1:], durations, strict=True)]
    return Move(tuple(strokes), float(waits[-1]))


NUMBERS = 2 + 3 * STROKES
"""Length of the vector of a move: one place, one start and one speed per stroke, and one more hold."""


class Design(NamedTuple):
    """The best move found."""

    move: Move
    bound: float  # l/min; geometric mean of the bound over the plants of the design
    first_bound: float  # of the search's first move: once there and back at mid-range; NaN if impossible


def design(
    config: TaskConfig,
    controller: Controller,
    settings: MoveSettings,
    progress: Callable[[str, int, int], None] | None = None,
) -> Design:
    """Find the move with the lowest bound of the leak by CMA-ES (Hansen & Ostermeier 2001; package ``cmaes``).

    The cost is the mean of the logarithm of the bound over plants of the training seeds; the unknowns include a worn
    valve.

    Args:
        config: the task.
        controller: follows the move.
        settings: limits and size of the search.
        progress: called with the phase, the number of moves tried, and their total.

    Raises:
        ConfigurationError: the limits are impossible, or no move fits them.
    """
    limits = limits_of(config, settings)
    unknowns = unknown_sets(config)
    worn = unknowns.sets[WORN_VALVE]
    priors = {name: unknowns.priors[name] for name in worn.unknowns}

    def cost(numbers: Array) -> float:
        move = move_from(numbers, limits)
        if move is None:
            return _IMPOSSIBLE
        windows = moved(config, controller, move, LEARNING.take(settings.plants), settings.plants, settings.leak)
        if windows.count < settings.plants:
            return _IMPOSSIBLE
        return float(np.log(sigma(information(config, windows, priors), widths=worn.widths)[:, -1]).mean())

    there_and_back = (np.arange(STROKES) == 1) | (np.arange(STROKES) == 2)
    first = np.concatenate([[0.5], there_and_back, np.ones(STROKES), np.full(STROKES + 1, 0.5)])
    if progress is not None:
        progress("design", 0, settings.evaluations)
    best, lowest = first, cost(first)
    begun = lowest
    optimiser = CMA(np.clip(first, 0.15, 0.85), 0.25, np.tile([0.0, 1.0], (NUMBERS, 1)), seed=settings.seed)
    tried = 1
    while tried < settings.evaluations:
        answers = []
        for _ in range(optimiser.population_size):
            numbers = optimiser.ask()
            answers.append((numbers, cost(numbers)))
        optimiser.tell(answers)
        tried += len(answers)
        numbers, value = min(answers, key=lambda answer: answer[1])
        if value < lowest:
            best, lowest = numbers, value
        if progress is not None:
            progress("design", min(tried, settings.evaluations), settings.evaluations)
    move = move_from(best, limits)
    if move is None or lowest >= _IMPOSSIBLE:
        raise ConfigurationError(
            f"--duration {settings.duration:g} s: no move with this travel and speed is short enough for every plant; "
            "lower --travel, or raise --speed or --duration"
        )
    return Design(move, math.exp(lowest), math.exp(begun) if begun < _IMPOSSIBLE else math.nan)


def moved(
    config: TaskConfig, controller: Controller, move: Move, seeds: range, plants: int, leak: float
) -> KnownWindows:
    """The first plants of some seeds with a leak (l/min at 100 bar) while they follow the move."""
    task = own_reference(config, move.reference(config.control_period))
    return known_windows(task, controller, leak_cases(seeds, plants, leak), 0.0, move.duration)


def _plants(config: TaskConfig, settings: MoveSettings) -> Array:
    """Parameters of the plants of the design, (plants, parameters)."""
    from hydro_env import ServoHydraulicVectorEnv

    env = ServoHydraulicVectorEnv(settings.plants, config, info=False)
    env.reset(seed=list(LEARNING.take(settings.plants)))
    physical = env.axes.physical.copy()
    env.close()
    return physical
