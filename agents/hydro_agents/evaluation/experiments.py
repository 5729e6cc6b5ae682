"""Experiments about the task alone, as parts of a robustness protocol: stiffness, rest under noise.

Each is a list of steps: a controller on the same plants at several leaks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.conditions import Cell, columns_of
from hydro_agents.evaluation.participants import Participants, split_name
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.running.tasks import noiseless, own_reference
from hydro_env import PlantParameters, TaskConfig
from hydro_env.plant.analysis import force_limits, reachable_range
from hydro_env.task.configuration import task_config

LEAKS = (0.01, 1.0, 4.0)  # l/min at 100 bar: a tight seal, the bound between moderate and severe, a severe leak

PLACE = 0.3
"""Working position: share of the range that the supply of the nominal rig can hold, outwards from mid-stroke.

There a spring pushes against the piston; its pressure difference drives the leak.
"""


def working_place(plant: PlantParameters, share: float = PLACE) -> float:
    """Position in m at a share (−1 to 1) of the range that the supply of the nominal rig can hold."""
    low, high = reachable_range(plant)
    return share * high if share > 0.0 else -share * low


Play = Callable[[TaskConfig], Rollout]
"""Runs the controller of an experiment in a task."""


class Experiment(NamedTuple):
    """An experiment with a controller in the loop, on the same plants at every leak."""

    steps: Callable[[TaskConfig, Play], Iterable[Mapping[str, Any]]]  # columns of each step, each (N,) or one value
    leaks: Sequence[float] = LEAKS  # l/min at 100 bar
    plants: int = 4

    def __call__(self, config: TaskConfig, controller: Controller) -> pd.DataFrame:
        """Run the controller on the same plants at every leak.

        Args:
            config: the task, for its plants, sensors and timing.
            controller: the controller.

        Returns:
            One row per step, leak and plant: leakage_flow_lpm, seed, and the columns of the experiment.

        Raises:
            ControllerError: the controller raises an exception or returns no finite commands.
        """
        seeds, leaks = EXPERIMENT_AXES.take(self.plants), np.repeat(self.leaks, self.plants)
        cases = Cases(np.tile(seeds, len(self.leaks)), leaks)

        def play(task: TaskConfig) -> Rollout:
            return run_cases(task, controller, cases)

        known = {"leakage_flow_lpm": leaks, "seed": cases.seeds}
        return pd.concat([pd.DataFrame({**known, **step}) for step in self.steps(config, play)], ignore_index=True)


# Stiffness ------------------------------------------------------------------------------------------------------------

FORCE_SHARE = 0.2  # amplitude of the force as a share of the force that the supply of the nominal rig gives

BEFORE, AFTER, JUDGED = 1.0, 2.0, 0.5
"""s: time before the force step, time after it, and last part of each, over which the position is averaged."""

RECOVERED = 0.1  # recovery band as a share of the peak deviation; at least one step of the position sensor


def sudden_force(config: TaskConfig, play: Play) -> Iterator[dict[str, Any]]:
    """A sudden external force of drawn sign on an axis at rest, without sensor noise, which would hide the recovery.

    Columns: force_n, peak_mm (largest deviation), recovery_s (until the deviation stays within a tenth of the peak
    about its final value; NaN if not by the end, as in a limit cycle), remaining_mm (deviation at the end, absolute),
    static_mm_per_kn and dynamic_mm_per_kn (remaining and largest deviation per force).
    """
    newtons, begin = FORCE_SHARE * min(force_limits(config.plant)), BEFORE / (BEFORE + AFTER)
    task = _with_force(noiseless(config), newtons, BEFORE + AFTER, kind="step", start_range=(begin, begin))
    period = config.control_period
    first, judged = round(BEFORE / period), round(JUDGED / period)
    position = play(task).position.astype(np.float64)
    deviation = position - position[:, first - judged : first].mean(axis=1, keepdims=True)
    peak, remaining = np.abs(deviation[:, first:]).max(axis=1), deviation[:, -judged:].mean(axis=1)
    band = np.maximum(RECOVERED * peak, config.sensors.position.resolution)
    outside = np.abs(deviation[:, first:] - remaining[:, None]) > band[:, None]
    recovered = outside.shape[1] - np.argmax(outside[:, ::-1], axis=1)  # samples until the last one outside
    lasting = outside[:, -judged:].any(axis=1)
    yield {
        "force_n": newtons,
        "peak_mm": 1e3 * peak,
        "recovery_s": np.where(lasting, np.nan, period * np.where(outside.any(axis=1), recovered, 0)),
        "remaining_mm": 1e3 * np.abs(remaining),
        "static_mm_per_kn": 1e6 * np.abs(remaining) / newtons,
        "dynamic_mm_per_kn": 1e6 * peak / newtons,
    }


def _with_force(config: TaskConfig, newtons: float, duration: float, **disturbance: Any) -> TaskConfig:
    """The task of holding the working position for some time (s) against an external force (N)."""
    force = {"force_range": (newtons, newtons), "force_share": (0.0, 0.0), **disturbance}
    return task_config(_holding(config, working_place(config.plant), duration), disturbance=force)


# Standstill under noise -----------------------------------------------------------------------------------------------

STANDSTILL_LEAKS = (0.01, 0.3, 1.0, 4.0, 8.0)  # l/min at 100 bar
PLACES = (0.0, 0.3, -0.3)  # held positions: shares of the range that the supply can hold
REST, HELD = 2.0, 6.0  # s from the start to the evaluation, and length of the evaluation


def standstills(config: TaskConfig, play: Play) -> Iterator[dict[str, Any]]:
    """A held position with the noise of the sensors.

    Columns: place_mm, unrest_um (root mean square of the position's motion), offset_um (mean of |reference − reading|,
    frame of the sensor), valve_travel_per_s (full strokes), failed.
    """
    judged = slice(-round(HELD / config.control_period), None)
    for place in PLACES:
        position = working_place(config.plant, place)
        rollout = play(_holding(config, position, REST + HELD))
        held, spool = (values[:, judged].astype(np.float64) for values in (rollout.position, rollout.spool))
        yield {
            "place_mm": 1e3 * position,
            "unrest_um": 1e6 * held.std(axis=1),
            "offset_um": 1e6 * np.abs(held.mean(axis=1) + rollout.position_bias - position),
            "valve_travel_per_s": np.abs(np.diff(spool, axis=1)).sum(axis=1) / HELD,
            "failed": rollout.failed_at >= 0,
        }


def _holding(config: TaskConfig, position: float, seconds: float) -> TaskConfig:
    """The task of holding a position (m)."""
    return own_reference(config, np.full(round(seconds / config.control_period) + 1, position))


# Parts of a protocol --------------------------------------------------------------------------------------------------

EXPERIMENTS = {
    "force_step": Experiment(sudden_force, plants=8),
    "hold": Experiment(standstills, STANDSTILL_LEAKS, plants=8),
}
"""Experiments by the names of their parts."""


def _cells(experiment: str, protocol: RobustnessProtocol, chosen: Participants) -> Iterator[Cell]:
    """An experiment on every controller of a protocol; of several training seeds the first takes part."""
    controllers: dict[str, Controller] = {}
    for name, controller in chosen.controllers.items():
        controllers.setdefault(split_name(name)[0], controller)
    for name, controller in controllers.items():
        job = Job(measured, controller, (protocol.task, experiment), fingerprint(controller))
        yield Cell(name, known={"controller": name}, jobs=(job,))


def measured(controller: Controller, config: TaskConfig, experiment: str) -> Columns:
    """The table of an experiment on a controller.

    Raises:
        ControllerError: the controller raises an exception or returns no finite commands.
    """
    return columns_of(EXPERIMENTS[experiment](config, controller))


force_step, hold = (partial(_cells, name) for name in EXPERIMENTS)
