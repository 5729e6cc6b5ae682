"""The protocol as data: conditions, each with an operation of the axes, faults, and changes of plant and sensors."""

from __future__ import annotations

import hashlib
import json
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field, StringConstraints, model_validator

from hydro_agents.detection.detectors import DetectorChoice
from hydro_agents.detection.operations import ACTING, MOTIONS
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import LEAK_THRESHOLDS, LEAKAGE
from hydro_agents.running.tasks import Surroundings, read_task
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, read_yaml, validate
from hydro_env.folders import config_file
from hydro_env.mistakes import did_you_mean, kept, known_name, refuse, unknown
from hydro_env.task.configuration import LEAKAGE_LIMIT, task_config
from hydro_env.task.faults import FAULTS, fault_limits

KIND: Literal["leakage"] = "leakage"
"""``kind`` of such a protocol in its file."""

HEALTHY, DRAWN = 0.0, -1.0
"""Levels of drawn leaks: from the healthy range of the task, and from all of its ranges with half of the axes
healthy."""

Name = Annotated[str, StringConstraints(pattern=r"^\w[\w.+-]{0,39}$")]
Level = Annotated[float, Field(ge=DRAWN, le=LEAKAGE_LIMIT)]


class LeakCondition(Surroundings):
    """One condition; the detectors do not know it."""

    group: str = Field("other", description="conditions that belong together in tables and pictures")
    label: str = Field("", description="short text; default: the name")
    acting: Annotated[str, known_name(ACTING, "controller")] = Field(
        "PID", description=f"controller of the axes: {', '.join(ACTING)}"
    )
    motion: Annotated[str, known_name(MOTIONS, "motion")] = Field(
        "ordinary", description=f"motion of the axes: {', '.join(MOTIONS)}"
    )
    begins: Literal["at rest", "anywhere"] = Field(
        "at rest", description="at rest: windows are the starts of runs; anywhere: windows are cut from longer runs"
    )
    duration: float = Field(2.0, gt=0.0, le=60.0, description="s; length of the windows")
    levels: tuple[Level, ...] | None = Field(
        None, min_length=1, description="l/min at 100 bar; 0: healthy; -1: drawn, half healthy; default: protocol"
    )
    share: float = Field(1.0, gt=0.0, le=10.0, description="windows per level, relative to the detector's number")
    detectors: tuple[str, ...] | None = Field(None, description="detectors that read it; default: all")
    faults: dict[Annotated[str, known_name(FAULTS, "fault")], float] = Field(
        default_factory=dict, description="magnitude of each fault, by name"
    )

    @model_validator(mode="after")
    def _known(self) -> LeakCondition:
        for name, size in self.faults.items():
            low, high = fault_limits(name)
            if not low <= size <= high:
                raise ValueError(f"faults: {name} = {size:g}: must be within {low:g} to {high:g}")
        if self.begins == "anywhere" and self.task.get("leakage", {}).get("schedule", "constant") != "constant":
            raise ValueError("begins: a leak that changes needs windows that begin at rest")
        return self


class LeakProtocol(Group):
    """A leakage protocol; ``configs/protocols/leakage.yaml`` is the one of the project."""

    kind: Literal["leakage"] = KIND
    title: str = "Leak detection"
    task: TaskConfig = Field(default_factory=TaskConfig)
    levels: tuple[Level, ...] = Field((HEALTHY, 0.3, 1.0), min_length=1)
    detectors: dict[str, DetectorChoice] = Field(min_length=1)
    alarms: dict[str, str] = Field(
        default_factory=dict, description="by detector: file of the settings of its alarm (hydro alarms writes it)"
    )
    alarm_hours: float = Field(0.0, ge=0.0, le=1e4, description="of healthy axes under each alarm; 0: no alarms")
    bound_conditions: tuple[Name, ...] = Field((), description="for which the Cramér–Rao bound is computed")
    bound_windows: int = Field(24, ge=1, le=10_000, description="of them, per level")
    base: Name = Field("ordinary", description="the condition with all leak sizes, to which the others are compared")
    conditions: dict[Name, LeakCondition] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> LeakProtocol:
        if self.base not in self.conditions:
            raise ValueError(
                f"base: '{self.base}' is not one of the conditions{did_you_mean(self.base, self.conditions)}"
            )
        strange = [name for name in self.bound_conditions if name not in self.conditions]
        if strange:
            guess = did_you_mean(strange[0], self.conditions)
            raise ValueError(f"bound_conditions: '{strange[0]}' is not one of the conditions{guess}")
        foreign = [name for name in self.alarms if name not in self.detectors]
        if foreign:
            guess = did_you_mean(foreign[0], self.detectors)
            raise ValueError(f"alarms: '{foreign[0]}' is not one of the detectors{guess}")
        for name, condition in self.conditions.items():
            foreign = [detector for detector in condition.detectors or () if detector not in self.detectors]
            if foreign:
                raise ValueError(f"conditions.{name}: detectors: {unknown(foreign[0], self.detectors, 'detector')}")
        return self

    @classmethod
    def from_yaml(cls, path: str | Path) -> LeakProtocol:
        """Read a protocol.

        Raises:
            ConfigurationError: an unknown key or value; the message names the file and the condition.
        """
        values, folder = read_yaml(path), Path(path).parent
        errors: list[ConfigurationError] = []
        with kept(errors):
            if "task" in values:
                values["task"] = read_task(values.pop("task"), Path(path))
        if isinstance(values.get("alarms"), dict):
            values["alarms"] = {name: str(folder / str(file)) for name, file in values["alarms"].items()}
        conditions = values.get("conditions")
        for condition in conditions.values() if isinstance(conditions, dict) else ():
            with kept(errors):
                if isinstance(condition, dict) and isinstance(condition.get("rig"), str):
                    condition["rig"] = str(config_file("rigs", condition.pop("rig"), folder))
        with kept(errors):
            protocol = validate(cls, values, str(path))
        refuse(errors, str(path))
        for name in protocol.conditions:
            with kept(errors):
                protocol.task_in(name)
        refuse(errors, str(path))
        return protocol

    def moved(self, task: str | None, rig: str | Path | None) -> LeakProtocol:
        """The protocol with another task, or on another rig.

        Raises:
            ConfigurationError: the task or rig does not exist, or a condition does not fit it.
        """
        base = task_config(self.task if task is None else task, rig=rig)
        moved = validate(LeakProtocol, {**self.model_dump(), "task": base}, "protocol")
        for name in moved.conditions:
            moved.task_in(name)
        return moved

    def task_in(self, name: str) -> TaskConfig:
        """The task of the runs of a condition.

        Raises:
            ConfigurationError: the changed task is impossible.
        """
        condition = self.conditions[name]
        task = MOTIONS[condition.motion].change(condition.task_on(self.task, f"conditions.{name}"))
        runs = 1.0 if condition.begins == "at rest" else 3.0
        return task_config(task, episode_duration=runs * condition.duration)

    def known_task(self, name: str) -> TaskConfig:
        """The task as known to the detectors: another rig changes the data sheet; no other change is visible."""
        rig = self.conditions[name].rig
        return self.task if rig is None else task_config(self.task, rig=rig)

    def levels_in(self, name: str) -> tuple[float, ...]:
        """Leak levels of a condition."""
        return self.conditions[name].levels or self.levels

    def reads(self, name: str, detector: str) -> bool:
        """Whether a detector reads the windows of a condition."""
        chosen, groups = self.conditions[name].detectors, self.detectors[detector].groups
        return (chosen is None or detector in chosen) and (not groups or self.conditions[name].group in groups)

    def cases_in(self, name: str, level: float, count: int, validation: bool = False) -> Cases:
        """The first ``count`` cases of a level; every level and condition has the same plants."""
        condition, task = self.conditions[name], self.task_in(name)
        seeds = np.array((LEAK_THRESHOLDS if validation else LEAKAGE).take(count))
        healthy = np.full(count, level == HEALTHY)
        if level == DRAWN:
            healthy = np.arange(count) % 2 == 0
        share = np.array([np.random.default_rng([int(seed), 11]).random() for seed in seeds])
        (a, b), (c, d) = np.log(task.leakage.healthy_range), np.log(task.leakage.faulty_range)
        drawn = np.exp(np.where(healthy, a + share * (b - a), c + share * (d - c)))
        flow = np.where(healthy | (level == DRAWN), drawn, level)
        faults = {fault: np.full(count, size) for fault, size in condition.faults.items()}
        return Cases(seeds, flow, None, condition.parameters_on(task) or None, faults or None)

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the whole protocol, including all files that it names, as sorted JSON."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def table(self) -> pd.DataFrame:
        """One row per condition: group, label, controller of the axes, changes (JSON)."""
        own = {"group", "label", "acting", "motion", "begins", "duration", "levels", "share", "detectors"}
        rows: list[dict[str, Any]] = []
        for name, condition in self.conditions.items():
            changes = condition.model_dump(mode="json", exclude_defaults=True, exclude=own)
            rows.append(
                {
                    "condition": name,
                    "group": condition.group,
                    "label": condition.label or name,
                    "acting": condition.acting,
                    "motion": condition.motion,
                    "begins": condition.begins,
                    "duration_s": condition.duration,
                    "trained": ACTING[condition.acting].trained,
                    "changes": json.dumps(changes, ensure_ascii=False) if changes else "",
                }
            )
        return pd.DataFrame(rows)


def is_leak_protocol(file: Path) -> bool:
    """Whether a file holds a leakage protocol."""
    return read_yaml(file).get("kind") == KIND
