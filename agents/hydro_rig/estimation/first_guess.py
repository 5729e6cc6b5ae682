"""Initial values of an estimate: start states, supply, spring and external force, from the signals where possible."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_env import TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.sensors import POSITION, PRESSURE_A, PRESSURE_B, SENSORS, SPOOL
from hydro_env.types import Floats
from hydro_rig.estimation.replay import times
from hydro_rig.estimation.unknowns import STARTS, Prior

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
    seen["supply.pressure"] = seen["start.supply_pressure"] = supply_pressure(signals, config)
    stiffness, force = _spring_and_force(signals, time, config, "load.external_force" in priors)
    seen["load.spring_stiffness"], seen["load.external_force"] = stiffness, force
    first = np.tile([prior.mean for prior in priors.values()], (len(signals), 1))
    for column, (name, prior) in zip(first.T, priors.items(), strict=True):
        if name in seen:
            near = seen[name]
            if name not in STARTS:  # within three standard deviations
                near = np.clip(near, *prior.value(np.array([-3.0, 3.0])))
            column[:] = np.where(np.isfinite(near), near, column)
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


def supply_pressure(signals: Floats, config: TaskConfig) -> Floats:
    """Supply pressure (B,), Pa: with equal edges and without flow through the valve, it equals p_a + p_b − p_T."""
    sums, opening = signals[:, PRESSURE_A] + signals[:, PRESSURE_B], np.abs(signals[:, SPOOL])
    opening = np.where(np.isfinite(opening), opening, np.abs(signals[:, -1]))
    result = np.full(len(signals), np.nan)
    for window, (total, width) in enumerate(zip(sums, opening, strict=True)):
        known = np.isfinite(total)
        if known.any():
            result[window] = np.median(total[known & (width <= np.quantile(width[known], 0.25))])
    return result - config.plant.supply.tank_pressure


def _spring_and_force(signals: Floats, time: Floats, config: TaskConfig, with_force: bool) -> tuple[Floats, Floats]:
    """Spring stiffness (N/m) and external force (N), (B,) each, by least squares on the balance of forces.

    p_a A_a − p_b A_b = k x + F + (friction with the sign of the speed) + c v + m dv/dt.
    """
    c = plant_coefficients(config.plant)
    stiffness, force = np.full(len(signals), np.nan), np.full(len(signals), np.nan)
    for window, (position, pressure_a, pressure_b, *_) in enumerate(signals):
        load = pressure_a * c.area_a - pressure_b * c.area_b
        known = np.isfinite(position) & np.isfinite(load)
        if known.sum() < 20:
            continue
        place, balance, when = position[known], load[known], time[known]
        speed = np.gradient(np.convolve(np.pad(place, 2, "edge"), np.full(5, 0.2), "valid"), when)
        columns = [place, np.tanh(speed / 0.003), speed, np.gradient(speed, when)]
        if with_force:
            columns.append(np.ones_like(place))
        answer, _, _, singular = np.linalg.lstsq(np.column_stack(columns), balance, rcond=None)
        if place.std() > 1e-3 and singular[-1] > 0.0:
            stiffness[window] = answer[0]
            force[window] = answer[-1] if with_force else np.nan
    return stiffness, force
