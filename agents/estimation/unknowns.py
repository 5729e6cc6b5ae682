"""The unknowns of an estimate, by name, and what is known of each before anything is measured.

Names: ``leakage_flow_lpm`` and ``external_leakage_flow_lpm`` (l/min at 100 bar), the path of any number of the plant
(``valve.rated_flow``), ``command_latency`` (s), ``start.`` and a state (``start.velocity``), a sensor and ``_bias``
(its unit) or ``_gain`` (relative). SI units otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydro_env import ConfigurationError, TaskConfig
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS
from hydro_env.plant.states import STATE_NAMES, STATES
from hydro_env.task.randomisation import LEAKAGE_OF_THE_TASK, own_value
from hydro_env.task.sensors import CHANNELS
from hydro_env.units import flow_from_resistance

Array = NDArray[np.float64]

LEAKAGE, EXTERNAL_LEAKAGE, LATENCY = "leakage_flow_lpm", "external_leakage_flow_lpm", "command_latency"
BIASES = tuple(f"{channel}_bias" for channel in CHANNELS)
GAINS = tuple(f"{channel}_gain" for channel in CHANNELS)
STARTS = tuple(f"start.{name}" for name in STATE_NAMES)
EXTERNAL_RESISTANCE = "leakage.external_resistance"
_PATHS = tuple(
    path for path in PARAMETER_PATHS if path not in (*MODEL_CODES, *LEAKAGE_OF_THE_TASK, EXTERNAL_RESISTANCE)
)
NAMES = (LEAKAGE, EXTERNAL_LEAKAGE, LATENCY, *BIASES, *GAINS, *STARTS, *_PATHS)
"""Every name that an unknown can have."""

START = tuple(
    f"start.{name}" for name in ("position", "velocity", "pressure_a", "pressure_b", "spool_position", "spool_velocity")
)
"""Start states of every window; the supply pressure joins them unless it is constant."""

_SHARE_UNKNOWN = 0.1
"""Standard deviation, as a share of its value, of a parameter that the task does not draw."""

_WITHOUT_RANGE = {"valve.null_shift": 0.01, "load.external_force": 200.0, "supply.tank_pressure": 1e5}
"""Standard deviation, in SI units, of parameters whose own value may be 0."""


@dataclass(frozen=True)
class Prior:
    """What is known of an unknown before the measurement: a normal distribution of its value or of its logarithm."""

    mean: float  # in the unknown's unit; the median if logarithmic
    deviation: float  # standard deviation, in the unknown's unit; of the natural logarithm if logarithmic
    logarithmic: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mean) and 0.0 < self.deviation < math.inf):
            raise ConfigurationError(
                f"prior: mean = {self.mean:g}, deviation = {self.deviation:g}: must be finite, the deviation above 0"
            )
        if self.logarithmic and self.mean <= 0.0:
            raise ConfigurationError(f"prior: mean = {self.mean:g}: must be above 0 for a logarithmic prior")


def _moments(low: float, high: float, logarithmic: bool) -> tuple[float, float]:
    """Mean and variance of a uniform or log-uniform distribution."""
    if high == low:
        return low, 0.0
    if not logarithmic:
        return 0.5 * (low + high), (high - low) ** 2 / 12.0
    span = math.log(high / low)
    mean = (high - low) / span
    return mean, 0.5 * (high**2 - low**2) / span - mean**2


def _mixed(share: float, first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """Mean and variance of a mixture: with probability ``share`` the first (mean, variance), else the second."""
    mean = share * first[0] + (1.0 - share) * second[0]
    variance = sum(part * (v + (m - mean) ** 2) for part, (m, v) in ((share, first), (1.0 - share, second)))
    return mean, variance


def _of_positive(mean: float, variance: float) -> Prior:
    """Logarithmic prior with the mean and variance of a positive number."""
    spread = math.log1p(variance / mean**2)
    return Prior(mean * math.exp(-0.5 * spread), math.sqrt(spread), True)


def _plant_prior(config: TaskConfig, path: str) -> Prior:
    own = own_value(config.plant, path)
    drawn = config.randomisation.get(path)
    if drawn is None:
        if path in _WITHOUT_RANGE or own <= 0.0 or not math.isfinite(own):
            return Prior(own, _WITHOUT_RANGE.get(path, max(abs(own) * _SHARE_UNKNOWN, 1e-9)))
        return Prior(own, _SHARE_UNKNOWN, True)
    mean, variance = _moments(*drawn.bounds(own), drawn.logarithmic)
    if drawn.times is not None:
        other = _plant_prior(config, drawn.times)
        factor, spread = _lognormal_moments(other) if other.logarithmic else (other.mean, other.deviation**2)
        mean, variance = mean * factor, mean**2 * spread + factor**2 * variance + variance * spread
    if drawn.otherwise is not None:
        mean, variance = _mixed(drawn.otherwise_probability, (drawn.otherwise, 0.0), (mean, variance))
        return Prior(mean, math.sqrt(max(variance, 1e-300)))
    if variance == 0.0:
        return Prior(mean, _SHARE_UNKNOWN * 1e-3, True) if mean > 0.0 else Prior(mean, 1e-9)
    return _of_positive(mean, variance) if mean > 0.0 else Prior(mean, math.sqrt(variance))


def _lognormal_moments(prior: Prior) -> tuple[float, float]:
    growth = math.exp(prior.deviation**2)
    return prior.mean * math.sqrt(growth), prior.mean**2 * growth * (growth - 1.0)


def _external_leakage_prior(config: TaskConfig) -> Prior:
    drawn = config.randomisation.get(EXTERNAL_RESISTANCE)
    own = flow_from_resistance(own_value(config.plant, EXTERNAL_RESISTANCE))
    if drawn is None:
        return Prior(own, 0.1)
    high, low = (flow_from_resistance(bound) for bound in drawn.bounds(own_value(config.plant, EXTERNAL_RESISTANCE)))
    mean, variance = _moments(low, high, drawn.logarithmic)
    if drawn.otherwise is not None:
        other = flow_from_resistance(drawn.otherwise)
        mean, variance = _mixed(drawn.otherwise_probability, (other, 0.0), (mean, variance))
    return Prior(mean, math.sqrt(variance))


def _start_prior(config: TaskConfig, state: str) -> Prior:
    """Wide: what a state may be on the rig; the engine begins at the measured value where there is one."""
    plant = config.plant
    pressure = plant.supply.pressure
    known = {
        "position": Prior(0.0, 0.3 * plant.cylinder.stroke),
        "velocity": Prior(0.0, 0.5),
        "pressure_a": Prior(0.5 * pressure, 0.3 * pressure),
        "pressure_b": Prior(0.5 * pressure, 0.3 * pressure),
        "spool_position": Prior(0.0, 0.3),
        "spool_velocity": Prior(0.0, 5.0),
        "supply_pressure": Prior(pressure, 0.2 * pressure),
    }
    return known.get(state, Prior(0.0, STATES[state].typical))


def prior_of(config: TaskConfig, name: str) -> Prior:
    """The prior of an unknown that follows from the task: ranges of its plants, of its leak, biases of its sensors.

    A range becomes the normal distribution with the same mean and variance; of the logarithm for positive numbers.

    Raises:
        ConfigurationError: no unknown has this name.
    """
    if name == LEAKAGE:
        return Prior(0.0, 0.5 * config.leakage.faulty_range[1])
    if name == EXTERNAL_LEAKAGE:
        return _external_leakage_prior(config)
    if name == LATENCY:
        low, high = config.command_latency_range or (config.command_latency,) * 2
        return Prior(0.5 * (low + high), max((high - low) / math.sqrt(12.0), 0.05e-3))
    if name in BIASES:
        sensor = getattr(config.sensors, CHANNELS[BIASES.index(name)])
        return Prior(0.0, max(sensor.bias / math.sqrt(3.0), 1e-9 * (sensor.high - sensor.low)))
    if name in GAINS:
        return Prior(1.0, 0.01)
    if name in STARTS:
        return _start_prior(config, name.removeprefix("start."))
    if name in _PATHS:
        return _plant_prior(config, name)
    raise ConfigurationError(
        f"unknowns: '{name}' is no unknown; known are {', '.join(NAMES[:3])}, plant paths, "
        "start.<state>, <sensor>_bias and <sensor>_gain"
    )


def default_unknowns(config: TaskConfig) -> tuple[str, ...]:
    """All that an episode of the task draws and the window's start: leaks, plant, biases, start states."""
    plant = tuple(path for path in config.randomisation if path != EXTERNAL_RESISTANCE)
    external = (EXTERNAL_LEAKAGE,) if EXTERNAL_RESISTANCE in config.randomisation else ()
    latency = (LATENCY,) if config.command_latency_range else ()
    force = ("load.external_force",) if config.disturbance.kind != "none" or config.disturbance.steady_share[1] else ()
    biases = BIASES if config.sensors.enabled else ()
    supply = ("start.supply_pressure",) if config.plant.supply.model != "constant" else ()
    return (LEAKAGE, *external, *plant, *force, *latency, *biases, *START, *supply)


def priors_of(
    config: TaskConfig, unknowns: Sequence[str] | None = None, priors: Mapping[str, Prior] | None = None
) -> dict[str, Prior]:
    """The prior of each unknown by name, in order: that of the task, unless ``priors`` gives another.

    Raises:
        ConfigurationError: a name is unknown or occurs twice.
    """
    names = default_unknowns(config) if unknowns is None else tuple(unknowns)
    for name in names:
        if names.count(name) > 1:
            raise ConfigurationError(f"unknowns: '{name}' occurs twice")
    for name in priors or {}:
        if name not in names:
            raise ConfigurationError(f"priors: '{name}' is not among the unknowns")
    own = priors or {}
    return {name: own[name] if name in own else prior_of(config, name) for name in names}
