"""Robustness protocols: controllers on paired cases under conditions, each a set of changes of task, leak and plant."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import pandas as pd
from pydantic import Field, model_validator

from hydro_agents.evaluation.conditions import Name
from hydro_agents.evaluation.paired_cases import PairedProtocol, check_grid, paired
from hydro_agents.running.cases import Cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import LEDGER, SEEDS_PER_FAMILY
from hydro_agents.running.tasks import Factor, read_settings
from hydro_env import ConfigurationError
from hydro_env.files import Group, validate
from hydro_env.folders import config_file
from hydro_env.mistakes import kept
from hydro_env.task.configuration import Family

EXPERIMENTS = ("frequency", "force_step", "force_sine", "hold", "leak_price")
"""Parts about the task alone."""


class Sweep(Group):
    """Conditions that each fix one parameter of the plant at a factor of the nominal value."""

    group: str = "parameter"
    leak_levels: tuple[float, ...] | None = Field(None, min_length=1)
    families: tuple[Family, ...] | None = Field(None, min_length=1)
    plants: int | None = Field(None, ge=3, le=SEEDS_PER_FAMILY)
    factors: dict[str, tuple[Factor, ...]] = Field(min_length=1, description="by path of the parameter")

    def conditions(self) -> dict[str, dict[str, Any]]:
        """One condition per parameter and factor, as a mapping."""
        shared = self.model_dump(exclude={"factors"}, exclude_none=True)
        return {
            f"{path.split('.')[1]}_x{factor:g}": {
                **shared,
                "label": f"{path.split('.')[1].replace('_', ' ')} × {factor:g}",
                "factors": {path: factor},
            }
            for path, factors in self.factors.items()
            for factor in factors
        }


class RobustnessProtocol(PairedProtocol):
    """A robustness protocol; ``configs/protocols`` holds some. The key ``sweep`` of a file adds conditions."""

    kind: Literal["robustness"] = "robustness"
    title: str = "Robustness"
    chunk: int = Field(128, ge=1, le=256, description="cases of a job; fixed, so that no result depends on the machine")
    standstill_leak_levels: tuple[float, ...] = Field(
        (0.03, 1.0, 8.0),
        description="l/min; search for limit cycles under each condition without its own leak levels",
    )
    standstill_plants: int = Field(4, ge=0, le=SEEDS_PER_FAMILY, description="per level; 0: no search")
    bound_conditions: tuple[Name, ...] = Field((), description="conditions under which the best found is computed")
    bound_plants: int = Field(2, ge=1, le=SEEDS_PER_FAMILY, description="of them, per level and family: it is slow")
    experiments: bool = Field(True, description="also frequency response, stiffness, standstill, price of the leak")
    worst: int = Field(10, ge=1, le=1000, description="worst cases that the tables list per controller")

    @model_validator(mode="after")
    def _possible(self) -> RobustnessProtocol:
        check_grid(self.standstill_leak_levels, ())
        self.check_conditions("bound_conditions", self.bound_conditions)
        if "all" in self.conditions:
            raise ValueError("conditions: 'all' is the name of their mean")
        return self

    def asked(self) -> tuple[str, ...]:
        """The parts that the other keys ask for."""
        wanted = {
            "standstill": self.standstill_plants > 0,
            "best_found": bool(self.bound_conditions),
            **dict.fromkeys(EXPERIMENTS, self.experiments),
        }
        return ("tracking", *(name for name, asked in wanted.items() if asked))

    @classmethod
    def prepare(cls, values: dict[str, Any], file: Path, errors: list[ConfigurationError]) -> None:
        """Add the conditions of a sweep; read the settings of controllers, and find their weights."""
        conditions = values.get("conditions")
        if "sweep" in values and isinstance(conditions, dict):
            swept = validate(Sweep, values.pop("sweep"), f"{file}: sweep").conditions()
            twice = next((name for name in swept if name in conditions), None)
            if twice is not None:
                raise ConfigurationError(f"{file}: conditions.{twice}: is also in sweep")
            values["conditions"] = conditions = {**conditions, **swept}
        for condition in conditions.values() if isinstance(conditions, dict) else ():
            chosen = condition.get("controllers") if isinstance(condition, dict) else None
            with kept(errors):
                read_settings(chosen, file)
            for choice in chosen.values() if isinstance(chosen, dict) else ():
                if isinstance(choice, dict) and isinstance(choice.get("weights"), str):
                    shipped = pretrained_folder() / choice["weights"]
                    own = file.parent / choice["weights"]
                    choice["weights"] = str(shipped if shipped.with_suffix(".safetensors").exists() else own)

    def standstill_cases_in(self, name: str) -> tuple[Cases, pd.DataFrame]:
        """The cases of the search for limit cycles under a condition, and their table as in :meth:`cases_in`."""
        levels = self.conditions[name].leak_levels or self.standstill_leak_levels
        table = paired(levels, ("user",), self.standstill_plants, LEDGER[self.seeds])
        return self.cases_of(name, table), table

    def bound_cases_in(self, name: str) -> tuple[Cases, pd.DataFrame]:
        """The cases of a condition for the best found, and their table as in :meth:`cases_in`."""
        _, table = self.cases_in(name)
        table = table[table["plant"] < self.bound_plants].reset_index(drop=True)
        return self.cases_of(name, table), table

    def table(self) -> pd.DataFrame:
        """One row per condition: group, label, description, changes (JSON), control period, number of cases."""
        unchanged = {"group", "label", "description", "controllers"}
        return pd.DataFrame(
            [
                {
                    "condition": name,
                    "group": condition.group,
                    "label": condition.label or name,
                    "description": condition.description,
                    "changes": json.dumps(condition.model_dump(mode="json", exclude_defaults=True, exclude=unchanged)),
                    "control_period_s": self.task_in(name).control_period,
                    "cases": len(self.cases_in(name)[1]),
                }
                for name, condition in self.conditions.items()
            ]
        )


def protocol_named(name: str) -> tuple[RobustnessProtocol, Path]:
    """A protocol by its name in ``configs/protocols`` or by the path of a YAML file, and that file.

    Raises:
        ConfigurationError: the protocol does not exist or is wrong.
    """
    file = config_file("protocols", name)
    return RobustnessProtocol.from_yaml(file), file
