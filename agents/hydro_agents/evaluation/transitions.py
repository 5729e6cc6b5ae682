"""Experiments about transitions: a move after a pause, and a controller that takes over an axis in motion.

Both are parts of a robustness protocol; the figures are in the frame of the position sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, Observation
from hydro_agents.evaluation.conditions import Cell, columns_of
from hydro_agents.evaluation.leak_price import full_speed
from hydro_agents.evaluation.participants import Participants, split_name
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.sweeps import Experiment, Run
from hydro_agents.running.cases import Rollout
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.tasks import own_reference, steady
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.types import Floats

# A move after a pause -------------------------------------------------------------------------------------------------

PAUSES = (0.5, 60.0)  # s; the first is that of an axis that has just started
MOVE, MOVE_SPEED = 0.4, 0.75  # s, and largest speed of the move as a share of that at full command: 20 mm by default
STARTED, RESTED = (
    0.3,
    1.0,
)  # s: the start of the move whose largest error counts; the end of the pause whose mean counts


def moves_after_pauses(config: TaskConfig, pauses: tuple[float, ...] = PAUSES) -> Iterator[Run]:
    """One smooth move (quintic) outwards from the middle after pauses of several lengths, with sensor noise.

    Columns: pause_s, peak_um (largest error in the first 0.3 s of the move), mean_um (over the move), rest_um (mean
    error in the last second of the pause), valve_travel_per_s (full strokes, in that second).

    Args:
        config: the task.
        pauses: s.
    """
    period, distance = config.control_period, MOVE_SPEED * full_speed(config.plant, 0.0) * MOVE / 1.875
    for pause in pauses:
        share = np.clip((np.arange(round((pause + MOVE) / period) + 1) * period - pause) / MOVE, 0.0, 1.0)
        path = distance * share**3 * (10.0 + share * (6.0 * share - 15.0))
        yield Run((own_reference(config, path),), partial(_after_pause, pause))


def _after_pause(pause: float, rollout: Rollout) -> dict[str, Any]:
    error, period = _error_um(rollout), float(rollout.time[1] - rollout.time[0])
    first, rested = round(pause / period), round(min(RESTED, pause) / period)
    spool = rollout.spool[:, first - rested : first].astype(np.float64)
    return {
        "pause_s": pause,
        "peak_um": error[:, first : first + round(STARTED / period)].max(axis=1),
        "mean_um": error[:, first:].mean(axis=1),
        "rest_um": error[:, first - rested : first].mean(axis=1),
        "valve_travel_per_s": np.abs(np.diff(spool, axis=1)).sum(axis=1) / (rested * period),
    }


def _error_um(rollout: Rollout) -> Floats:
    """Size of the error in the frame of the position sensor, (N, T), µm."""
    reading = rollout.position.astype(np.float64) + rollout.position_bias[:, None]
    return 1e6 * np.abs(rollout.reference - reading)


# Taking over in motion ------------------------------------------------------------------------------------------------

TAKEN_OVER, JUDGED = 0.75, 0.2  # s: time of the change, and length of the evaluation after it
TAKE_OVER_FAMILIES = ("sine", "ramp")


class _Memory(NamedTuple):
    step: NDArray[np.int64]  # (N,), periods since the start
    first: Any
    second: Any


class TakesOver:
    """A controller that takes over from another one after a number of periods; until then it begins in each period."""

    def __init__(self, first: Controller, second: Controller, periods: int) -> None:
        self.first, self.second, self.periods = first, second, periods

    def predict(
        self, observation: Observation, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], _Memory]:
        """Commands; see :class:`~hydro_agents.controllers.base.Controller`."""
        started = np.ones(len(observation), np.bool_) if state is None else np.asarray(episode_start, np.bool_)
        step = np.zeros(len(observation), np.int64) if state is None else np.where(started, 0, state.step + 1)
        before, after = (None, None) if state is None else (state.first, state.second)
        driving, before = self.first.predict(observation, before, started, deterministic)
        taking, after = self.second.predict(observation, after, step <= self.periods, deterministic)
        return np.where((step < self.periods)[:, None], driving, taking), _Memory(step, before, after)


def motions(config: TaskConfig) -> Iterator[Run]:
    """Drawn sines and ramps, on which a controller may take over.

    Columns: family, largest_um (largest error in the 0.2 s after 0.75 s), handed_over_um (error at 0.75 s).
    """
    for family in TAKE_OVER_FAMILIES:
        task = task_config(steady(config), episode_duration=TAKEN_OVER + JUDGED, references={"weights": {family: 1.0}})
        yield Run((task,), partial(_after_change, family, round(TAKEN_OVER / config.control_period)))


def _after_change(family: str, first: int, rollout: Rollout) -> dict[str, Any]:
    error = _error_um(rollout)
    return {"family": family, "largest_um": error[:, first:].max(axis=1), "handed_over_um": error[:, first - 1]}


# Parts of a protocol --------------------------------------------------------------------------------------------------

PAUSE_EXPERIMENT = Experiment(moves_after_pauses, (0.05, 2.0), plants=12)
TAKE_OVER_EXPERIMENT = Experiment(motions, (0.05, 2.0, 6.0), plants=8)


def _cells(work: Any, protocol: RobustnessProtocol, chosen: Participants) -> Iterator[Cell]:
    """One job per controller; of several training seeds the first one takes part."""
    controllers: dict[str, Controller] = {}
    for name, controller in chosen.controllers.items():
        controllers.setdefault(split_name(name)[0], controller)
    baseline = next(iter(controllers.values()))
    for name, controller in controllers.items():
        job = Job(work, (baseline, controller), (protocol.task,), fingerprint(baseline, controller))
        yield Cell(name, known={"controller": name}, jobs=(job,))


def paused(pair: tuple[Controller, Controller], config: TaskConfig) -> Columns:
    """The moves after pauses under the second of two controllers."""
    return columns_of(PAUSE_EXPERIMENT(config, {"": pair[1]}).drop(columns="controller"))


def taken_over(pair: tuple[Controller, Controller], config: TaskConfig) -> Columns:
    """The second of two controllers takes over from the first, beside itself from the start (never_switched_um)."""
    acting = {
        "alone": pair[1],
        "switched": TakesOver(*pair, periods=round(TAKEN_OVER / config.control_period)),
    }
    table = TAKE_OVER_EXPERIMENT(config, acting)
    alone, switched = (table[table["controller"] == name].reset_index(drop=True) for name in acting)
    return columns_of(switched.assign(never_switched_um=alone["largest_um"]).drop(columns="controller"))


pause, take_over = partial(_cells, paused), partial(_cells, taken_over)
