"""The reading of a leak test: one fit of the simulator to the whole recording, with an unknown wear of the valve.

All windows of the recording share leak, plant and wear; each has its own start. The verdict follows the rules of
``hydro diagnose`` (:func:`hydro_rig.diagnosis.verdict.judge`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.detection.detector import HALF_WIDTH, Cause, Reading, Why, Windows
from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import PARAMETER_PATHS, from_vector, to_vector
from hydro_env.plant.parts.valve import edge_openings, smooth_root
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_env.units import LITRE_PER_MINUTE
from hydro_rig.diagnosis.diagnose import Diagnosis
from hydro_rig.diagnosis.leak_test_plan import priors_of_test, worn_task
from hydro_rig.diagnosis.pipeline import Read, flow_blocks, judged
from hydro_rig.diagnosis.verdict import EXIT_CODES, Leak
from hydro_rig.diagnosis.volume_balance import leak_of_blocks
from hydro_rig.estimation.estimator import WEAR, healthy_range
from hydro_rig.estimation.search import SURE
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.identification.common_fit import WELL_FITTED, Common, common_fit
from hydro_rig.identification.fit import COVERAGE
from hydro_rig.identification.intervals import spread_of
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.findings import lines_of
from hydro_rig.recordings.quality import check_recording
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import Sampled, cut, on_grid

WINDOW = 4.0  # s; the windows share all unknowns but their start
MOST_WINDOWS = 30  # of a longer recording those at its end
APART = 3.0  # uncertainty of the leak over that of its sum with the flow of the edges, up to which they are apart
STEP = 0.01  # of the differences of the flow of the edges, in standard deviations of the priors


class Quantity(NamedTuple):
    """A value that the test gives."""

    value: float
    deviation: float  # standard deviation, with the scatter between the windows
    bound: float  # of the noise alone: the Cramér–Rao bound at the value

    @property
    def leak(self) -> Leak:
        """The value with its 90 % interval."""
        return Leak(self.value, self.value - HALF_WIDTH * self.deviation, self.value + HALF_WIDTH * self.deviation)


class LeakFit(NamedTuple):
    """What the common fit of the windows gives."""

    common: Common
    quantities: dict[str, Quantity]  # by unknown; the leak, and what wears
    seal: Quantity  # the leak past the piston, l/min at 100 bar
    edges: Quantity  # flow through the closed valve at the supply pressure of the rig, l/min
    both: Quantity  # sum of the two

    @property
    def apart(self) -> bool:
        """Whether the test tells the leak of the seal from the flow through the edges."""
        return self.seal.deviation <= APART * self.both.deviation


@dataclass(frozen=True)
class LeakTest(Diagnosis):
    """The result of a leak test; its task has a healthy valve."""

    fit: LeakFit | None = None  # None: nothing was read

    def line(self) -> str:
        """The leak of the seal beside the flow through the edges of the valve; empty: nothing was read."""
        if self.fit is None:
            return ""
        seal, edges, both = (one.leak.text() for one in (self.fit.seal, self.fit.edges, self.fit.both))
        if not self.fit.apart:
            return f"seal and edges of the valve cannot be told apart: together {both}"
        bound = number(self.fit.seal.bound, digits=2)
        edges = edges.removesuffix(" at 100 bar")  # at the supply pressure
        return f"past the seal {seal} (bound ±{bound}); through the edges of the closed valve {edges}"

    def facts(self) -> dict[str, Any]:
        """The result as numbers: leaks in l/min at 100 bar, others in SI."""
        found: dict[str, Any] = {
            "verdict": self.verdict.kind.value,
            "line": self.verdict.line(),
            "exit_code": EXIT_CODES[self.verdict.kind],
            "findings": lines_of(self.checked.findings),
            "windows": len(self.windows),
        }
        if self.fit is not None:
            fit = self.fit
            parts = {"seal_lpm": fit.seal, "edges_lpm": fit.edges, "both_lpm": fit.both, **fit.quantities}
            for name, quantity in parts.items():
                found[name] = quantity.leak._asdict() | {"bound": quantity.bound}
            found |= {"apart": fit.apart, "explained": fit.common.explained}
        return found


def read_leak_test(path: Path, config: TaskConfig, columns: ColumnMap | None = None) -> LeakTest:
    """Read the recording of a leak test.

    Args:
        path: the recording.
        config: the task of the rig.
        columns: the signal of each column; default: the names that ``hydro record`` writes.

    Raises:
        ConfigurationError: the recording cannot be read at all.
    """
    recording = read_recording(path, columns)
    checked = check_recording(recording, config)
    config = on_grid(config, checked.samples.period)
    task, fit = worn_task(config), None

    def read(windows: Windows) -> Read:
        nonlocal fit
        if len(windows) < 2:
            return Read(Reading.of([np.nan], why=Why.FEW_WINDOWS))
        measured = np.asarray(np.isfinite(windows.signals[:, : len(SENSORS)]).any(axis=(0, 2)))
        fit = quantities(common_fit(windows, task, priors_of_test(task, measured)), task)
        return Read(_reading(fit, config))

    result = judged(
        checked,
        config,
        choose=lambda samples: _windows(samples, config),
        read=read,
        recording=recording,
        balance=leak_of_blocks(flow_blocks(recording)),
        window=WINDOW,
    )
    return LeakTest(**vars(result), recording=recording, fit=fit)


def _windows(samples: Sampled, config: TaskConfig) -> Windows:
    """The last windows with all commands."""
    total = int(samples.place[-1]) + 1 if len(samples.place) else 0
    count = max(round(total * config.control_period / WINDOW), 1)
    windows = cut(samples, max(total // count, 2))  # to the last move
    return windows.part(np.flatnonzero(windows.commanded)[-MOST_WINDOWS:])


def quantities(common: Common, task: TaskConfig) -> LeakFit:
    """What wears, by unknown; and the leak of the seal, the flow through the edges, and their sum."""
    joint, model = common.joint, common.model
    names = [model.names[place] for place in joint.shared]
    spread = spread_of(joint)
    factor = spread.reach / COVERAGE / np.maximum(spread.deviation, 1e-300)  # from the bound to the whole uncertainty
    covariance = np.linalg.inv(joint.precision)
    wide = covariance * factor[:, None] * factor

    def quantity(value: float, slope: Floats) -> Quantity:
        return Quantity(value, float(np.sqrt(slope @ wide @ slope)), float(np.sqrt(slope @ covariance @ slope)))

    values = model.values(joint.scaled[0])[joint.shared].tolist()
    slopes = np.diag(model.derivative(joint.scaled[0])[joint.shared])
    found = {}
    for name, value, slope in zip(names, values, slopes, strict=True):
        if name == LEAKAGE or name in WEAR or name.startswith("valve."):
            found[name] = quantity(value, slope)
    flow, by_edges = edge_flow(common, task)
    seal, edges = found[LEAKAGE], quantity(flow, by_edges)
    both = quantity(seal.value + flow, slopes[names.index(LEAKAGE)] + by_edges)
    return LeakFit(common, found, seal, edges, both)


def edge_flow(common: Common, task: TaskConfig) -> tuple[float, Floats]:
    """Flow through the centred valve with closed ports at the supply pressure, l/min, and its derivatives (p,)."""
    joint, model = common.joint, common.model

    def flow(scaled: Floats) -> float:
        row = to_vector(task.plant)
        for name, value in zip(model.names, model.values(scaled), strict=True):
            if name.startswith("valve."):
                row[PARAMETER_PATHS.index(name)] = value
        c = plant_coefficients(from_vector(row))
        opened, _ = edge_openings(c.null_shift, c)
        drop = 0.5 * (task.plant.supply.pressure - task.plant.supply.tank_pressure)  # two equal edges in series
        total = c.edge_gain * (1.0 + c.edge_ratio) * opened * smooth_root(drop, c.transition_squared)
        return float(total) / LITRE_PER_MINUTE

    here = joint.scaled[0]
    steps = STEP * np.eye(len(here))[joint.shared]
    slope = [(flow(here + step) - flow(here - step)) / (2.0 * STEP) for step in steps]
    return flow(here), np.array(slope)


def _reading(fit: LeakFit, config: TaskConfig) -> Reading:
    """The test as the reading of a detector: every window shares the leak, and may contradict the model."""
    faults, causes = [], []
    for name, wear in WEAR.items():
        if name in fit.quantities:
            value, deviation, _ = fit.quantities[name]
            low, high = healthy_range(config, name)
            if max(low - value, value - high) > SURE * deviation:
                faults.append(f"{wear.what} ({number(wear.factor * value)} {wear.unit})")
                causes.append(wear.cause)
    holds, leak = fit.common.misfit < WELL_FITTED, fit.seal.leak
    return Reading.of(
        np.full(len(holds), fit.seal.value / fit.seal.deviation),
        np.where(holds, causes[0] if causes else Cause.NONE, Cause.UNKNOWN),
        flow_lpm=leak.value,
        low_lpm=leak.low,
        high_lpm=leak.high,
        fault=" and ".join(faults),
        why=np.where(holds, Why.ANSWERED, Why.MISFIT),
    )
