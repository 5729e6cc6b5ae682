"""Paired cases: every controller gets the same plants, references and noise at every leak level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Self

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from hydro_agents.evaluation.conditions import Condition, Protocol
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import LEDGER, SEEDS_PER_FAMILY, SeedRange
from hydro_env import REFERENCE_FAMILIES, TaskConfig
from hydro_env.files import Group
from hydro_env.mistakes import known_name
from hydro_env.task.configuration import LEAKAGE_LIMIT, Family
from hydro_env.task.rig import merged

FAMILIES_OF_PLANTS = [name for name, each in LEDGER.items() if each.count > len(REFERENCE_FAMILIES) * SEEDS_PER_FAMILY]
PlantSeeds = Annotated[str, known_name(FAMILIES_OF_PLANTS, "range of seeds")]
DRAWN_FAMILIES = tuple(name for name in REFERENCE_FAMILIES if name != "user")


class ControllerChoice(Group):
    """A variant of a controller that was tuned or trained for a condition."""

    kind: str = Field(description="as in a study: pid, ppo, or module:attribute")
    settings: dict[str, Any] = Field(default_factory=dict, description="gains, or the path of a YAML file")
    weights: str | None = Field(
        None, description="weights of a trained controller: a path, or a name in agents/hydro_agents/pretrained"
    )


class PairedCondition(Condition):
    """One condition; the controllers do not know it."""

    leak_levels: tuple[float, ...] | None = Field(None, min_length=1, description="l/min at 100 bar; default: protocol")
    families: tuple[Family, ...] | None = Field(None, min_length=1, description="default: those of the protocol")
    plants: int | None = Field(None, ge=3, le=SEEDS_PER_FAMILY, description="per level and family; default: protocol")
    controllers: dict[str, ControllerChoice] = Field(
        default_factory=dict, description="by name; controllers tuned or trained for this condition"
    )

    @model_validator(mode="after")
    def _possible(self) -> PairedCondition:
        check_grid(self.leak_levels or (), self.families or ())
        return self


def check_grid(levels: tuple[float, ...], families: tuple[str, ...]) -> None:
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
    rows = [
        (level, family, plant, seeds.of_family(REFERENCE_FAMILIES.index(family), plant))
        for level in levels
        for family in families
        for plant in range(plants)
    ]
    return pd.DataFrame(rows, columns=["leakage_flow_lpm", "family", "plant", "seed"])


def cases_of(table: pd.DataFrame) -> Cases:
    """The cases of a table of :func:`paired`."""
    families = table["family"].to_numpy().astype(str)
    drawn = None if (families == "user").all() else families
    return Cases(table["seed"].to_numpy(np.int64), table["leakage_flow_lpm"].to_numpy(dtype=np.float64), drawn)


class PairedCases(Group):
    """Number and kind of paired cases."""

    leak_levels: tuple[float, ...] = Field((0.03, 1.0, 4.0), min_length=1, description="l/min at 100 bar")
    families: tuple[Family, ...] = Field(DRAWN_FAMILIES, min_length=1)
    plants: int = Field(8, ge=3, le=SEEDS_PER_FAMILY, description="per level and family")

    @model_validator(mode="after")
    def _possible_cases(self) -> Self:
        check_grid(self.leak_levels, self.families)
        return self

    def cases(self, seeds: SeedRange) -> tuple[Cases, pd.DataFrame]:
        """The cases, and a table with leak, family, plant and seed of each."""
        table = paired(self.leak_levels, self.families, self.plants, seeds)
        return cases_of(table), table


class PairedProtocol(PairedCases, Protocol[PairedCondition]):
    """A protocol whose conditions have paired cases."""

    seeds: PlantSeeds = Field("ROBUSTNESS", description="of the plants: a range of the ledger of seeds, by its name")
    chunk: int = Field(2048, ge=1, description="cases of a job")

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

    def cases_in(self, name: str) -> tuple[Cases, pd.DataFrame]:
        """The cases of a condition, and a table with leak, family, plant and seed of each.

        A plant has the same seed at every leak level and in every condition.
        """
        condition = self.conditions[name]
        families = condition.families or self.families
        levels, plants = condition.leak_levels or self.leak_levels, condition.plants or self.plants
        table = paired(levels, families, plants, LEDGER[self.seeds])
        return self.cases_of(name, table), table

    def cases_of(self, name: str, table: pd.DataFrame) -> Cases:
        """The cases of such a table under a condition."""
        return replace(cases_of(table), parameters=self.parameters_in(name))
