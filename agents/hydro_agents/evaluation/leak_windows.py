"""The detectors of a leakage protocol, and the part ``windows``: each of them reads windows of every condition."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.alarm import AlarmSettings
from hydro_agents.detection.detector import Detector, Windows, measured_run
from hydro_agents.detection.operations import ACTING
from hydro_agents.evaluation.leak_protocol import HEALTHY, LeakProtocol
from hydro_agents.evaluation.parts import Cell
from hydro_agents.running.cases import Cases, ControllerError
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_env import ConfigurationError, TaskConfig

READ = ("score", "probability", "flow_lpm", "low_lpm", "high_lpm")
"""Columns of a reading, NaN in a window without an answer; besides, ``otherwise`` is its cause."""


class Watch(NamedTuple):
    """A detector under an alarm."""

    detector: Detector  # reads successive windows of the same axes
    settings: AlarmSettings


@dataclass(frozen=True)
class Detectors:
    """The detectors of a protocol by name, and those that also watch under an alarm."""

    detectors: Mapping[str, Detector]
    alarms: Mapping[str, Watch] = field(default_factory=dict)


def windows(protocol: LeakProtocol, chosen: Detectors) -> Iterator[Cell]:
    """Every detector on the windows of every condition; healthy validation windows of the base set its threshold."""
    for name, condition in protocol.conditions.items():
        config, known = protocol.task_in(name), protocol.known_task(name)
        samples = round(condition.duration / config.control_period)
        for reader, detector in chosen.detectors.items():
            reads = protocol.reads(name, reader)
            reason = detector.refuses(known, samples) if reads else ""
            if name == protocol.base and detector.threshold is None and (reason or not reads):
                yield Cell(reader, name, jobs=(Job(without_threshold),))
            elif reason:
                yield Cell(reader, name, refused=reason)
            if reason or not reads:
                continue
            choice, digest = protocol.detectors[reader], fingerprint(detector)
            count = max(round(condition.share * choice.windows), 1)
            groups = [(level, count, False) for level in protocol.levels_in(name)]
            if name == protocol.base:
                groups.append((HEALTHY, choice.validation_windows, True))
            for level, number, validation in groups:
                cases = protocol.cases_in(name, level, number, validation)
                parts = [cases.part(first, first + choice.batch) for first in range(0, number, choice.batch)]
                arguments = (config, known, condition.acting, samples)
                jobs = tuple(Job(read, detector, (*arguments, part), digest) for part in parts)
                place = {"detector": reader, "condition": name, "level": level, "validation": validation}
                yield Cell(reader, name, place, jobs)


def without_threshold(_: None) -> Columns:
    """No verdict follows from scores without a threshold.

    Raises:
        ConfigurationError: always.
    """
    raise ConfigurationError("no threshold: it read no healthy validation windows")


def read(detector: Detector, config: TaskConfig, known: TaskConfig, acting: str, samples: int, cases: Cases) -> Columns:
    """Simulate windows and read them.

    Args:
        detector: reads the windows.
        config: task of the runs.
        known: task as known to the detector.
        acting: controller of the axes.
        samples: of a window.
        cases: of the runs, one window each.

    Returns:
        The columns of :func:`simulated_windows`, those of :data:`READ` and ``otherwise``, each (N,).

    Raises:
        ControllerError: the controller of the axes failed.
        ConfigurationError: a run cannot begin.
    """
    try:
        signals, columns = simulated_windows(config, acting, cases, samples)
        good = np.flatnonzero(columns["failed"] == 0.0)
        reading = detector.read(Windows.of(signals[good]), known) if len(good) else None
    except ControllerError:
        raise
    except ConfigurationError as error:
        raise ConfigurationError(f"the condition cannot begin: {error}") from None
    columns |= {name: np.full(len(cases), np.nan) for name in (*READ, "otherwise")}
    if reading is not None:
        for name in READ:
            columns[name][good] = np.where(reading.answers, getattr(reading, name), np.nan)
        columns["otherwise"][good] = reading.cause
    return columns


def simulated_windows(
    config: TaskConfig, acting: str, cases: Cases, samples: int
) -> tuple[NDArray[np.float64], Columns]:
    """Measured windows (N, 5, samples) in SI units, cut from runs at places set by the seed, and their true values.

    These are ``seed``, ``leak_lpm`` (at the end of the window), ``error_mm`` (mean position error of the run) and
    ``failed`` (of the run), each (N,).

    Raises:
        ControllerError: the controller of the axes failed.
        ConfigurationError: a run cannot begin.
    """
    controller = ACTING[acting].make(config, len(cases), int(cases.seeds[0]))
    signals, run = measured_run(config, controller, cases, states=True)
    spare = config.steps - samples
    places = [np.random.default_rng([int(seed), 13]).integers(spare // 2, spare + 1) for seed in cases.seeds]
    cut = np.stack([axis[:, first : first + samples] for axis, first in zip(signals, places, strict=True)])
    error = 1e3 * np.abs(run.position.astype(np.float64) - run.reference).mean(axis=1)
    return cut, {
        "seed": cases.seeds.astype(np.float64),
        "leak_lpm": run.leakage_flow_lpm.astype(np.float64),
        "error_mm": error,
        "failed": (run.failed_at >= 0).astype(np.float64),
    }
