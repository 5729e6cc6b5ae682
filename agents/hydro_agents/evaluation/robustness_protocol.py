"""The protocol as data: named conditions, each a set of changes of the task, of the leak and of the plant."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field, StringConstraints, model_validator

from hydro_agents.running.cases import Cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import ROBUSTNESS, SEEDS_PER_FAMILY
from hydro_agents.running.settings_files import read_settings, read_task
from hydro_agents.running.surroundings import Factor, Surroundings
from hydro_env import REFERENCE_FAMILIES, ConfigurationError, TaskConfig
from hydro_env.files import Group, read_text, read_yaml, validate
from hydro_env.folders import config_file
from hydro_env.mistakes import did_you_mean, kept, refuse
from hydro_env.task.configuration import LEAKAGE_LIMIT, Family, task_config
from hydro_env.task.rig import merged

DRAWN_FAMILIES = tuple(name for name in REFERENCE_FAMILIES if name != "user")
Name = Annotated[str, StringConstraints(pattern=r"^\w[\w.+-]{0,39}$")]


class ControllerChoice(Group):
    """A variant of a controller that was tuned or trained for a condition."""

    kind: str = Field(description="as in a study: pid, ppo, or module:attribute")
    settings: dict[str, Any] = Field(default_factory=dict, description="gains, or the path of a YAML file")
    weights: str | None = Field(
        None, description="weights of a trained controller: a path, or a name in agents/hydro_agents/pretrained"
    )


class Condition(Surroundings):
    """One condition: its differences from the task of the protocol, which the controllers do not know."""

    group: str = Field("other", description="conditions that belong together in tables and pictures")
    label: str = Field("", description="short text for axes; default: the name")
    description: str = ""
    leak_levels: tuple[float, ...] | None = Field(None, min_length=1, description="l/min at 100 bar; default: protocol")
    families: tuple[Family, ...] | None = Field(None, min_length=1, description="default: those of the protocol")
    plants: int | None = Field(None, ge=3, le=SEEDS_PER_FAMILY, description="per level and family; default: protocol")
    controllers: dict[str, ControllerChoice] = Field(
        default_factory=dict, description="by name; controllers tuned or trained for this condition"
    )

    @model_validator(mode="after")
    def _possible(self) -> Condition:
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


class Protocol(Group):
    """A robustness protocol; ``configs/protocols`` holds some."""

    title: str = "Robustness"
    task: TaskConfig = Field(default_factory=TaskConfig)
    leak_levels: tuple[float, ...] = Field((0.03, 1.0, 4.0), min_length=1, description="l/min at 100 bar")
    families: tuple[Family, ...] = Field(DRAWN_FAMILIES, min_length=1)
    plants: int = Field(8, ge=3, le=SEEDS_PER_FAMILY, description="per level and family")
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
    conditions: dict[Name, Condition] = Field(min_length=1)

    @model_validator(mode="after")
    def _possible(self) -> Protocol:
        check_grid(self.leak_levels, self.families)
        check_grid(self.standstill_leak_levels, ())
        for name in self.bound_conditions:
            if name not in self.conditions:
                raise ValueError(f"bound_conditions: '{name}' is not a condition{did_you_mean(name, self.conditions)}")
        if "all" in self.conditions:
            raise ValueError("conditions: 'all' is the name of their mean")
        return self

    @classmethod
    def from_yaml(cls, path: str | Path) -> Protocol:
        """Read a protocol; its key ``sweep`` adds the conditions of a :class:`Sweep`.

        Task, rigs and settings of controllers may be paths of YAML files, relative to it.

        Raises:
            ConfigurationError: unreadable file, unknown key, impossible value, or a condition without a possible task.
        """
        values = read_yaml(path)
        folder = Path(path).parent
        errors: list[ConfigurationError] = []
        with kept(errors):
            if "task" in values:
                values["task"] = read_task(values.pop("task"), Path(path))
        conditions = values.get("conditions")
        if "sweep" in values and isinstance(conditions, dict):
            swept = validate(Sweep, values.pop("sweep"), f"{path}: sweep").conditions()
            twice = next((name for name in swept if name in conditions), None)
            if twice is not None:
                raise ConfigurationError(f"{path}: conditions.{twice}: is also in sweep")
            values["conditions"] = conditions = {**conditions, **swept}
        for condition in conditions.values() if isinstance(conditions, dict) else ():
            if not isinstance(condition, dict):
                continue
            with kept(errors):
                if isinstance(condition.get("rig"), str):
                    condition["rig"] = str(config_file("rigs", condition.pop("rig"), folder))
            chosen = condition.get("controllers")
            with kept(errors):
                read_settings(chosen, Path(path))
            for choice in chosen.values() if isinstance(chosen, dict) else ():
                if isinstance(choice, dict) and isinstance(choice.get("weights"), str):
                    shipped = pretrained_folder() / choice["weights"]
                    own = folder / choice["weights"]
                    choice["weights"] = str(shipped if shipped.with_suffix(".safetensors").exists() else own)
        with kept(errors):
            protocol = validate(cls, values, str(path))
        refuse(errors, str(path))
        try:
            _ = protocol.tasks
        except ConfigurationError as error:
            raise type(error)(f"{path}: {error}") from None
        return protocol

    def moved(self, task: str | None, rig: str | Path | None) -> Protocol:
        """The protocol with another task, or on another rig.

        Raises:
            ConfigurationError: the task or rig does not exist, or a condition does not fit it.
        """
        base = task_config(self.task if task is None else task, rig=rig)
        protocol = validate(Protocol, {**self.model_dump(), "task": base}, "protocol")
        _ = protocol.tasks
        return protocol

    @cached_property
    def tasks(self) -> dict[str, TaskConfig]:
        """The task under each condition.

        Raises:
            ConfigurationError: the changed task is impossible; the message names the condition.
        """
        tasks: dict[str, TaskConfig] = {}
        errors: list[ConfigurationError] = []
        for name in self.conditions:
            with kept(errors):
                tasks[name] = self._task(name)
        refuse(errors, "conditions")
        return tasks

    def task_in(self, name: str) -> TaskConfig:
        """The task under a condition."""
        return self.tasks[name]

    def _task(self, name: str) -> TaskConfig:
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
        table = _grid(condition.leak_levels or self.leak_levels, families, condition.plants or self.plants)
        return self._cases(name, table), table

    def standstill_cases_in(self, name: str) -> tuple[Cases, pd.DataFrame]:
        """The cases of the search for limit cycles under a condition, and their table as in :meth:`cases_in`."""
        levels = self.conditions[name].leak_levels or self.standstill_leak_levels
        table = _grid(levels, ("user",), self.standstill_plants)
        return self._cases(name, table), table

    def bound_cases_in(self, name: str) -> tuple[Cases, pd.DataFrame]:
        """The cases of a condition for the best found, and their table as in :meth:`cases_in`."""
        _, table = self.cases_in(name)
        table = table[table["plant"] < self.bound_plants].reset_index(drop=True)
        return self._cases(name, table), table

    def _cases(self, name: str, table: pd.DataFrame) -> Cases:
        families = table["family"].to_numpy().astype(str)
        drawn = None if (families == "user").all() else families
        levels = table["leakage_flow_lpm"].to_numpy(dtype=np.float64)
        return Cases(table["seed"].to_numpy(np.int64), levels, drawn, self.parameters_in(name))

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the whole protocol, including all files that it names, as sorted JSON."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

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


def _grid(levels: Sequence[float], families: Sequence[str], plants: int) -> pd.DataFrame:
    """One row per leak level, family and plant, with its seed."""
    rows = [
        (level, family, plant, ROBUSTNESS.of_family(REFERENCE_FAMILIES.index(family), plant))
        for level in levels
        for family in families
        for plant in range(plants)
    ]
    return pd.DataFrame(rows, columns=["leakage_flow_lpm", "family", "plant", "seed"])


def protocol_named(name: str) -> tuple[Protocol, Path]:
    """A protocol by its name in ``configs/protocols`` or by the path of a YAML file, and that file.

    Raises:
        ConfigurationError: the protocol does not exist or is wrong.
    """
    file = config_file("protocols", name)
    return Protocol.from_yaml(file), file


def file_sha256(path: Path) -> str:
    """SHA-256 of a text file, as ``sha256sum`` prints it for a file of UTF-8 text.

    Raises:
        ConfigurationError: the file cannot be read.
    """
    read_text(path)
    return hashlib.sha256(path.read_bytes()).hexdigest()
