"""Distributions of the plant's parameters, drawn in each episode."""

from __future__ import annotations

import math
from collections.abc import Mapping

from pydantic import Field, model_validator

from hydro_env.files import Group
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS, PlantParameters
from hydro_env.units import Number

LEAKAGE_OF_THE_TASK = ("leakage.internal_resistance", "leakage.orifice_gain")
"""Parameters that the group ``leakage`` of the task draws."""


class Distribution(Group):
    """Distribution of one parameter: uniform or log-uniform between two bounds.

    ``times`` multiplies the draw by another parameter. The value is ``otherwise`` with ``otherwise_probability``.
    """

    uniform: tuple[Number, Number] | None = None
    log_uniform: tuple[Number, Number] | None = None
    times: str | None = Field(None, description="path of a parameter that multiplies the draw")
    otherwise: Number | None = None
    otherwise_probability: Number = Field(0.0, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _consistent(self) -> Distribution:
        if (self.uniform is None) == (self.log_uniform is None):
            raise ValueError("needs either 'uniform: [low, high]' or 'log_uniform: [low, high]'")
        low, high = self.bounds
        if not -math.inf < low <= high < math.inf:
            raise ValueError(f"bounds = [{low:g}, {high:g}]: must be finite and rising")
        if self.log_uniform is not None and self.log_uniform[0] <= 0.0:
            raise ValueError("log_uniform needs positive bounds")
        if self.times is not None and self.times not in PARAMETER_PATHS:
            raise ValueError(f"times = {self.times!r} is no parameter of the plant")
        if (self.otherwise is None) != (self.otherwise_probability == 0.0):
            raise ValueError("'otherwise' and 'otherwise_probability' belong together")
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound of the draw."""
        chosen = self.uniform if self.uniform is not None else self.log_uniform
        assert chosen is not None
        return chosen


def default_randomisation() -> dict[str, Distribution]:
    """Distributions of the assumed parameters over the ranges of published rigs (docs/model.md, section 3)."""
    return {
        "cylinder.dead_volume": Distribution(uniform=(20e-6, 60e-6)),
        "valve.rated_flow": Distribution(uniform=(0.9 * 10e-3 / 60, 1.1 * 10e-3 / 60)),
        "valve.natural_frequency": Distribution(uniform=(380.0, 630.0)),
        "valve.damping_ratio": Distribution(uniform=(0.6, 1.0)),
        "valve.underlap": Distribution(uniform=(0.005, 0.025)),
        "fluid.bulk_modulus": Distribution(uniform=(1.0e9, 1.5e9)),
        "fluid.air_fraction": Distribution(log_uniform=(0.001, 0.01)),
        "load.mass": Distribution(uniform=(40.0, 80.0)),
        "load.spring_stiffness": Distribution(uniform=(71.2e3, 106.8e3), otherwise=0.0, otherwise_probability=0.1),
        "load.viscous_damping": Distribution(uniform=(100.0, 800.0)),
        "friction.coulomb_force": Distribution(uniform=(50.0, 300.0)),
        "friction.breakaway_force": Distribution(uniform=(1.2, 1.8), times="friction.coulomb_force"),
        "supply.pressure": Distribution(uniform=(60e5, 100e5)),
        "leakage.external_resistance": Distribution(
            log_uniform=(1e12, 1e13), otherwise=float("inf"), otherwise_probability=0.8
        ),
    }


def check_draws(randomisation: Mapping[str, Distribution], plant: PlantParameters) -> None:
    """Check that every possible draw is a valid parameter.

    Raises:
        ValueError: a path is no number of the plant, or a draw may lie outside its bounds.
    """
    for path, distribution in randomisation.items():
        if path not in PARAMETER_PATHS or path in MODEL_CODES:
            raise ValueError(f"randomisation: '{path}' is no number of the plant; see PlantParameters")
        if path in LEAKAGE_OF_THE_TASK:
            raise ValueError(f"randomisation: '{path}' is drawn by the group 'leakage'")
        values = list(distribution.bounds)
        if distribution.times is not None:
            group, field = distribution.times.split(".")
            factors = (
                randomisation[distribution.times].bounds
                if distribution.times in randomisation
                else (getattr(getattr(plant, group), field),) * 2
            )
            values = [value * factor for value, factor in zip(values, factors, strict=True)]
        if distribution.otherwise is not None:
            values.append(distribution.otherwise)
        group, field = path.split(".")
        for bound in type(getattr(plant, group)).model_fields[field].metadata:
            low, above, high = (getattr(bound, name, None) for name in ("ge", "gt", "le"))
            for value in values:
                if (low is not None and value < low) or (above is not None and value <= above):
                    raise ValueError(f"randomisation: {path} = {value:g} is below its limit {low or above:g}")
                if high is not None and value > high:
                    raise ValueError(f"randomisation: {path} = {value:g} is above its limit {high:g}")
