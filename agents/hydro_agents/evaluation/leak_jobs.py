"""One job of the protocol: a detector reads some windows of one condition; its result is one file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import ObservationLayout
from hydro_agents.detection.detector import Detector, Windows
from hydro_agents.detection.features import SIGNALS
from hydro_agents.detection.operations import ACTING
from hydro_agents.evaluation.leak_protocol import HEALTHY, LeakProtocol
from hydro_agents.running.cases import Cases, ControllerError, run_cases
from hydro_agents.running.jobs import JobResult, digest_of_code
from hydro_env import ConfigurationError, TaskConfig

FORMAT = "hydro_env leakage job 2"
_ROOMS = ("controllers", "running", "detection", "estimation", "evaluation")

TRUTH = ("seed", "leak_lpm", "error_mm", "failed")
"""Columns in addition to those of a reading: the leak at the end of the window, the mean position error of the run, and
whether the run failed."""

READ = ("score", "probability", "flow_lpm", "low_lpm", "high_lpm")
"""Columns of a reading, NaN in a window without an answer; besides, ``otherwise`` is its cause."""


@dataclass(frozen=True)
class WindowJob:
    """A pure function of its fields: the same job gives the same numbers on every machine and beside any other job."""

    condition: str
    level: float
    reader: str
    detector: Detector
    config: TaskConfig  # of the runs
    known: TaskConfig  # as known to the detector
    acting: str
    samples: int  # of a window
    cases: Cases
    digest: str = ""  # of the detector; empty: its result is not reused
    validation: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of its result."""
        return (*TRUTH, *READ, "otherwise")

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.cases)

    @property
    def key(self) -> str:
        """A text that is unique in the protocol."""
        kind = "validation" if self.validation else "test"
        return f"{kind}|{self.condition}|{self.level:g}|{self.reader}|{self.cases.seeds[0]}"

    @cached_property
    def file(self) -> str:
        """Name of the result file; it differs for every job, detector and version of the code."""
        cases = self.cases
        faults = {name: sizes.tolist() for name, sizes in (cases.faults or {}).items()}
        assert cases.leakage_flow_lpm is not None
        numbers = [cases.seeds.tolist(), cases.leakage_flow_lpm.tolist(), cases.parameters, faults]
        parts = (
            FORMAT,
            digest_of_code(*_ROOMS),
            self.digest,
            self.config.model_dump_json(),
            self.known.model_dump_json(),
            json.dumps([*numbers, self.acting, self.samples]),
        )
        return f"{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:32]}.npz"

    def run(self) -> JobResult:
        """Simulate the windows and read them; an error of the task becomes the result."""
        try:
            signals, truth = windows(self.config, self.acting, self.cases, self.samples)
            good = np.flatnonzero(truth["failed"] == 0.0)
            reading = self.detector.read(Windows.of(signals[good]), self.known) if len(good) else None
        except ControllerError as error:
            return JobResult({}, str(error))
        except ConfigurationError as error:
            return JobResult({}, f"the condition cannot begin: {error}")
        columns = truth | {name: np.full(self.count, np.nan) for name in (*READ, "otherwise")}
        if reading is not None:
            for name in READ:
                columns[name][good] = np.where(reading.answers, getattr(reading, name), np.nan)
            columns["otherwise"][good] = reading.cause
        return JobResult(columns)


def windows(
    config: TaskConfig, acting: str, cases: Cases, samples: int
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Measured windows (N, 5, samples) in SI units, cut from runs at places set by the seed, and their true values.

    Raises:
        ControllerError: the controller of the axes failed.
        ConfigurationError: a run cannot begin.
    """
    layout = ObservationLayout.of(config)
    present = [name for name in SIGNALS if name in layout.names]
    columns = [layout.index(name) for name in present]
    controller = ACTING[acting].make(config, len(cases), int(cases.seeds[0]))
    run = run_cases(config, controller, cases, columns)
    assert run.signals is not None
    scaled = np.full((len(cases), len(SIGNALS), config.steps), np.nan)  # NaN: the rig has no such sensor
    for number, name in enumerate(present):
        scaled[:, SIGNALS.index(name)] = run.signals[:, number].astype(np.float64) * layout.scale[layout.index(name)]
    spare = config.steps - samples
    places = [np.random.default_rng([int(seed), 13]).integers(spare // 2, spare + 1) for seed in cases.seeds]
    cut = np.stack([axis[:, first : first + samples] for axis, first in zip(scaled, places, strict=True)])
    error = 1e3 * np.abs(run.position.astype(np.float64) - run.reference).mean(axis=1)
    return cut, {
        "seed": cases.seeds.astype(np.float64),
        "leak_lpm": run.leakage_flow_lpm.astype(np.float64),
        "error_mm": error,
        "failed": (run.failed_at >= 0).astype(np.float64),
    }


def plan(protocol: LeakProtocol, detectors: dict[str, Detector], digests: dict[str, str]) -> Iterator[WindowJob | str]:
    """The jobs of a protocol; a text ``detector|condition|reason`` for a pair that cannot run.

    Args:
        protocol: the protocol.
        detectors: detectors of its windows, by name.
        digests: of their weights, by name.
    """
    for name, condition in protocol.conditions.items():
        config, known = protocol.task_in(name), protocol.known_task(name)
        samples = round(condition.duration / config.control_period)
        for reader, detector in detectors.items():
            if not protocol.reads(name, reader):
                continue
            reason = detector.refuses(known, samples)
            if reason:
                yield f"{reader}|{name}|{reason}"
                continue
            choice = protocol.detectors[reader]
            count = max(round(condition.share * choice.windows), 1)
            cells = [(level, count, False) for level in protocol.levels_in(name)]
            if name == protocol.base:
                cells.append((HEALTHY, choice.validation_windows, True))
            for level, number, validation in cells:
                cases = protocol.cases_in(name, level, number, validation)
                for first in range(0, number, choice.batch):
                    part = cases.part(first, first + choice.batch)
                    yield WindowJob(
                        name,
                        level,
                        reader,
                        detector,
                        config,
                        known,
                        condition.acting,
                        samples,
                        part,
                        digests[reader],
                        validation,
                    )
