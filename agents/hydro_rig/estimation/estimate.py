"""Estimates the unknowns of recorded windows: values, uncertainty, and whether the model explains the readings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hydro_env import ConfigurationError, TaskConfig
from hydro_env.task.sensors import POSITION, PRESSURE_A, PRESSURE_B, SENSORS, SPOOL
from hydro_env.types import Floats
from hydro_rig.estimation.model import Model
from hydro_rig.estimation.result import Estimate, join
from hydro_rig.estimation.search import EstimationSettings, search
from hydro_rig.estimation.solver import Problem
from hydro_rig.estimation.unknowns import Prior, priors_of

SAMPLES_PER_BATCH = 25_600  # largest number of samples, over all windows, in one fit; more would only need more memory
_FIRST_SAMPLES = 6  # number of samples for the straight line that gives each start value


def estimate(
    signals: Floats,
    config: TaskConfig,
    unknowns: Sequence[str] | None = None,
    *,
    priors: Mapping[str, Prior] | None = None,
    physical: Floats | None = None,
    first: Mapping[str, Floats | float] | None = None,
    settings: EstimationSettings | None = None,
    boundary: Floats | None = None,
) -> Estimate:
    """Estimate the unknowns of measured windows: maximum a posteriori, with the simulator as model.

    Args:
        signals: (B, 5, T) or (5, T), SI: position (m), pressures a and b (Pa), spool position, command. Column k holds
            the readings of sample k and the command that acts until one latency after sample k. NaN: no reading.
        config: the task: the rig, its ranges, its sensors.
        unknowns: names (:mod:`hydro_rig.estimation.unknowns`); ``None``: all that an episode draws, and the start.
        priors: priors that replace those of the task, by name.
        physical: known parameters of each window, (B, parameters); ``None``: those of the task's plant.
        first: initial values by name, each (B,) or a number; ``None``: guessed from the signals.
        settings: of the search.
        boundary: recorded supply and tank pressure, (B, 2, T), Pa; NaN, ``None``: those of the plant.

    Raises:
        ConfigurationError: a shape, a command or a name is wrong.

    Example:
        >>> import numpy as np
        >>> from hydro_rig.estimation.estimate import estimate
        >>> from hydro_rig.estimation.known_windows import known_windows
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_agents.running.cases import Cases
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig()
        >>> cases = Cases(np.array([1]), np.array([1.0]), np.array(["multi_sine"]))
        >>> windows = known_windows(task, shipped("pid", task), cases, begin=0.0, length=1.0)
        >>> found = estimate(windows.signals, task)
        >>> np.round(found.value("leakage_flow_lpm"), 1)  # l/min at 100 bar
        array([1.])
    """
    windows = checked_signals(signals)
    known = priors_of(config, unknowns, priors)
    settings = settings or EstimationSettings()
    model = Model(config, known, windows[:, -1], physical, None, settings.threads, boundary)
    guess = first_values(windows, config, known)
    for name, values in (first or {}).items():
        if name not in known:
            raise ConfigurationError(f"first: '{name}' is not among the unknowns")
        guess[:, model.names.index(name)] = values
    problem, scaled = Problem(model, usable_readings(windows, config, model)), model.prior.scaled(guess)
    parts, together = [], max(SAMPLES_PER_BATCH // windows.shape[2], 1)
    for rows in np.split(np.arange(len(windows)), range(together, len(windows), together)):
        parts.append(search(problem.part(rows), scaled[rows], settings))
    return join(parts)


def checked_signals(signals: Any) -> Floats:
    """Signals as (B, 5, T).

    Raises:
        ConfigurationError: the shape is wrong.
    """
    windows = np.asarray(signals, dtype=np.float64)
    shape = windows.shape
    windows = windows[None] if windows.ndim == 2 else windows
    if windows.ndim != 3 or windows.shape[1] != len(SENSORS) + 1 or windows.shape[2] < 2 or not len(windows):
        raise ConfigurationError(f"signals: shape {shape}: must be (windows, {len(SENSORS) + 1}, samples)")
    return windows


def usable_readings(signals: Floats, config: TaskConfig, model: Model) -> Floats:
    """Readings over their noise (B, channels, T); NaN if a reading is missing or useless.

    Useless are readings within three standard deviations of the noise from an end of the sensor's range, where they
    saturate, and the first reading of each pressure, whose lag depends on the time before the window.
    """
    readings = signals[:, : len(SENSORS)].copy()
    if config.sensors.enabled:
        sensors = [getattr(config.sensors, channel) for channel in SENSORS]
        low = np.array([sensor.low + 3.0 * sensor.noise for sensor in sensors])[:, None]
        high = np.array([sensor.high - 3.0 * sensor.noise for sensor in sensors])[:, None]
        readings[~((readings > low) & (readings < high))] = np.nan
    readings[:, [SENSORS.index("pressure_a"), SENSORS.index("pressure_b")], 0] = np.nan
    return readings / model.noise[:, None]


def first_values(signals: Floats, config: TaskConfig, priors: Mapping[str, Prior]) -> Floats:
    """First values (B, P) of the unknowns of B windows; the prior's mean where the signals give no information.

    ``signals``: (B, channels + 1, T), NaN where a reading is missing.
    """
    if config.sensors.differential_pressure:
        signals = two_pressures(signals, config)
    value, slope = _starts(signals[:, : len(SENSORS), :_FIRST_SAMPLES], config.control_period)
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


def _starts(near: Floats, period: float) -> tuple[Floats, Floats]:
    """Value and slope of each channel at the first sample, (B, channels) each, from a line through a few samples."""
    time = period * np.arange(near.shape[2])
    weight = np.isfinite(near).astype(np.float64)
    reading = np.nan_to_num(near)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = weight.sum(axis=2)
        middle = (weight * time).sum(axis=2) / total
        mean = (weight * reading).sum(axis=2) / total
        away = time - middle[:, :, None]
        slope = (weight * away * reading).sum(axis=2) / (weight * away**2).sum(axis=2)
        return np.where(total >= 2, mean - slope * middle, mean), slope
