"""Robustness protocols: controllers on paired cases under conditions, each a set of changes of task, leak and plant."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, Field

from hydro_agents.controllers.base import Controller, ObservationLayout
from hydro_agents.controllers.registry import controller_with_gains
from hydro_agents.evaluation.conditions import Cell, Condition, Protocol
from hydro_agents.evaluation.metrics import rollout_metrics
from hydro_agents.learning.loading import load_controller
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.limit_cycles import standstill_metrics, standstill_task
from hydro_agents.running.seeds import LEDGER, SEED_MARK, SEEDS_PER_FAMILY, SeedRange
from hydro_agents.running.tasks import between, mappings
from hydro_env import REFERENCE_FAMILIES, ConfigurationError, TaskConfig
from hydro_env.errors import at
from hydro_env.files import Group, read_yaml, whole_group
from hydro_env.mistakes import Kept, kept, known_name
from hydro_env.task.configuration import LEAKAGE_LIMIT, Family
from hydro_env.task.reference_signals import MOVING_FAMILIES
from hydro_env.task.rig import merged
from hydro_env.types import ByName
from hydro_env.units import Number

FAMILIES_OF_PLANTS = [name for name, each in LEDGER.items() if each.count >= len(REFERENCE_FAMILIES) * SEEDS_PER_FAMILY]
PlantSeeds = Annotated[str, known_name(FAMILIES_OF_PLANTS, "range of seeds")]


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) != len(values):
        raise ValueError("has a duplicate entry")
    if "user" in values and len(values) > 1:
        raise ValueError("'user' must stand alone")
    return values


Level = Annotated[Number, between(1e-6, LEAKAGE_LIMIT, " l/min")]
Levels = Annotated[tuple[Level, ...], Field(min_length=1), AfterValidator(_distinct)]
Families = Annotated[tuple[Family, ...], Field(min_length=1), AfterValidator(_distinct)]


class PairedCondition(Condition):
    """One condition; the controllers do not know it."""

    leak_levels: Levels | None = None  # l/min at 100 bar; default: protocol
    families: Families | None = None  # default: those of the protocol
    plants: int | None = Field(None, ge=3, le=SEEDS_PER_FAMILY)  # per level and family; default: protocol
    # By name; controllers for this condition: as in --agent, or the path of a file of gains
    controllers: dict[str, str | ByName] = {}


def paired(levels: Sequence[float], families: Sequence[str], plants: int, seeds: SeedRange) -> pd.DataFrame:
    """One row per leak level, family and plant, with its seed.

    A family has the same plants at every level; families have different plants.
    """
    table = pd.DataFrame(product(levels, families, range(plants)), columns=["leakage_flow_lpm", "family", "plant"])
    return table.assign(seed=seeds.of_family(table["family"].map(REFERENCE_FAMILIES.index), table["plant"]))


class PairedCases(Group):
    """Number and kind of paired cases."""

    leak_levels: Levels = (0.03, 1.0, 4.0)  # l/min at 100 bar
    families: Families = MOVING_FAMILIES
    plants: int = Field(8, ge=3, le=SEEDS_PER_FAMILY)  # per level and family
    seeds: PlantSeeds = "ROBUSTNESS"  # of the plants: a range of the ledger of seeds, by its name
    standstill_plants: int = Field(4, ge=0, le=SEEDS_PER_FAMILY)  # per leak, for limit cycles; 0: no search


class RobustnessProtocol(PairedCases, Protocol[PairedCondition]):
    """A protocol of controllers on paired cases; ``configs/protocols`` holds some.

    A plant has the same seed at every leak level and in every condition.
    """

    parts: ClassVar[tuple[str, ...]] = ("cases", "limit_cycles")
    kind: Literal["robustness"] = "robustness"
    title: str = "Robustness"
    chunk: int = Field(128, ge=1, le=2048)  # cases of a job; fixed: no result depends on the machine
    # l/min; search for limit cycles under each condition without its own leak levels
    standstill_leak_levels: Levels = (0.03, 1.0, 8.0)

    @whole_group
    def _possible(self) -> "RobustnessProtocol":
        if "all" in self.conditions:
            raise ValueError("conditions: 'all' is the name of their mean")
        return self

    def cells(self, chosen: "Participants") -> Iterator[Cell]:
        """Every controller on the cases of every condition, and after a small step of the reference and back."""
        for name in self.conditions:
            yield from self._cells("cases", tracked, chosen, name, self.tasks[name], self.cases_in(name))
        for name in self.conditions if self.standstill_plants else ():
            still, cases = standstill_task(self.tasks[name]), self.standstill_cases_in(name)
            yield from self._cells("limit_cycles", at_rest, chosen, name, still, cases)

    def _cells(
        self,
        table: str,
        work: Callable[..., Columns],
        chosen: "Participants",
        condition: str,
        task: TaskConfig,
        listed: pd.DataFrame,
    ) -> Iterator[Cell]:
        """The listed cases under a condition, a cell for each controller, in chunks that ``work`` measures."""
        cases = self.cases_of(condition, listed).chunks(self.chunk)
        known = {str(column): listed[column].to_numpy() for column in listed}
        known |= {"condition": condition, "group": self.conditions[condition].group}
        for name in chosen.controllers:
            acting = chosen.of(name, condition, self)
            if isinstance(acting, str):
                yield Cell(table, name, condition, refused=acting)
                continue
            controller, seed = split_name(name)
            digest = fingerprint(acting)
            jobs = tuple(Job(work, acting, (task, part), digest) for part in cases)
            yield Cell(table, name, condition, {**known, "controller": controller, "training_seed": seed}, jobs)

    @classmethod
    def prepare(cls, values: ByName, file: Path, errors: Kept) -> None:
        """Read the gains of controllers for a condition."""
        for condition in mappings(values.get("conditions")).values():
            chosen: Any = condition.get("controllers")
            for name, what in chosen.items() if isinstance(chosen, dict) else ():
                if isinstance(what, str) and what.endswith(".yaml"):
                    with kept(errors):
                        chosen[name] = read_yaml(file.parent / what)

    def changed_task(self, name: str) -> TaskConfig:
        """The task with the changes of a condition; a condition whose only reference is 'user' draws no other."""
        condition = self.conditions[name]
        if condition.families == ("user",):
            condition = condition.changed(task=merged(condition.task, {"references": {"weights": {"user": 1.0}}}))
        return condition.task_on(self.task, f"conditions.{name}")

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
        families = table["family"].to_numpy(str)
        return Cases(
            table["seed"].to_numpy(np.int64),
            table["leakage_flow_lpm"].to_numpy(float),
            None if (families == "user").all() else families,
            self.conditions[name].parameters_on(self.tasks[name]),
        )

    def known_of(self, name: str) -> ByName:
        """See :meth:`~hydro_agents.evaluation.conditions.Protocol.known_of`."""
        return {"control_period_s": self.tasks[name].control_period, "cases": len(self.cases_in(name))}


def tracked(controller: Controller, config: TaskConfig, cases: Cases) -> Columns:
    """The metrics of cases under a controller."""
    rollout = run_cases(config, controller, cases)
    families = np.full(len(cases), "user") if cases.families is None else cases.families
    preview = max(config.references.preview_times, default=0.0)
    metrics = rollout_metrics(rollout, families, config.control_period, preview)
    return {name: values.astype(float) for name, values in metrics.items()}


def at_rest(controller: Controller, config: TaskConfig, cases: Cases) -> Columns:
    """Limit cycles of cases whose task is a standstill."""
    return standstill_metrics(run_cases(config, controller, cases), config)


@dataclass(frozen=True)
class Participants:
    """Controllers by name, the baseline first."""

    controllers: Mapping[str, Controller]
    corrects: Mapping[str, str] = field(default_factory=dict)  # names of policies and of what they correct

    def of(self, name: str, condition: str, protocol: RobustnessProtocol) -> Controller | str:
        """The controller that runs under a condition, or the reason why none can.

        The protocol may name one for this condition; else the general one runs if it knows such observations.

        Raises:
            ConfigurationError: the controller for this condition cannot be made.
        """
        entry, task = protocol.conditions[condition], protocol.tasks[condition]
        if name in entry.controllers:
            with at(f"conditions.{condition}.controllers.{name}"):
                what = entry.controllers[name]
                return load_controller(what if isinstance(what, str) else controller_with_gains(what, task), task, name)
        if entry.rig is not None:
            return "no controller of this name is tuned for this rig"
        here, known = ObservationLayout.of(task), ObservationLayout.of(protocol.task)
        if here.control_period != known.control_period:
            return f"no controller of this name is tuned for a control period of {1e3 * here.control_period:g} ms"
        if here != known:
            return "the observations differ from those that it knows"
        return self.controllers[name]


def participants(
    controllers: Mapping[str, Controller | str | Path], protocol: RobustnessProtocol, corrects: Mapping[str, str] = {}
) -> Participants:
    """Make the controllers of a protocol.

    Args:
        controllers: by name, objects with ``predict`` or texts of
            :func:`~hydro_agents.learning.loading.load_controller`. The first one is the baseline. ``NAME#0``,
            ``NAME#1``, … are training seeds of one controller.
        protocol: the protocol.
        corrects: names of policies and of what they correct.

    Raises:
        ConfigurationError: there is no controller, a name is wrong, or a controller cannot be made for its task.
    """
    if not controllers:
        raise ConfigurationError("protocol: needs at least one controller")
    known: dict[tuple[str, int], str] = {}
    for name in controllers:
        same = known.setdefault(split_name(name), name)
        if same != name:
            raise ConfigurationError(f"controllers '{same}' and '{name}': name the same training seed of a controller")
    ready = {name: load_controller(what, protocol.task, name) for name, what in controllers.items()}
    return Participants(ready, corrects)


def split_name(name: str) -> tuple[str, int]:
    """Controller and training seed of a name: ``PPO#3`` is seed 3 of PPO; a name without a mark is seed 0.

    Raises:
        ConfigurationError: the part after the mark is not a number.
    """
    controller, mark, seed = name.partition(SEED_MARK)
    if not controller or (mark and not seed.isdecimal()):
        raise ConfigurationError(f"controller '{name}': must be NAME, or NAME#0, NAME#1, … for training seeds")
    return controller, int(seed) if mark else 0
