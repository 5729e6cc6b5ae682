"""The unknowns of an estimate: their names, those that are estimated by default, and their priors.

Names: ``leakage_flow_lpm`` and ``external_leakage_flow_lpm`` (l/min at 100 bar), the path of any number of the plant
(``valve.rated_flow``), ``command_latency`` (s), ``pressure_rise_time`` (of the transducers, s), ``start.`` and a
state (``start.velocity``), a sensor and ``_bias`` (its unit) or ``_gain`` (relative, 1: none). SI units otherwise.

Priors: the ranges of the task, without its faults, become normal distributions with the same mean and variance; that of
a positive quantity is log-normal.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.detection.detector import RECORDED
from hydro_env import ConfigurationError, TaskConfig, flow_from_resistance
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS
from hydro_env.plant.parts.leakage import ROD_SEAL
from hydro_env.plant.states import ALL_STATES
from hydro_env.task.randomisation import LEAKAGE_OF_THE_TASK, own_value
from hydro_env.task.sensors import PRESSURE_A, SENSORS

LEAKAGE, EXTERNAL_LEAKAGE = "leakage_flow_lpm", "external_leakage_flow_lpm"
LATENCY, RISE_TIME = "command_latency", "pressure_rise_time"
BIASES = tuple(f"{channel}_bias" for channel in SENSORS)
GAINS = tuple(f"{channel}_gain" for channel in SENSORS)
RECORDED_BIASES = tuple(f"{name}_bias" for name in RECORDED.values())
"""Offsets of recorded supply and tank pressure, which drive the simulation instead of being explained."""

COURSE, KNOTS = "supply.course_", 0.25
"""A supply that moves: its pressure rises by ``supply.course_k``, Pa, from knot k − 1 to knot k, KNOTS s later. These
steps of a random walk are unknowns of a window, numbered from 1."""

COURSE_STEP = 0.02  # standard deviation of a step, as a share of the supply pressure
NULL_DRIFT = "valve.null_drift"  # null in one window minus the rig's: it wanders with temperature and amplifier
USUAL_DRIFT = 0.003  # standard deviation, parts of full command: real amplifiers and valves wander by 1 % and more
STARTS = tuple(f"start.{name}" for name in ALL_STATES)
EXTERNAL_RESISTANCE = f"leakage.{ROD_SEAL.parameter}"

PATHS = tuple(path for path in PARAMETER_PATHS if path not in (*MODEL_CODES, *LEAKAGE_OF_THE_TASK, EXTERNAL_RESISTANCE))
"""Parameters of the plant; the leaks have their own names."""

RISE_TIME_UNKNOWN = 2e-3  # s, standard deviation of the transducers' rise time where the data sheet does not hold
_SHARE_UNKNOWN = 0.1  # relative standard deviation of a parameter that the task does not draw

_NOT_DRAWN = {
    "valve.null_shift": 0.01,
    "load.external_force": 200.0,
    "supply.tank_pressure": 1e5,
    EXTERNAL_LEAKAGE: 0.1,
}
"""Standard deviation of unknowns that the task does not draw and that may be 0, in the unknown's unit."""


@dataclass(frozen=True)
class Prior:
    """Prior of an unknown, or of P ones, (P,): a normal distribution of its value or of its logarithm."""

    mean: float  # in the unknown's unit; the median if logarithmic
    deviation: float  # standard deviation, in the unknown's unit; of the natural logarithm if logarithmic
    logarithmic: bool = False

    def value(self, scaled: Any) -> Any:
        """Values in the unknown's unit, (…), of scaled ones: standard deviations from the mean."""
        away = self.deviation * scaled
        with np.errstate(over="ignore"):
            by_factor = self.mean * np.exp(np.where(self.logarithmic, away, 0.0))
        return np.where(self.logarithmic, by_factor, self.mean + away)

    def scaled(self, value: Any) -> Any:
        """The inverse of :meth:`value`."""
        ratio = np.where(self.logarithmic, value, 1.0) / np.where(self.logarithmic, self.mean, 1.0)
        return np.where(self.logarithmic, np.log(ratio), value - self.mean) / self.deviation

    def slope(self, scaled: Any) -> Any:
        """Change of a value per change of its scaled value, (…)."""
        return np.where(self.logarithmic, self.value(scaled), 1.0) * self.deviation


Priors = Mapping[str, Prior]  # by name


def starts_of(config: TaskConfig) -> list[str]:
    """Names of the unknown start states of a window."""
    names = ["position", "velocity", "pressure_a", "pressure_b", "spool_position", "spool_velocity"]
    names += ["supply_pressure"] if config.plant.supply.model != "constant" else []
    names += ["bristle_deflection"] if config.plant.friction.model == "lugre" else []
    names += ["tip_position", "tip_velocity"] if config.plant.structure.tip else []
    return [f"start.{name}" for name in names]


def course_of(duration: float) -> tuple[str, ...]:
    """Names of the steps of a moving supply in a window of ``duration`` s."""
    return tuple(f"{COURSE}{knot}" for knot in range(1, math.ceil(duration / KNOTS) + 1))


def default_unknowns(config: TaskConfig) -> tuple[str, ...]:
    """All quantities that an episode draws, but faults, and the start: leaks, plant, biases, start states."""
    drawn = config.randomisation
    others = {
        EXTERNAL_LEAKAGE: EXTERNAL_RESISTANCE in drawn,
        "load.external_force": config.disturbance.kind != "none" or config.disturbance.steady_share[1] > 0.0,
        LATENCY: config.command_latency_range,
        **dict.fromkeys(BIASES, config.sensors.enabled),
        **dict.fromkeys(starts_of(config), True),
    }
    plant = [path for path in drawn if path != EXTERNAL_RESISTANCE]
    return (LEAKAGE, *plant, *(name for name, included in others.items() if included and name not in plant))


def priors_of(
    config: TaskConfig, unknowns: Iterable[str] | None = None, priors: Priors | None = None
) -> dict[str, Prior]:
    """The prior of each unknown by name, in order: that of the task, unless ``priors`` gives another.

    Raises:
        ConfigurationError: a name is unknown or occurs twice.
    """
    names, own = default_unknowns(config) if unknowns is None else tuple(unknowns), priors or {}
    for name in (*names, *own):
        if names.count(name) != 1:
            what = "occurs twice" if name in names else "is not among the unknowns"
            raise ConfigurationError(f"unknowns and priors: '{name}' {what}")
    return {name: own[name] if name in own else prior_of(config, name) for name in names}


class _Moments(NamedTuple):
    """Mean and variance of a quantity."""

    mean: float
    variance: float


def prior_of(config: TaskConfig, name: str) -> Prior:
    """The prior of an unknown from the task: ranges of plants, leak and faults, biases of sensors.

    Raises:
        ConfigurationError: no unknown has this name.
    """
    if name == LEAKAGE:
        return Prior(0.0, 0.5 * config.leakage.faulty_range[1])
    if name == LATENCY:
        latency = _range(*(config.command_latency_range or (config.command_latency,) * 2))
        return Prior(latency.mean, max(math.sqrt(latency.variance), 0.05e-3))
    if name == RISE_TIME:
        return Prior(config.sensors.pressure_rise_time, RISE_TIME_UNKNOWN)
    if name == NULL_DRIFT:
        return Prior(0.0, USUAL_DRIFT)
    if name.startswith(COURSE):
        return Prior(0.0, COURSE_STEP * config.plant.supply.pressure)
    if name in STARTS:
        return _start(config, name.removeprefix("start."))
    if name in BIASES:
        sensor = getattr(config.sensors, name.removesuffix("_bias"))
        span = sensor.high - sensor.low
        return Prior(0.0, max(math.sqrt(_range(-sensor.bias, sensor.bias).variance), 1e-9 * span))
    if name in RECORDED_BIASES:  # a transducer like that of chamber a
        return Prior(0.0, prior_of(config, BIASES[PRESSURE_A]).deviation)
    if name in GAINS:
        # The scale of a difference is often known from its amplifier alone.
        return Prior(1.0, 0.1 if config.sensors.differential_pressure else 0.01)
    if name == EXTERNAL_LEAKAGE or name in PATHS:
        moments, drawn = _of_plant(config, name), config.randomisation.get(name)
        if moments.mean > 0.0 and name not in _NOT_DRAWN and (drawn is None or drawn.otherwise is None):
            spread = math.log1p(moments.variance / moments.mean**2)
            return Prior(moments.mean * math.exp(-0.5 * spread), math.sqrt(spread), True)
        return Prior(moments.mean, math.sqrt(moments.variance))
    raise ConfigurationError(
        f"unknowns: '{name}': unknown name; known: {LEAKAGE}, {EXTERNAL_LEAKAGE}, {LATENCY}, paths of the plant, "
        "start.<state>, <sensor>_bias and <sensor>_gain"
    )


def _of_plant(config: TaskConfig, name: str) -> _Moments:
    """Mean and variance of a parameter of the plant, or of the external leak in l/min at 100 bar."""
    path = EXTERNAL_RESISTANCE if name == EXTERNAL_LEAKAGE else name
    own = own_value(config.plant, path)
    drawn = config.randomisation.get(path)
    value = flow_from_resistance(own) if name == EXTERNAL_LEAKAGE else own
    if not math.isfinite(value):
        raise ConfigurationError(
            f"unknowns: '{name}' is infinite on this rig: give a prior, or a finite value in the rig file"
        )
    if drawn is None:
        return _Moments(value, _NOT_DRAWN.get(name, max(abs(value) * _SHARE_UNKNOWN, 1e-9)) ** 2)
    low, high = drawn.bounds(own)
    otherwise = drawn.otherwise
    if name == EXTERNAL_LEAKAGE:
        low, high = flow_from_resistance(high), flow_from_resistance(low)
        otherwise = None if otherwise is None else flow_from_resistance(otherwise)
    result = _range(low, high, drawn.logarithmic)
    if drawn.times:
        result = _product(result, _of_plant(config, drawn.times))
    if otherwise is not None:
        result = _mixture(drawn.otherwise_probability, otherwise, result)
    # An unknown needs a range, even if the task draws a single value.
    return _Moments(result.mean, max(result.variance, (1e-4 * result.mean) ** 2, 1e-18))


def _range(low: float, high: float, logarithmic: bool = False) -> _Moments:
    if high == low:
        return _Moments(low, 0.0)
    if not logarithmic:
        return _Moments(0.5 * (low + high), (high - low) ** 2 / 12.0)
    span = math.log(high / low)
    mean = (high - low) / span
    return _Moments(mean, 0.5 * (high**2 - low**2) / span - mean**2)


def _product(a: _Moments, b: _Moments) -> _Moments:
    return _Moments(a.mean * b.mean, a.mean**2 * b.variance + b.mean**2 * a.variance + a.variance * b.variance)


def _mixture(share: float, fixed: float, drawn: _Moments) -> _Moments:
    """Moments of a mixture: a fixed value with probability ``share``, else a drawn one."""
    rest = 1.0 - share
    return _Moments(share * fixed + rest * drawn.mean, rest * (drawn.variance + share * (drawn.mean - fixed) ** 2))


def _start(config: TaskConfig, state: str) -> Prior:
    """A wide prior over the range of a state on the rig; the search begins at the measured value, if there is one."""
    pressure = config.plant.supply.pressure
    # Of a difference the sum is not measured, and two empty chambers explain one as well.
    spread = 0.05 if config.sensors.differential_pressure else 0.3
    known = {
        **dict.fromkeys(("position", "tip_position"), Prior(0.0, 0.3 * config.plant.cylinder.stroke)),
        **dict.fromkeys(("velocity", "tip_velocity"), Prior(0.0, 0.5)),
        **dict.fromkeys(("pressure_a", "pressure_b"), Prior(0.5 * pressure, spread * pressure)),
        "spool_position": Prior(0.0, 0.3),
        "spool_velocity": Prior(0.0, 5.0),
        "supply_pressure": Prior(pressure, 0.2 * pressure),
    }
    return known.get(state, Prior(0.0, ALL_STATES[state].typical))
