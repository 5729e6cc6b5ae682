"""Initial values of an estimate: start states from the signals where possible."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_env import TaskConfig
from hydro_env.task.sensors import POSITION, PRESSURE_A, PRESSURE_B, SENSORS, SPOOL
from hydro_env.types import Floats
from hydro_rig.estimation.replay import times
from hydro_rig.estimation.unknowns import Prior

_FIRST_SAMPLES = 6  # number of samples for the straight line that gives each start value


def first_values(signals: Floats, config: TaskConfig, priors: Mapping[str, Prior]) -> Floats:
    """First values (B, P) of the unknowns of B windows; the prior's mean where the signals give no information.

    Args:
        signals: (B, channels + 1, T), NaN where a reading is missing.
        config: the task.
        priors: the unknowns by name.
    """
    if config.sensors.differential_pressure:
        signals = two_pressures(signals, config)
    time = times(signals.shape[2], config)
    value, slope = _starts(signals[:, : len(SENSORS)], time)
    seen = {f"start.{channel}": value[:, row] for row, channel in enumerate(SENSORS)}
    seen["start.velocity"] = slope[:, POSITION]
    seen["start.tip_position"], seen["start.tip_velocity"] = seen["start.position"], seen["start.velocity"]
    spool = value[:, SPOOL]  # without a spool sensor, the spool equals its command
    seen["start.spool_position"] = np.where(np.isnan(spool), signals[:, -1, 0], spool)
    first = np.tile([prior.mean for prior in priors.values()], (len(signals), 1))
    for column, name in zip(first.T, priors, strict=True):
        if name in seen:
            column[:] = np.where(np.isfinite(seen[name]), seen[name], column)
    return first


def two_pressures(signals: Floats, config: TaskConfig) -> Floats:
    """The signals with both pressures in place of their difference: with equal edges their sum is the supply's."""
    total, difference = config.plant.supply.pressure + config.plant.supply.tank_pressure, signals[:, PRESSURE_A]
    pair = np.stack([0.5 * (total + difference), 0.5 * (total - difference)], axis=1)
    return np.concatenate([signals[:, :PRESSURE_A], pair, signals[:, PRESSURE_B + 1 :]], axis=1)


def _starts(signals: Floats, time: Floats) -> tuple[Floats, Floats]:
    """Value and slope of each channel at the first sample, (B, channels) each, from a line through a few samples."""
    time, near = time[:_FIRST_SAMPLES], signals[:, :, :_FIRST_SAMPLES]
    weight = np.isfinite(near) * np.ones_like(near)
    reading = np.nan_to_num(near)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = weight.sum(axis=2)
        middle = (weight * time).sum(axis=2) / total
        mean = (weight * reading).sum(axis=2) / total
        away = time - middle[:, :, None]
        slope = (weight * away * reading).sum(axis=2) / (weight * away**2).sum(axis=2)
        return np.where(total >= 2, mean - slope * middle, mean), slope
