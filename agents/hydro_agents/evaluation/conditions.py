"""A protocol as data: named conditions, and the jobs that measure every participant under them.

:class:`Protocol` has what every protocol has. Each kind of file adds its own keys:
:class:`~hydro_agents.evaluation.robustness_protocol.RobustnessProtocol` for controllers and
:class:`~hydro_agents.evaluation.leak_protocol.LeakProtocol` for detectors of leaks.
"""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Self, TypeVar

from pydantic import Field, StringConstraints

from hydro_agents.running.jobs import Job
from hydro_agents.running.tasks import Surroundings, mappings, read_task
from hydro_env import TaskConfig
from hydro_env.errors import at
from hydro_env.files import Group, read_yaml, validate
from hydro_env.folders import config_file
from hydro_env.mistakes import Kept, kept, refuse
from hydro_env.types import ByName


@dataclass(frozen=True)
class Cell:
    """One participant under one condition; the runner joins the rows of a table.

    A participant that cannot act under a condition has a cell with the reason in ``refused``, and no jobs. Rows without
    a participant, such as a bound, stand under a name of their own.
    """

    table: str  # of its rows, one of the protocol's ``parts``
    participant: str
    condition: str
    known: ByName = field(default_factory=dict)  # first columns of its rows: one value, or one per row
    jobs: tuple[Job, ...] = ()  # their columns follow each other
    refused: str = ""


Name = Annotated[str, StringConstraints(pattern=r"^\w[\w.+-]{0,39}$")]


class Condition(Surroundings):
    """One condition: its differences from the task of the protocol, which the participants do not know."""

    group: str = "other"  # conditions that belong together in tables and pictures
    label: str = ""  # short text for axes; default: the name


AnyCondition = TypeVar("AnyCondition", bound=Condition)


class Protocol(Group, Generic[AnyCondition]):
    """What every protocol has; ``configs/protocols`` holds some."""

    who: ClassVar[str] = "controller"  # what takes part; the name of its column in the tables
    parts: ClassVar[tuple[str, ...]]  # tables of the rows of its jobs, the main one first
    unchanged: ClassVar[frozenset[str]] = frozenset({"group", "label", "controllers"})  # fields that change no axis

    kind: str
    title: str
    task: TaskConfig = TaskConfig()
    conditions: dict[Name, AnyCondition] = Field(min_length=1)

    def cells(self, chosen: Any) -> Iterator[Cell]:
        """What is measured of the participants under every condition; each kind has its own."""
        raise NotImplementedError

    @classmethod
    def prepare(cls, values: ByName, file: Path, errors: Kept) -> None:
        """Replace what a kind of protocol names by its content, such as files beside its own; errors are collected."""

    @classmethod
    def from_yaml(cls, path: str | Path) -> Self:
        """Read a protocol; its task and rigs may be names, or paths relative to the file.

        Raises:
            ConfigurationError: unreadable file, unknown key, impossible value, or a condition without a possible task.
        """
        values, file = read_yaml(path), Path(path)
        errors: Kept = []
        with kept(errors):
            if "task" in values:
                values["task"] = read_task(values.pop("task"), file)
        cls.prepare(values, file, errors)
        for condition in mappings(values.get("conditions")).values():
            with kept(errors):
                if isinstance(condition.get("rig"), str):
                    condition["rig"] = str(config_file("rigs", condition.pop("rig"), file.parent))
        with kept(errors):
            protocol = validate(cls, values, path)
        refuse(errors, path)
        with at(path):
            _ = protocol.tasks
        return protocol

    def moved(self, task: TaskConfig) -> Self:
        """The protocol with another task.

        Raises:
            ConfigurationError: a condition does not fit it.
        """
        protocol = validate(type(self), {**self.model_dump(), "task": task}, "protocol")
        _ = protocol.tasks
        return protocol

    @cached_property
    def tasks(self) -> dict[str, TaskConfig]:
        """The task under each condition.

        Raises:
            ConfigurationError: the changed task is impossible; the message names the condition.
        """
        tasks = {}
        errors: Kept = []
        for name in self.conditions:
            with kept(errors):
                tasks[name] = self.changed_task(name)
        refuse(errors, "conditions")
        return tasks

    def changed_task(self, name: str) -> TaskConfig:
        """The task of the protocol with the changes of a condition.

        Raises:
            ConfigurationError: the changed task is impossible.
        """
        return self.conditions[name].task_on(self.task, f"conditions.{name}")

    def known_of(self, name: str) -> ByName:
        """Further columns of a condition in :meth:`rows`; each kind has its own."""
        raise NotImplementedError

    def rows(self) -> Iterator[ByName]:
        """One row per condition: group, label, changes (JSON), and what its kind tells."""
        for name, condition in self.conditions.items():
            changes = condition.model_dump(mode="json", exclude_defaults=True, exclude=set(self.unchanged))
            yield {
                "condition": name,
                "group": condition.group,
                "label": condition.label or name,
                "changes": json.dumps(changes, ensure_ascii=False),
                **self.known_of(name),
            }

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the whole protocol, including all files that it names, as sorted JSON."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()
