"""Motions that would determine what a recording does not determine.

Each candidate is a voltage over some seconds from rest, in open loop, simulated on the identified rig. The derivatives
of its readings give the information about every unknown, together with the recording.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hydro_env import HydroError, PlantParameters, TaskConfig
from hydro_env.plant.analysis import reachable_range, speed_limits
from hydro_env.plant.arrays import equilibrium
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.estimation.estimate import usable_readings
from hydro_rig.estimation.model import LONG_STEP, Model
from hydro_rig.estimation.solver import Belief, Linearised
from hydro_rig.estimation.unknowns import priors_of, starts_of
from hydro_rig.identification.fit import DETERMINED, Fit

DURATION = 8.0  # s, of each candidate motion

LEAST_GAIN = 0.8
"""A motion is recommended if it lowers the standard deviation to less than this share of the present one."""


class Advice(NamedTuple):
    """The most informative motion for an unknown."""

    motion: str
    remaining: float  # standard deviation after it, as a share of the range's
    enough: bool  # whether the unknown is then determined


def _commands(time: Floats, reach: float, out: float, back: float, hold: float) -> dict[str, Floats]:
    """Commands (T,) of each candidate by name; each returns to its start.

    Args:
        time: (T,), s.
        reach: of the axis from end to end, m.
        out: speed at full opening, m/s.
        back: the same, retracting.
        hold: command that holds the middle position.
    """

    def moves(share: float, travel: float, rest: float) -> Floats:
        """Out and back at a share of the speed, with a rest at either end."""
        slowest = min(out, back)
        duration = travel * reach / (share * slowest)
        phase = np.mod(time, 2.0 * (duration + rest))
        leaves, returns = phase < duration, (phase >= duration + rest) & (phase < 2.0 * duration + rest)
        return np.asarray(hold + share * slowest * (leaves / out - returns / back))

    sweep = np.sin(2.0 * math.pi * (0.5 * time + 0.5 * (15.0 - 0.5) / time[-1] * time**2))
    return {
        "standing still": np.full_like(time, hold),
        "slow moves with reversals (5 % of full speed)": moves(0.05, 0.02, 0.0),
        "moves at half speed with rests of 0.5 s": moves(0.5, 0.2, 0.5),
        "fast moves with reversals (80 % of full speed)": moves(0.8, 0.2, 0.0),
        "full stroke out and back": moves(0.4, 0.7, 0.3),
        "a sine from 0.5 to 15 Hz at 20 % of full command": hold + 0.2 * sweep,
    }


def advise(fit: Fit, config: TaskConfig, plant: PlantParameters) -> dict[str, Advice]:
    """The most informative motion of the identified plant for each undetermined unknown that one helps to determine."""
    wanted = {place: one for place, one in enumerate(fit.unknowns) if not fit.knows(one)}
    if not wanted:
        return {}
    try:
        low, high = reachable_range(plant)
        middle = 0.5 * (low + high)
        state, voltage = equilibrium(plant, middle)
        speeds = speed_limits(plant, plant.load.external_force + plant.load.spring_stiffness * middle)
    except HydroError:
        return {}
    if not min(high - low, speeds.extending, speeds.retracting) > 0.0:
        return {}
    time = config.control_period * np.arange(round(DURATION / config.control_period), dtype=np.float64)
    commands = _commands(time, high - low, speeds.extending, speeds.retracting, voltage / FULL_VOLTAGE)
    # The recording is weighted by its widened intervals.
    widening = fit.widening[:, None] * fit.widening
    present = fit.joint.information.sum(axis=0) / widening
    more = _information(np.clip(list(commands.values()), -1.0, 1.0), fit, config, state, present) / widening
    after = np.sqrt(np.einsum("mii->mi", np.linalg.inv(present + np.eye(len(fit.names)) + more)))
    advice = {}
    for place, one in wanted.items():
        best = int(after[:, place].argmin())
        left = float(after[best, place])
        if left < LEAST_GAIN * one.remaining:
            advice[one.name] = Advice(list(commands)[best], left, left <= DETERMINED)
    return advice


def _information(commands: Floats, fit: Fit, config: TaskConfig, state: dict[str, float], present: Floats) -> Floats:
    """Information of each candidate about the unknowns, (motions, p, p), with an unknown start.

    ``present`` is that of the recording, (p, p): it sets the steps of the differences.
    """
    starts = starts_of(config)
    priors = {one.name: one.prior for one in fit.unknowns} | priors_of(config, starts)
    model = Model(config, priors, commands)
    values = [*fit.own().values(), *(state[name.removeprefix("start.")] for name in starts)]
    scaled = model.scaled(np.tile(values, (len(commands), 1)))
    shared = np.arange(len(fit.names))
    precision = np.tile(np.eye(len(priors)), (len(commands), 1, 1))
    precision[:, shared[:, None], shared] += present
    read, slopes = model.linearise(scaled, model.directions(precision, LONG_STEP))
    measured = read * model.noise[:, None]
    for row, channel in enumerate(SENSORS):  # absent sensors give no information
        if f"{channel}_bias" not in fit.names and config.sensors.enabled:
            measured[:, row] = np.nan
    signals = np.concatenate([measured, commands[:, None]], axis=1)
    known = np.isfinite(usable_readings(signals, config, model))
    jacobian = np.where(known[:, None], slopes, 0.0).reshape(len(commands), len(priors), -1)
    ones = np.ones((len(commands), jacobian.shape[2]))
    belief = Belief.of_priors(model).without(shared)
    return Linearised(0.0 * ones, jacobian, ones, known).equations(scaled, belief, shared).information
