"""Robustness protocols: controllers on paired cases under conditions, each a set of changes of task, leak and plant."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from hydro_agents.evaluation.conditions import Condition, Protocol
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import LEDGER, SEEDS_PER_FAMILY, SeedRange
from hydro_agents.running.tasks import Factor, mappings
from hydro_env import REFERENCE_FAMILIES, ConfigurationError, TaskConfig
from hydro_env.files import Group, read_yaml, validate
from hydro_env.mistakes import kept, known_name
from hydro_env.task.configuration import LEAKAGE_LIMIT, Family
from hydro_env.task.reference_signals import MOVING_FAMILIES
from hydro_env.task.rig import merged
from hydro_env.units import Number

FAMILIES_OF_PLANTS = [name for name, each in LEDGER.items() if each.count >= len(REFERENCE_FAMILIES) * SEEDS_PER_FAMILY]
PlantSeeds = Annotated[str, known_name(FAMILIES_OF_PLANTS, "range of seeds")]


class PairedCondition(Condition):
    """One condition; the controllers do not know it."""

    leak_levels: tuple[Number, ...] | None = Field(
        None, min_length=1, description="l/min at 100 bar; default: protocol"
    )
    families: tuple[Family, ...] | None = Field(None, min_length=1, description="default: those of the protocol")
    plants: int | None = Field(None, ge=3, le=SEEDS_PER_FAMILY, description="per level and family; default: protocol")
    controllers: dict[str, str | dict[str, Any]] = Field(
        default_factory=dict,
        description="by name; controllers for this condition: as in --agent, or the path of a file of gains",
    )

    @model_validator(mode="after")
    def _possible(self) -> PairedCondition:
        check_grid(self.leak_levels or (), self.families or ())
        return self


def check_grid(levels: tuple[Number, ...], families: tuple[str, ...]) -> None:
    """Check leak levels and families of references.

    Raises:
        ValueError: a level is above the limit, 'user' is not the only family, or an entry is duplicate.
    """
    for level in levels:
        if not 0.0 < level <= LEAKAGE_LIMIT:
            raise ValueError(f"leak_levels: {level:g} l/min: must be within 0 (excluded) to {LEAKAGE_LIMIT:g}")
    if "user" in families and len(families) > 1:
        raise ValueError("families: 'user' must stand alone")
    for name, values in (("leak_levels", levels), ("families", families)):
        if len(set(values)) != len(values):
            raise ValueError(f"{name}: has a duplicate entry")


def paired(levels: Sequence[float], families: Sequence[str], plants: int, seeds: SeedRange) -> pd.DataFrame:
    """One row per leak level, family and plant, with its seed.

    A family has the same plants at every level; families have different plants.
    """
    rows = product(levels, families, range(plants))
    table = pd.DataFrame(rows, columns=["leakage_flow_lpm", "family", "plant"])
    numbers = table["family"].map(REFERENCE_FAMILIES.index)
    return table.assign(seed=seeds.of_family(numbers, table["plant"]))


class PairedCases(Group):
    """Number and kind of paired cases."""

    leak_levels: tuple[Number, ...] = Field((0.03, 1.0, 4.0), min_length=1, description="l/min at 100 bar")
    families: tuple[Family, ...] = Field(MOVING_FAMILIES, min_length=1)
    plants: int = Field(8, ge=3, le=SEEDS_PER_FAMILY, description="per level and family")
    seeds: PlantSeeds = Field("ROBUSTNESS", description="of the plants: a range of the ledger of seeds, by its name")
    standstill_plants: int = Field(
        4, ge=0, le=SEEDS_PER_FAMILY, description="plants of the search for limit cycles, per leak; 0: no search"
    )

    @model_validator(mode="after")
    def _possible_cases(self) -> Self:
        check_grid(self.leak_levels, self.families)
        return self


class Sweep(Group):
    """Conditions that each fix one parameter of the plant at a factor of the nominal value."""

    group: str = "parameter"
    leak_levels: tuple[Number, ...] | None = Field(None, min_length=1)
    families: tuple[Family, ...] | None = Field(None, min_length=1)
    plants: int | None = Field(None, ge=3, le=SEEDS_PER_FAMILY)
    factors: dict[str, tuple[Factor, ...]] = Field(min_length=1, description="by path of the parameter")

    def conditions(self) -> dict[str, dict[str, Any]]:
        """One condition per parameter and factor, as a mapping."""
        shared = self.model_dump(exclude={"factors"}, exclude_none=True)
        conditions = {}
        for path, factors in self.factors.items():
            name = path.split(".")[1]
            for factor in factors:
                label = f"{name.replace('_', ' ')} × {factor:g}"
                conditions[f"{name}_x{factor:g}"] = {**shared, "label": label, "factors": {path: factor}}
        return conditions


class RobustnessProtocol(PairedCases, Protocol[PairedCondition]):
    """A protocol of controllers on paired cases; ``configs/protocols`` holds some.

    A plant has the same seed at every leak level and in every condition. The key ``sweep`` of a file adds conditions.
    """

    kind: Literal["robustness"] = "robustness"
    title: str = "Robustness"
    chunk: int = Field(
        128, ge=1, le=2048, description="cases of a job; fixed, so that no result depends on the machine"
    )
    standstill_leak_levels: tuple[Number, ...] = Field(
        (0.03, 1.0, 8.0),
        description="l/min; search for limit cycles under each condition without its own leak levels",
    )
    worst: int = Field(10, ge=1, le=1000, description="worst cases that the tables list per controller")

    @model_validator(mode="after")
    def _possible(self) -> RobustnessProtocol:
        check_grid(self.standstill_leak_levels, ())
        if "all" in self.conditions:
            raise ValueError("conditions: 'all' is the name of their mean")
        return self

    @property
    def measured(self) -> tuple[str, ...]:
        """Tracking, and standstills where the protocol has plants for them."""
        return ("tracking", "standstill") if self.standstill_plants else ("tracking",)

    @classmethod
    def prepare(cls, values: dict[str, Any], file: Path, errors: list[ConfigurationError]) -> None:
        """Add the conditions of a sweep; read the gains of controllers for a condition."""
        conditions = values.get("conditions")
        if "sweep" in values and isinstance(conditions, dict):
            swept = validate(Sweep, values.pop("sweep"), f"{file}: sweep").conditions()
            twice = next((name for name in swept if name in conditions), None)
            if twice is not None:
                raise ConfigurationError(f"{file}: conditions.{twice}: is also in sweep")
            values["conditions"] = conditions = {**conditions, **swept}
        for condition in mappings(conditions).values():
            chosen: Any = condition.get("controllers")
            for name, what in chosen.items() if isinstance(chosen, dict) else ():
                if isinstance(what, str) and what.endswith(".yaml"):
                    with kept(errors):
                        chosen[name] = read_yaml(file.parent / what)

    def changed_task(self, name: str) -> TaskConfig:
        """The task with the changes of a condition; a condition whose only reference is 'user' draws no other."""
        condition = self.conditions[name]
        if condition.families == ("user",):
            alone = merged(condition.task, {"references": {"weights": {"user": 1.0}}})
            condition = condition.model_copy(update={"task": alone})
        return condition.task_on(self.task, f"conditions.{name}")

    def parameters_in(self, name: str) -> dict[str, dict[str, float | str]]:
        """Parameters that a condition fixes in every plant, for the option ``parameters`` of ``reset``."""
        return self.conditions[name].parameters_on(self.task_in(name))

    def cases_in(self, name: str) -> pd.DataFrame:
        """The cases of a condition: leak, family, plant and seed of each."""
        condition = self.conditions[name]
        families, plants = condition.families or self.families, condition.plants or self.plants
        return paired(condition.leak_levels or self.leak_levels, families, plants, LEDGER[self.seeds])

    def standstill_cases_in(self, name: str) -> pd.DataFrame:
        """The cases of the search for limit cycles under a condition: its own leaks, or else those of the protocol."""
        levels = self.conditions[name].leak_levels or self.standstill_leak_levels
        return paired(levels, ("user",), self.standstill_plants, LEDGER[self.seeds])

    def cases_of(self, name: str, table: pd.DataFrame) -> Cases:
        """The cases of a table of :func:`paired` under a condition."""
        families = table["family"].to_numpy().astype(str)
        return Cases(
            table["seed"].to_numpy(np.int64),
            table["leakage_flow_lpm"].to_numpy(np.float64),
            None if (families == "user").all() else families,
            self.parameters_in(name),
        )

    def known_of(self, name: str) -> dict[str, Any]:
        """See :meth:`~hydro_agents.evaluation.conditions.Protocol.known_of`."""
        known = {"description": self.conditions[name].description}
        return known | {"control_period_s": self.task_in(name).control_period, "cases": len(self.cases_in(name))}
