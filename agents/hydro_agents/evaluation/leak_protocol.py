"""Leakage protocols: detectors under conditions, each an operation of the axes, faults, and changes of the task."""

from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

from hydro_agents.controllers.by_name import imported
from hydro_agents.detection.detector import Detector, Windows, cut, measured_run
from hydro_agents.detection.operations import ACTING, MOTIONS, UNSEEN
from hydro_agents.evaluation.conditions import Cell, Condition, Name, Protocol
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.seeds import LEAK_THRESHOLDS, LEAKAGE
from hydro_agents.running.tasks import Surroundings, between
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, whole_group
from hydro_env.mistakes import known_name, refuse_unknown
from hydro_env.task.configuration import LEAKAGE_LIMIT, task_config
from hydro_env.task.faults import FAULTS, fault_limits
from hydro_env.types import ByName, Floats
from hydro_env.units import Number

HEALTHY = 0.0  # level of leaks that are drawn from the healthy range of the task
# Of the package above this one: they come by name.
ESTIMATOR = "hydro_rig.estimation.estimator:EstimatorDetector"
LEAK_BOUND = "hydro_rig.estimation.known_windows:leak_bound"

Level = Annotated[Number, between(HEALTHY, LEAKAGE_LIMIT, " l/min")]


class DetectorChoice(Group):
    """A detector, and how many windows it reads in a protocol."""

    kind: str  # head, estimator, or module:attribute for your own
    weights: str | None = None  # of a head: a path; default: the shipped one
    windows: int = Field(1000, ge=1, le=100_000)  # windows per leak level
    validation_windows: int = Field(4000, ge=20, le=100_000)  # healthy ones, for 1 % false alarms
    batch: int = Field(500, ge=1, le=10_000)  # windows per job; fixed: no result depends on the machine

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in ("head", "estimator") and ":" not in kind:
            raise ValueError("must be head, estimator, or module:attribute")
        return kind


def make_detector(choice: DetectorChoice) -> Detector:
    """The detector of a choice.

    Raises:
        ConfigurationError: its weights cannot be read, or the object that it names is no detector.
    """
    if choice.kind == "head":
        from hydro_agents.detection.monitor import HeadDetector  # a detector of your own needs no network

        return HeadDetector.load(choice.weights)
    named = imported(ESTIMATOR if choice.kind == "estimator" else choice.kind)
    detector = named() if isinstance(named, type) else named
    if missing := [part for part in ("threshold", "refuses", "read") if not hasattr(detector, part)]:
        raise ConfigurationError(f"'{choice.kind}': is no leak detector, it has no {', '.join(missing)}")
    return detector


class LeakCondition(Condition):
    """One condition; the detectors do not know it."""

    acting: Annotated[str, known_name(ACTING, "controller")] = "PID"  # controller of the axes
    motion: Annotated[str, known_name(MOTIONS, "motion")] = "ordinary"  # of the axes
    # At rest: windows are the starts of runs; anywhere: windows are cut from longer runs
    begins: Literal["at rest", "anywhere"] = "at rest"
    duration: float = Field(2.0, gt=0.0, le=60.0)  # s; length of the windows
    levels: tuple[Level, ...] | None = Field(None, min_length=1)  # l/min; 0: healthy; default: protocol
    share: float = Field(1.0, gt=0.0, le=10.0)  # windows per level, relative to the detector's number
    detectors: tuple[str, ...] | None = None  # detectors that read it; default: all
    faults: dict[Annotated[str, known_name(FAULTS, "fault")], Number] = {}  # magnitude of each fault, by name

    @whole_group
    def _known(self) -> "LeakCondition":
        for name, size in self.faults.items():
            low, high = fault_limits(name)
            if not low <= size <= high:
                raise ValueError(f"faults: {name} = {size:g}: must be within {low:g} to {high:g}")
        if self.begins == "anywhere" and self.task.get("leakage", {}).get("schedule", "constant") != "constant":
            raise ValueError("begins: a leak that changes needs windows that begin at rest")
        return self


class LeakProtocol(Protocol[LeakCondition]):
    """A leakage protocol; ``configs/protocols/leakage.yaml`` is the one of the project."""

    who: ClassVar[str] = "detector"
    unchanged: ClassVar[frozenset[str]] = (
        frozenset(LeakCondition.model_fields) - set(Surroundings.model_fields) - {"faults"}
    )
    parts: ClassVar[tuple[str, ...]] = ("windows", "bound")
    kind: Literal["leakage"] = "leakage"
    title: str = "Leak detection"
    levels: tuple[Level, ...] = Field((HEALTHY, 0.3, 1.0), min_length=1)
    detectors: dict[str, DetectorChoice] = Field(min_length=1)
    bound_conditions: tuple[Name, ...] = ()  # for which the Cramér–Rao bound is computed
    bound_windows: int = Field(24, ge=1, le=10_000)  # of them, per level
    base: Name = "ordinary"  # the condition with all leak sizes, to which the others are compared

    @whole_group
    def _consistent(self) -> "LeakProtocol":
        refuse_unknown("base", (self.base,), self.conditions, "condition")
        refuse_unknown("bound_conditions", self.bound_conditions, self.conditions, "condition")
        for name, condition in self.conditions.items():
            refuse_unknown(f"conditions.{name}: detectors", condition.detectors or (), self.detectors, "detector")
        return self

    def cells(self, chosen: Mapping[str, Detector]) -> Iterator[Cell]:
        """Every detector on the windows of every condition, and the bound where a key asks for it."""
        yield from windows(self, chosen)
        if self.bound_conditions:
            yield from imported(LEAK_BOUND)(self)

    def changed_task(self, name: str) -> TaskConfig:
        """The task of the runs of a condition.

        Raises:
            ConfigurationError: the changed task is impossible.
        """
        condition = self.conditions[name]
        task = MOTIONS[condition.motion](condition.task_on(self.task, f"conditions.{name}"))
        runs = 1.0 if condition.begins == "at rest" else 3.0
        return task_config(task, episode_duration=runs * condition.duration)

    def known_task(self, name: str) -> TaskConfig:
        """The task as known to the detectors: another rig changes the data sheet; no other change is visible."""
        rig = self.conditions[name].rig
        return self.task if rig is None else task_config(self.task, rig=rig)

    def cases_in(self, name: str, level: float, count: int, validation: bool = False) -> Cases:
        """The first ``count`` cases of a level; every level and condition has the same plants."""
        condition, task = self.conditions[name], self.tasks[name]
        ledger = LEAK_THRESHOLDS if validation else LEAKAGE
        seeds, flow = np.array(ledger.take(count)), np.full(count, level)
        if level == HEALTHY:
            share = np.array([np.random.default_rng([seed, 11]).random() for seed in seeds])
            low, high = np.log(task.leakage.healthy_range)
            flow = np.exp(low + share * (high - low))
        faults = {fault: np.full(count, size) for fault, size in condition.faults.items()}
        return Cases(seeds, flow, None, condition.parameters_on(task), faults)

    def known_of(self, name: str) -> ByName:
        """See :meth:`~hydro_agents.evaluation.conditions.Protocol.known_of`."""
        condition = self.conditions[name]
        known = condition.model_dump(include={"acting", "motion", "begins"})
        return known | {"duration_s": condition.duration, "trained": condition.acting not in UNSEEN}


READ = ("score", "flow_lpm", "low_lpm", "high_lpm")  # of a reading, NaN without an answer; otherwise is its cause


def windows(protocol: LeakProtocol, chosen: Mapping[str, Detector]) -> Iterator[Cell]:
    """Every detector on the windows of every condition; healthy validation windows of the base set its threshold."""
    for name, condition in protocol.conditions.items():
        samples = round(condition.duration / protocol.tasks[name].control_period)
        for reader, detector in chosen.items():
            reads = condition.detectors is None or reader in condition.detectors
            reason = detector.refuses(protocol.known_task(name), samples) if reads else ""
            if name == protocol.base and detector.threshold is None and (reason or not reads):
                reason = "no threshold: it reads no healthy validation windows"
            if reason:
                yield Cell("windows", reader, name, refused=reason)
            elif reads:
                yield from _cells(protocol, name, reader, detector, samples)


def _cells(protocol: LeakProtocol, name: str, reader: str, detector: Detector, samples: int) -> Iterator[Cell]:
    condition, choice, digest = protocol.conditions[name], protocol.detectors[reader], fingerprint(detector)
    count = max(round(condition.share * choice.windows), 1)
    groups = [(level, count, False) for level in condition.levels or protocol.levels]
    if name == protocol.base:
        groups.append((HEALTHY, choice.validation_windows, True))
    for level, number, validation in groups:
        fixed = (protocol.tasks[name], protocol.known_task(name), condition.acting, samples)
        cases = protocol.cases_in(name, level, number, validation).chunks(choice.batch)
        jobs = tuple(Job(read, detector, (*fixed, part), digest) for part in cases)
        place = {"detector": reader, "condition": name, "level": level, "validation": validation}
        yield Cell("windows", reader, name, place, jobs)


def read(detector: Detector, config: TaskConfig, known: TaskConfig, acting: str, samples: int, cases: Cases) -> Columns:
    """Simulate a window of each case and read it, with the task as known to the detector.

    Returns:
        The columns of :func:`simulated_windows`, those of :data:`READ` and ``otherwise``, each (N,).
    """
    signals, columns = simulated_windows(config, acting, cases, samples)
    for name in (*READ, "otherwise"):
        columns[name] = np.full(len(cases), np.nan)
    good = np.flatnonzero(columns["failed"] == 0.0)
    if len(good):
        reading = detector.read(Windows.of(signals[good]), known)
        for name in READ:
            columns[name][good] = np.where(reading.answers, getattr(reading, name), np.nan)
        columns["otherwise"][good] = reading.cause
    return columns


def simulated_windows(config: TaskConfig, acting: str, cases: Cases, samples: int) -> tuple[Floats, Columns]:
    """Measured windows (N, 5, samples) in SI units, cut from runs at places set by the seed, and their true values.

    These are ``seed``, ``leak_lpm`` (at the end of the window), ``error_mm`` (mean position error of the run) and
    ``failed`` (of the run), each (N,).

    Raises:
        ControllerError: the controller of the axes failed.
        ConfigurationError: a run cannot begin.
    """
    signals, run = measured_run(config, ACTING[acting](config, len(cases), cases.seeds[0]), cases)
    spare = config.steps - samples
    places = [np.random.default_rng([seed, 13]).integers(spare // 2, spare + 1) for seed in cases.seeds]
    return cut(signals, np.array(places), samples), {
        "seed": cases.seeds.astype(float),
        "leak_lpm": run.leakage_flow_lpm.astype(float),
        "error_mm": 1e3 * np.abs(run.position.astype(float) - run.reference).mean(axis=1),
        "failed": (run.failed_at >= 0).astype(float),
    }
