"""The reading of a leak test: one fit of the simulator to the whole recording, with an unknown wear of the valve.

All windows of the recording share leak, plant and wear; each has its own start. The verdict follows the rules of
``hydro diagnose`` (:func:`hydro_rig.diagnosis.verdict.judge`).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.detector import HALF_WIDTH, Cause, Reading, Windows
from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import PARAMETER_PATHS, from_vector, to_vector
from hydro_env.plant.parts.valve import edge_openings, smooth_root
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_env.units import LITRE_PER_MINUTE
from hydro_rig.diagnosis.leak_test_plan import Progress, priors_of_test, worn_task
from hydro_rig.diagnosis.pipeline import Read, flow_blocks, judged, volume_leak
from hydro_rig.diagnosis.verdict import Leak, Limits, Verdict
from hydro_rig.estimation.estimator import MISFIT, SURE, WEAR, healthy_range
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.identification.common_fit import WELL_FITTED, Common, common_fit
from hydro_rig.identification.fit import COVERAGE
from hydro_rig.identification.intervals import spread_of
from hydro_rig.identification.quick_fit import quick_fit
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.findings import Finding
from hydro_rig.recordings.quality import check_recording
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import Sampled, cut

WINDOW = 4.0  # s; the windows share all unknowns but their start
MOST_WINDOWS = 30  # a longer recording is read from the first change of the command on
FIRST = 4  # windows that are first fitted alone
ENOUGH = 0.6  # share of explained windows with which a quick fit is believed
BEFORE = 1.0  # s of rest before the first change of the command that are read
APART = (
    3.0  # ratio of the uncertainties of the leak and of its sum with the flow of the edges, below which they are apart
)
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


class LeakTest(NamedTuple):
    """The result of a leak test."""

    recording: Recording
    task: TaskConfig  # of the rig, with a healthy valve
    findings: list[Finding]
    windows: Windows
    common: Common | None  # None: nothing was read
    quantities: dict[str, Quantity]  # by unknown; the leak, and what wears
    seal: Quantity | None  # the leak past the piston, l/min at 100 bar
    edges: Quantity | None  # through the closed valve at the supply pressure of the rig, l/min
    both: Quantity | None  # sum of the two
    limits: Limits
    verdict: Verdict

    @property
    def apart(self) -> bool:
        """Whether the test tells the leak of the seal from the flow through the edges."""
        assert self.seal is not None
        assert self.both is not None
        return self.seal.deviation <= APART * self.both.deviation

    def simulated(self) -> Floats:
        """What the sensors of the fitted model read in the windows that were used, (B, sensors, T), SI."""
        assert self.common is not None
        model = self.common.model
        read: Floats = model.readings(self.common.joint.scaled, np.arange(model.count))[0] * model.noise[:, None]
        return read


def read_leak_test(
    path: Path,
    config: TaskConfig,
    columns: ColumnMap | None = None,
    limit: float | None = None,
    progress: Progress | None = None,
) -> LeakTest:
    """Read the recording of a leak test.

    Args:
        path: the recording.
        config: the task of the rig.
        columns: the signal of each column; default: the names that ``hydro record`` writes.
        limit: leak from which the seal is faulty, l/min at 100 bar; default: that of the task.
        progress: called with phase, done, total.

    Raises:
        ConfigurationError: the recording cannot be read at all.
    """
    recording = read_recording(path, columns)
    limits = Limits.of(config) if limit is None else Limits(limit, limit)
    task, common = worn_task(config), None
    quantities: dict[str, Quantity] = {}
    seal = edges = both = None

    def read(windows: Windows) -> Read:
        nonlocal common, quantities, seal, edges, both
        if len(windows) < 2:
            few = f"the recording holds fewer than 2 windows of {WINDOW:g} s with all commands"
            return Read(Reading.of([np.nan], why=few))
        measured = np.asarray(np.isfinite(windows.signals[:, : len(SENSORS)]).any(axis=(0, 2)))
        fitted = _fit(windows, task, measured, progress or (lambda phase, done, total: None))
        quantities, seal, edges, both = _quantities(fitted, task)
        common = fitted
        return Read(_reading(fitted, quantities, seal, config))

    balance = volume_leak(flow_blocks(recording))
    checked = check_recording(recording, config)

    def choose(samples: Sampled) -> Windows:
        return _windows(samples, config)

    found = judged(checked, config, choose, read, limits, WINDOW, balance, [recording])
    findings, windows, verdict = found.checked.findings, found.windows, found.verdict
    return LeakTest(recording, config, findings, windows, common, quantities, seal, edges, both, limits, verdict)


def _windows(samples: Sampled, config: TaskConfig) -> Windows:
    """The windows with all commands, from shortly before the first change of the command on."""
    total = int(samples.place[-1]) + 1 if len(samples.place) else 0
    count = max(round(total * config.control_period / WINDOW), 1)
    length = max(total // count, 2)  # to the last move
    windows = cut(samples, length)
    chosen = np.flatnonzero(windows.commanded)
    command = windows.signals[chosen, -1]
    moved = np.flatnonzero(np.ptp(command, axis=1) > 0.0) if len(chosen) else np.zeros(0, np.int64)
    first = max(int(moved[0]) - int(np.ceil(BEFORE / WINDOW)), 0) if len(moved) else 0
    return windows.part(chosen[first : first + MOST_WINDOWS])


def _fit(windows: Windows, task: TaskConfig, measured: NDArray[np.bool_], report: Progress) -> Common:
    """The common fit from the windows with the most different commands; the thorough one if it explains too little."""
    priors, span = priors_of_test(task, measured), np.ptp(windows.signals[:, -1], axis=1)
    common = quick_fit(windows, np.sort(np.argsort(-span, kind="stable")[:FIRST]), task, priors, report)
    if common.explained >= ENOUGH * len(windows):
        return common
    again = common_fit(windows, task, priors, report)
    return max(common, again, key=lambda one: one.explained)


def _quantities(common: Common, task: TaskConfig) -> tuple[dict[str, Quantity], Quantity, Quantity, Quantity]:
    """What wears, by unknown; and the leak of the seal, the flow through the edges, and their sum."""
    joint, model = common.joint, common.model
    names = [model.names[place] for place in joint.shared]
    spread = spread_of(joint)
    factor = spread.reach / COVERAGE / np.maximum(spread.deviation, 1e-300)  # from the bound to the whole uncertainty
    covariance = np.linalg.inv(joint.precision)
    wide = covariance * factor[:, None] * factor

    def quantity(value: float, slope: Floats) -> Quantity:
        return Quantity(value, float(np.sqrt(slope @ wide @ slope)), float(np.sqrt(slope @ covariance @ slope)))

    scale = model.derivative(joint.scaled[0])[joint.shared]
    values = model.values(joint.scaled[0])[joint.shared]
    known = {
        name: quantity(float(values[row]), scale[row] * np.eye(len(names))[row])
        for row, name in enumerate(names)
        if name == LEAKAGE or name in WEAR or name.startswith("valve.")
    }
    flow, slope = edge_flow(common, task)
    leak = names.index(LEAKAGE)
    own = scale[leak] * np.eye(len(names))[leak]
    return known, known[LEAKAGE], quantity(flow, slope), quantity(float(values[leak]) + flow, own + slope)


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
    slope = []
    for place in joint.shared:
        step = np.zeros_like(here)
        step[place] = STEP
        slope.append((flow(here + step) - flow(here - step)) / (2.0 * STEP))
    return flow(here), np.array(slope)


def _reading(common: Common, quantities: dict[str, Quantity], seal: Quantity, config: TaskConfig) -> Reading:
    """The test as the reading of a detector: every window shares the leak, and may contradict the model."""
    faults = [
        f"{wear.what} ({number(wear.factor * found.value)} {wear.unit})"
        for name, wear in WEAR.items()
        if (found := quantities.get(name)) is not None and _beyond(found, healthy_range(config, name)) > SURE
    ]
    causes = [
        wear.cause
        for name, wear in WEAR.items()
        if name in quantities and _beyond(quantities[name], healthy_range(config, name)) > SURE
    ]
    count, holds = len(common.misfit), common.misfit < WELL_FITTED
    leak = seal.leak

    return Reading.of(
        np.full(count, seal.value / seal.deviation),
        np.where(holds, causes[0] if causes else Cause.NONE, Cause.UNKNOWN),
        flow_lpm=leak.value,
        low_lpm=leak.low,
        high_lpm=leak.high,
        fault=" and ".join(faults),
        why=tuple("" if held else MISFIT for held in holds),
    )


def _beyond(found: Quantity, healthy: tuple[float, float]) -> float:
    """Distance of a value from its healthy range, in standard deviations."""
    low, high = healthy
    return max(low - found.value, found.value - high) / found.deviation
