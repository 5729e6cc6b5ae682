"""Distributions of the plant's parameters, drawn in each episode."""

import math
from collections.abc import Mapping
from operator import attrgetter
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from hydro_env.errors import ConfigurationError, at
from hydro_env.files import Group, whole_group
from hydro_env.mistakes import did_you_mean
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_LIMITS, PARAMETER_PATHS, PARAMETER_UNITS, PlantParameters
from hydro_env.plant.parts.leakage import LEAK_LAWS
from hydro_env.units import Number, in_si, written

LEAKAGE_OF_THE_TASK = tuple(f"leakage.{law.parameter}" for law in LEAK_LAWS.values())  # drawn by the task's leakage

FORMS = ("uniform", "log_uniform", "factor", "log_factor")
Bounds = tuple[Number, Number]


class Distribution(Group):
    """Distribution of one parameter: uniform or log-uniform between two bounds.

    ``uniform`` and ``log_uniform`` give the bounds in SI units, or written with their unit; ``factor`` and
    ``log_factor`` give them as multiples of the rig's own value, so that they fit any rig. ``times`` multiplies a draw
    in SI units by another parameter. The value is ``otherwise`` with ``otherwise_probability``.
    """

    uniform: Bounds | None = None
    log_uniform: Bounds | None = None
    factor: Bounds | None = None  # uniform; multiples of the rig's own value
    log_factor: Bounds | None = None  # log-uniform; multiples of the rig's own value
    times: str | None = None  # path of a parameter that multiplies the draw
    otherwise: Number | None = None
    otherwise_probability: Number = Field(0.0, ge=0.0, le=1.0)

    @whole_group
    def _consistent(self) -> "Distribution":
        given = [name for name in FORMS if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(f"needs either 'uniform: [low, high]' or one of {', '.join(FORMS[1:])}")
        low, high = getattr(self, given[0])
        if not -math.inf < low <= high < math.inf:
            raise ValueError(f"bounds = [{low:g}, {high:g}]: must be finite and rising")
        if (self.logarithmic or self.relative) and low <= 0.0:
            raise ValueError(f"{given[0]} needs positive bounds")
        if self.times is not None and self.times not in PARAMETER_PATHS:
            guess = did_you_mean(self.times, PARAMETER_PATHS)
            raise ValueError(f"times = {self.times!r} is not a parameter of the plant{guess}")
        if self.times and self.relative:
            raise ValueError(f"{given[0]} already multiplies the rig's own value: leave out 'times'")
        if (self.otherwise is None) != (self.otherwise_probability == 0.0):
            raise ValueError("'otherwise' and 'otherwise_probability' belong together")
        return self

    @property
    def logarithmic(self) -> bool:
        """Whether the draw is log-uniform."""
        return bool(self.log_uniform or self.log_factor)

    @property
    def relative(self) -> bool:
        """Whether the bounds are multiples of the rig's own value."""
        return bool(self.factor or self.log_factor)

    def bounds(self, own: float) -> tuple[float, float]:
        """Lower and upper bound of the draw in SI units, before ``times``, on a rig whose own value is ``own``."""
        low, high = next(pair for name in FORMS if (pair := getattr(self, name)))
        if not self.relative:
            return low, high
        return (low * own, high * own) if own >= 0.0 else (high * own, low * own)


def _in_si(ranges: Any) -> Any:
    """Ranges with bounds in SI, which may be written with a unit: ``load.mass: {uniform: [118 kg, 0.122 t]}``."""
    if not isinstance(ranges, Mapping):
        return ranges
    result = dict(ranges)
    for path, given in ranges.items():
        if isinstance(given, Mapping) and path in PARAMETER_UNITS and given.get("times") is None:
            units = dict.fromkeys(("uniform", "log_uniform", "otherwise"), PARAMETER_UNITS[path])
            with at(path):
                result[path] = {
                    name: in_si(value, units.get(name, "1")) if name in Distribution.model_fields else value
                    for name, value in given.items()
                }
    return result


def _number_of_the_plant(path: str) -> str:
    numbers = [name for name in PARAMETER_PATHS if name not in MODEL_CODES]
    if path not in numbers:
        raise ValueError(f"'{path[:60]}' is not a number of the plant{did_you_mean(path, numbers)}")
    if path in LEAKAGE_OF_THE_TASK:
        raise ValueError(f"'{path}' is drawn by the group 'leakage' of the task")
    return path


Randomisation = Annotated[
    dict[Annotated[str, AfterValidator(_number_of_the_plant)], Distribution], BeforeValidator(_in_si)
]
"""Distributions by ``group.field``."""

PUBLISHED_RANGES = {
    "cylinder.dead_volume": (20e-6, 60e-6),
    "valve.rated_flow": (0.9 * 10e-3 / 60, 1.1 * 10e-3 / 60),
    "valve.natural_frequency": (380.0, 630.0),
    "valve.damping_ratio": (0.6, 1.0),
    "valve.underlap": (0.005, 0.025),
    "fluid.bulk_modulus": (1.0e9, 1.5e9),
    "fluid.air_fraction": (0.001, 0.01),
    "load.mass": (40.0, 80.0),
    "load.spring_stiffness": (71.2e3, 106.8e3),
    "load.viscous_damping": (100.0, 800.0),
    "friction.coulomb_force": (50.0, 300.0),
    "supply.pressure": (60e5, 100e5),
}
"""SI; ranges of published rigs of the size of the paper's (docs/model.md, Parameters)."""


def own_value(plant: PlantParameters, path: str) -> float:
    """The number of a rig at ``group.field``."""
    return float(attrgetter(path)(plant))


def default_randomisation(plant: PlantParameters | None = None) -> dict[str, Distribution]:
    """Distributions of the parameters that are not known exactly, relative to a rig; ``None``: the paper's.

    The factors are the ratios of the published ranges to the paper's rig. Two entries are not factors. The leak past
    the rod seal is in l/min at 100 bar on every rig, like the leak past the piston: a tight rod seal has no value to
    multiply. Breakaway friction exceeds Coulomb friction by 40 to 160 % of the rig's own excess, so that it is never
    smaller.
    """
    paper = PlantParameters()
    ranges = {}
    for path, (low, high) in PUBLISHED_RANGES.items():
        bounds = low / own_value(paper, path), high / own_value(paper, path)
        if path == "fluid.air_fraction":
            ranges[path] = Distribution(log_factor=bounds)
        elif path == "load.spring_stiffness":
            ranges[path] = Distribution(factor=bounds, otherwise=0.0, otherwise_probability=0.1)
        else:
            ranges[path] = Distribution(factor=bounds)
        if path == "friction.coulomb_force" and (friction := (plant or paper).friction).coulomb_force > 0.0:
            excess = max(friction.breakaway_force / friction.coulomb_force - 1.0, 0.0)
            ranges["friction.breakaway_force"] = Distribution(uniform=(1 + 0.4 * excess, 1 + 1.6 * excess), times=path)
    ranges["leakage.external_resistance"] = Distribution(
        log_uniform=(1e12, 1e13), otherwise=math.inf, otherwise_probability=0.8
    )
    return ranges


def check_draws(randomisation: Mapping[str, Distribution], plant: PlantParameters) -> None:
    """Check that every possible draw is a valid parameter; the paths are numbers of the plant.

    Raises:
        ConfigurationError: a draw may lie outside its bounds.
    """
    for path, distribution in randomisation.items():
        own = own_value(plant, path)
        if distribution.relative and math.isinf(own):
            raise ConfigurationError(f"randomisation: {path}: the rig's own value is infinite and has no multiples")
        if distribution.log_factor and own < 0.0:
            raise ConfigurationError(f"randomisation: {path}: log_factor needs a positive value, not {own:g}")
        values = list(distribution.bounds(own))
        if distribution.times:
            factor = own_value(plant, distribution.times)
            drawn = randomisation.get(distribution.times)
            factors = (factor, factor) if drawn is None else drawn.bounds(factor)
            values = [value * factor for value, factor in zip(values, factors, strict=True)]
        if distribution.otherwise is not None:
            values.append(distribution.otherwise)
        low, high = PARAMETER_LIMITS[path]
        for value in values:
            if not low <= value <= high:
                side, limit = ("below", low) if value < low else ("above", high)
                number, allowed = written(value, PARAMETER_UNITS[path]), written(limit, PARAMETER_UNITS[path])
                raise ConfigurationError(f"randomisation: {path} = {number} is {side} its limit {allowed}")
