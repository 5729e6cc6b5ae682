"""Labelled windows for the training of the leakage head: simulated axes in many kinds of operation, with faults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.controllers.base import Controller, ObservationLayout
from agents.leakage.features import FEATURES, LABELS, SENSORS, SIGNALS, features_of
from agents.leakage.operation import OPERATIONS, Operation, Row
from agents.leakage.sheet import Sheet, sheet_of
from agents.running.cases import Cases, run_cases
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.faults import FAULT_KINDS, FAULTS, KIND_OF_FAULT, SIGNED_KINDS

UNSEEN = ("position_offset",)
"""Faults that no measured signal shows: they get no label."""

LABEL_OF_FAULT = {
    name: LABELS.index(
        "sensor_fault"
        if kind.startswith("sensor_")
        else "valve_fault"
        if kind.startswith("valve_")
        else {"tank_pressure": "return_line", "external_leak": "external_leak"}[kind]
    )
    for name, kind in KIND_OF_FAULT.items()
    if name not in UNSEEN
}
"""Index of the label of each fault."""

_FREEZES = np.array([FAULTS.index(f"{name}_freeze") for name in SENSORS])

CHUNK = 512
"""Largest number of axes that are simulated together."""

SECOND_FAULT, FROZEN_LATER, AT_START = 0.1, 0.05, 0.2
"""Shares: of faulty axes with a second fault, of windows in which a sensor freezes, of those at the start of a run."""


class Windows(NamedTuple):
    """N labelled windows."""

    features: NDArray[np.float32]  # (N, F)
    labels: NDArray[np.float32]  # (N, labels), 0 or 1
    flow_lpm: NDArray[np.float64]  # (N,), internal leak, l/min at 100 bar
    operation: NDArray[np.int64]  # (N,), index into OPERATIONS
    fault: NDArray[np.int64]  # (N,), index into FAULTS of the first fault, −1 for none

    @classmethod
    def joined(cls, parts: Sequence[Windows]) -> Windows:
        """Several sets as one."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


class Plan(NamedTuple):
    """What windows are made of."""

    config: TaskConfig
    controllers: Sequence[Controller]
    healthy_share: float
    fault_share: float
    lowest_flow: float  # l/min at 100 bar
    highest_flow: float
    shortest: int  # samples
    longest: int
    per_run: int  # windows of each run

    def chunks(self, episodes: int) -> list[tuple[int, int, int]]:
        """Parts of the runs: row of OPERATIONS, index of the controller (−1: none), number of axes."""
        parts = []
        total = sum(row.share for row in OPERATIONS)
        for number, row in enumerate(OPERATIONS):
            doers = range(len(self.controllers)) if row.manner is None else [-1]
            for doer in doers:
                count = max(round(episodes * row.share / total / len(doers)), 1)
                pieces = -(-count // CHUNK)
                parts += [(number, doer, count * (p + 1) // pieces - count * p // pieces) for p in range(pieces)]
        return parts

    def windows(self, episodes: int, first_seed: int, skip: int = 0) -> Iterator[Windows]:
        """Simulate chunk after chunk; each depends only on the plan, its number and its seeds.

        Args:
            episodes: number of runs; rounding may add a few.
            first_seed: of the first run.
            skip: number of chunks to leave out.
        """
        sheet = sheet_of(self.config)
        seed = first_seed
        for number, (row, doer, count) in enumerate(self.chunks(episodes)):
            if number >= skip:
                yield self._chunk(OPERATIONS[row], row, doer, np.arange(seed, seed + count), sheet)
            seed += count

    def _chunk(self, row: Row, number: int, doer: int, seeds: NDArray[np.int64], sheet: Sheet) -> Windows:
        generator = np.random.default_rng([int(seeds[0]), number])
        count, config = len(seeds), self.config
        steps = self.longest + self.longest // 4
        changes: dict[str, Any] = {
            "episode_duration": steps * config.control_period,
            "leakage": config.leakage.model_dump() | {"schedule": "constant"},
            "faults": {"sensor_freeze": {"schedule": "mixed", "start_range": (0.2, 0.6)}},
        }
        task = row.task(task_config(config, **changes))
        flow = self._leaks(generator, count)
        faults, first, labels = draw_faults(config, generator, count, self.fault_share)
        labels[:, 0] = flow > config.leakage.class_bounds[0]
        layout = ObservationLayout.of(task)
        columns = [layout.index(name) for name in SIGNALS]
        acting: Any = (
            Operation(row.manner, task, count, int(seeds[0])) if row.manner is not None else self.controllers[doer]
        )
        run = run_cases(task, acting, Cases(seeds, flow, faults=faults), columns, states=False, chunk=count)
        assert run.signals is not None
        signals = run.signals * np.array([layout.scale[column] for column in columns], dtype=np.float32)[:, None]
        lengths = np.where(run.failed_at < 0, steps, run.failed_at + 1)
        parts = []
        for turn in range(self.per_run):
            # Whole lengths in a few steps: the windows of one length are read together.
            choices = np.unique(np.geomspace(self.shortest, self.longest, 5).round().astype(int))
            size = int(choices[0] if turn % 2 == 0 else generator.choice(choices))
            kept = np.flatnonzero(lengths >= size)
            begin = np.floor(generator.random(len(kept)) * (lengths[kept] - size + 1)).astype(int)
            begin[generator.random(len(kept)) < AT_START] = 0
            cut = (
                np.stack([signals[axis, :, b : b + size] for axis, b in zip(kept, begin, strict=True)])
                if len(kept)
                else np.empty((0, len(SIGNALS), size))
            )
            told = labels[kept].copy()
            frozen, sensor = freeze(cut, generator)
            told[frozen, LABELS.index("sensor_fault")] = 1.0
            met = first[kept]
            met[frozen] = np.where(met[frozen] < 0, _FREEZES[sensor], met[frozen])
            values = features_of(cut, sheet) if len(kept) else np.empty((0, len(FEATURES)), dtype=np.float32)
            parts.append(Windows(values, told, flow[kept], np.full(len(kept), number), met))
        return Windows.joined(parts)

    def _leaks(self, generator: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Leaks in l/min: healthy, or above the healthy bound; log-uniform."""
        bound = self.config.leakage.class_bounds[0]
        healthy = generator.random(count) < self.healthy_share
        low = np.where(healthy, self.lowest_flow, np.where(generator.random(count) < 0.15, bound, 3.0 * bound))
        high = np.where(healthy, bound, self.highest_flow)
        flow: NDArray[np.float64] = np.exp(generator.uniform(np.log(low), np.log(high)))
        return flow


def draw_faults(
    config: TaskConfig, generator: np.random.Generator, count: int, share: float
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.int64], NDArray[np.float32]]:
    """Faults of axes by name, the index of the first one of each axis (−1: none), and the labels of all."""
    sizes = {name: np.zeros(count) for name in FAULTS}
    first = np.full(count, -1)
    labels = np.zeros((count, len(LABELS)), dtype=np.float32)
    for axis in np.flatnonzero(generator.random(count) < share):
        for kind in generator.choice(FAULT_KINDS, 1 + (generator.random() < SECOND_FAULT), replace=False):
            low, high = getattr(config.faults, kind).range
            size = generator.uniform(low, high) * (generator.choice((-1.0, 1.0)) if kind in SIGNED_KINDS else 1.0)
            name = generator.choice([name for name, of in KIND_OF_FAULT.items() if of == kind])
            sizes[name][axis] = size
            first[axis] = FAULTS.index(name) if first[axis] < 0 else first[axis]
            if name in LABEL_OF_FAULT:
                labels[axis, LABEL_OF_FAULT[name]] = 1.0
    return sizes, first, labels


def freeze(signals: NDArray[Any], generator: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Freeze a sensor of some windows (N, 5, T) in place, from some place on; numbers of those windows and sensors."""
    frozen = np.flatnonzero(generator.random(len(signals)) < FROZEN_LATER)
    sensors = generator.integers(len(SENSORS), size=len(frozen))
    for window, sensor in zip(frozen, sensors, strict=True):
        begin = int(generator.uniform(0.0, 0.7) * signals.shape[2])
        signals[window, sensor, begin:] = signals[window, sensor, begin]
    return frozen, sensors
