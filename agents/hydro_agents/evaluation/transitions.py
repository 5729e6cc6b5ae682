"""Experiments about rest and transitions: a held position, a move after a pause, a controller that takes over.

The errors are in the frame of the position sensor.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, Observation
from hydro_agents.evaluation.leak_price import full_speed, working_place
from hydro_agents.evaluation.limit_cycles import kicked, limit_cycles
from hydro_agents.evaluation.sweeps import Run
from hydro_agents.running.cases import Rollout
from hydro_agents.running.tasks import own_reference, steady
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.types import Floats


def _error_um(rollout: Rollout) -> Floats:
    """Size of the error in the frame of the position sensor, (N, T), µm."""
    reading = rollout.position.astype(np.float64) + rollout.position_bias[:, None]
    return 1e6 * np.abs(rollout.reference - reading)


def _travel_per_s(rollout: Rollout, samples: slice, seconds: float) -> Floats:
    """Valve travel in a stretch, (N,), full strokes per second."""
    spool = rollout.spool[:, samples].astype(np.float64)
    return np.asarray(np.abs(np.diff(spool, axis=1)).sum(axis=1) / seconds)


# Standstill under noise -----------------------------------------------------------------------------------------------

STANDSTILL_LEAKS = (0.01, 0.3, 1.0, 4.0, 8.0)  # l/min at 100 bar
PLACES = (0.0, 0.3, -0.3)  # held positions: shares of the range that the supply can hold
KICK, KICK_SHARE = 0.5, 0.01  # s, and size of a step of the reference as a share of that range
REST, HELD = 1.5, 6.0  # s from the start to the evaluation besides, and length of the evaluation


def standstills(config: TaskConfig) -> Iterator[Run]:
    """A held position, once without and once with the noise of the sensors.

    With sensor noise every stiff loop moves a little, and its response to noise looks like a limit cycle. Without
    noise, an axis comes to rest after a small step of the reference unless it oscillates by itself: the remaining
    motion is the limit cycle. The run with noise gives residual motion, valve travel and offset.

    Columns: place_mm, limit_cycle (an oscillation that lasts without noise and exceeds one step of the position
    sensor), amplitude_um and frequency_hz (without noise), unrest_um (root mean square of the position's motion under
    noise), offset_um (mean of |reference − reading|, frame of the sensor), valve_travel_per_s (full strokes), failed.
    """
    duration, step = KICK + REST + HELD, KICK_SHARE * abs(working_place(config.plant, 1.0))
    for place in PLACES:
        position = working_place(config.plant, place)
        resting = kicked(config, position, step, KICK, duration)
        noisy = own_reference(config, np.full(round(duration / config.control_period) + 1, position))
        yield Run((resting, noisy), partial(_unrest, config, position))


def _unrest(config: TaskConfig, position: float, resting: Rollout, noisy: Rollout) -> dict[str, Any]:
    judged = slice(-round(HELD / config.control_period), None)
    held = noisy.position[:, judged].astype(np.float64)
    return {
        "place_mm": 1e3 * position,
        **limit_cycles(resting.position[:, judged], config),
        "unrest_um": 1e6 * held.std(axis=1),
        "offset_um": 1e6 * np.abs(held.mean(axis=1) + noisy.position_bias - position),
        "valve_travel_per_s": _travel_per_s(noisy, judged, HELD),
        "failed": np.maximum(resting.failed_at, noisy.failed_at) >= 0,
    }


# A move after a pause -------------------------------------------------------------------------------------------------

PAUSES = (0.5, 60.0)  # s; the first is that of an axis that has just started
MOVE, MOVE_SPEED = 0.4, 0.75  # s, and largest speed of the move as a share of that at full command: 20 mm by default
STARTED, RESTED = 0.3, 1.0  # s: the start of the move whose largest error counts; the end of the pause


def moves_after_pauses(config: TaskConfig) -> Iterator[Run]:
    """One smooth move (quintic) outwards from the middle after pauses of several lengths, with sensor noise.

    Columns: pause_s, peak_um (largest error in the first 0.3 s of the move), mean_um (over the move), rest_um (mean
    error in the last second of the pause), valve_travel_per_s (full strokes, in that second).
    """
    period, distance = config.control_period, MOVE_SPEED * full_speed(config.plant, 0.0) * MOVE / 1.875
    for pause in PAUSES:
        share = np.clip((np.arange(round((pause + MOVE) / period) + 1) * period - pause) / MOVE, 0.0, 1.0)
        path = distance * share**3 * (10.0 + share * (6.0 * share - 15.0))
        yield Run((own_reference(config, path),), partial(_after_pause, pause))


def _after_pause(pause: float, rollout: Rollout) -> dict[str, Any]:
    error, period = _error_um(rollout), float(rollout.time[1] - rollout.time[0])
    first, rested = round(pause / period), round(min(RESTED, pause) / period)
    before = slice(first - rested, first)
    return {
        "pause_s": pause,
        "peak_um": error[:, first : first + round(STARTED / period)].max(axis=1),
        "mean_um": error[:, first:].mean(axis=1),
        "rest_um": error[:, before].mean(axis=1),
        "valve_travel_per_s": _travel_per_s(rollout, before, rested * period),
    }


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
        count = len(observation)
        if state is None:
            state, episode_start = _Memory(np.zeros(count, np.int64), None, None), np.ones(count, np.bool_)
        step = np.where(episode_start, 0, state.step + 1)
        driving, first = self.first.predict(observation, state.first, episode_start, deterministic)
        taking, second = self.second.predict(observation, state.second, step <= self.periods, deterministic)
        return np.where((step < self.periods)[:, None], driving, taking), _Memory(step, first, second)


def motions(config: TaskConfig) -> Iterator[Run]:
    """Drawn sines and ramps, on which a controller may take over.

    Columns: family, largest_um (largest error in the 0.2 s after 0.75 s), handed_over_um (error at 0.75 s).
    """
    first = round(TAKEN_OVER / config.control_period)
    for family in TAKE_OVER_FAMILIES:
        task = task_config(steady(config), episode_duration=TAKEN_OVER + JUDGED, references={"weights": {family: 1.0}})
        yield Run((task,), partial(_after_change, family, first))


def _after_change(family: str, first: int, rollout: Rollout) -> dict[str, Any]:
    error = _error_um(rollout)
    return {"family": family, "largest_um": error[:, first:].max(axis=1), "handed_over_um": error[:, first - 1]}
