"""Experiments about the task alone, as parts of a robustness protocol; frequency response and stiffness.

Each is a list of runs (:mod:`hydro_agents.evaluation.sweeps`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.conditions import Cell, columns_of
from hydro_agents.evaluation.leak_price import full_force, full_speed, leak_price, working_place
from hydro_agents.evaluation.participants import split_name
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.sweeps import Experiment, Run, sine_fit
from hydro_agents.evaluation.transitions import (
    STANDSTILL_LEAKS,
    TAKEN_OVER,
    TakesOver,
    motions,
    moves_after_pauses,
    standstills,
)
from hydro_agents.running.cases import Rollout
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.tasks import noiseless, own_reference
from hydro_env import TaskConfig
from hydro_env.plant.analysis import reachable_range
from hydro_env.task.configuration import task_config
from hydro_env.types import Floats

# Frequency response ---------------------------------------------------------------------------------------------------

FREQUENCIES = (0.5, 1.0, 2.0, 3.0, 4.5, 6.5, 9.0, 12.0, 16.0, 22.0, 30.0, 40.0, 55.0)
"""Hz; frequencies from a third of the sampling frequency upwards are left out."""

AMPLITUDE_SHARE = 0.01  # amplitude of the sines as a share of the range of positions that the supply can hold

SPEED_SHARE = 0.15
"""Largest speed of the sines, as a share of the speed at full command; it keeps the valve far from its limits."""

SETTLING, WATCHED = 0.5, 0.5
"""s: time until the response is steady (and two cycles), and length of the fit (at least three cycles)."""


def sine_references(config: TaskConfig) -> Iterator[Run]:
    """Sines of the reference about the working position, with the preview and with the preview hidden.

    Columns: preview (whether the controller sees it), frequency_hz, amplitude_mm, gain (1), phase_deg, rest (root mean
    square of the residual, as a share of the amplitude). The amplitude is smaller where the speed would be too high.
    """
    centre = working_place(config.plant)
    low, high = reachable_range(config.plant)
    for frequency in FREQUENCIES:
        if 3.0 * frequency * config.control_period > 1.0:
            continue
        largest = SPEED_SHARE * full_speed(config.plant, centre) / (2.0 * np.pi * frequency)
        size = min(AMPLITUDE_SHARE * (high - low), largest)
        time, first = _samples(frequency, config.control_period)
        task = own_reference(config, centre + size * np.sin(2.0 * np.pi * frequency * time))
        for preview in (True, False) if config.references.preview_times else (False,):
            yield Run((task,), partial(_response, preview, frequency, size, first), hidden_preview=not preview)


def _samples(frequency: float, period: float) -> tuple[Floats, int]:
    """Times of all samples in s, and the first sample of the fit; the fit covers whole cycles."""
    settling = max(SETTLING, 2.0 / frequency)
    cycles = max(int(np.ceil(WATCHED * frequency)), 3)
    first = round(settling / period)
    last = first + round(cycles / (frequency * period))
    return period * np.arange(last + 1, dtype=np.float64), first


def _response(preview: bool, frequency: float, size: float, first: int, rollout: Rollout) -> dict[str, Any]:
    time = rollout.time[first:]
    answer, rest = sine_fit(rollout.position[:, first:], time, frequency)
    asked, _ = sine_fit(rollout.reference[:, first:], time, frequency)
    return {
        "preview": preview,
        "frequency_hz": frequency,
        "amplitude_mm": 1e3 * size,
        "gain": np.abs(answer / asked),
        "phase_deg": np.angle(answer / asked, deg=True),
        "rest": rest / size,
    }


def _continuous_phase(table: pd.DataFrame) -> pd.DataFrame:
    parts = table.groupby(["preview", "leakage_flow_lpm", "seed"], sort=False)
    table["phase_deg"] = parts["phase_deg"].transform(lambda phase: np.unwrap(phase, period=360.0))
    return table


def bandwidths(table: pd.DataFrame) -> pd.DataFrame:
    """Frequencies at which the gain falls below −3 dB and the phase below −90°, and the highest gain.

    Args:
        table: of the experiment ``frequency``, with the column ``controller``.

    Returns:
        Per controller, preview and leak: minus_3_db_hz, minus_90_deg_hz (medians of the plants; infinity: beyond the
        sweep), the lowest value of all plants (``_lowest``), and peak_gain (highest of all plants and frequencies).
    """
    rows, by = [], ["controller", "preview", "leakage_flow_lpm"]
    for key, frame in table.assign(gain_db=20.0 * np.log10(table["gain"])).groupby(by, sort=False):
        row: dict[str, Any] = dict(zip(by, key, strict=True))
        for name, column, level in (("minus_3_db_hz", "gain_db", -3.0), ("minus_90_deg_hz", "phase_deg", -90.0)):
            plants = frame.groupby("seed", sort=False)
            crossings = [crossing(own["frequency_hz"].to_numpy(), own[column].to_numpy(), level) for _, own in plants]
            row |= {name: float(np.median(crossings)), f"{name}_lowest": min(crossings)}
        rows.append(row | {"peak_gain": float(frame["gain"].max())})
    return pd.DataFrame(rows)


def crossing(frequency: Floats, values: NDArray[np.floating], level: float) -> float:
    """First frequency at which values fall below a level, interpolated over log f; infinity if they never do."""
    below = np.flatnonzero(np.asarray(values) < level)
    if len(below) == 0:
        return float("inf")
    i = int(below[0])
    if i == 0:
        return float(frequency[0])
    share = (values[i - 1] - level) / (values[i - 1] - values[i])
    return float(frequency[i - 1] * (frequency[i] / frequency[i - 1]) ** share)


# Stiffness ------------------------------------------------------------------------------------------------------------

FORCE_SHARE = 0.2  # amplitude of the force as a share of the force that the supply of the nominal rig gives

BEFORE, AFTER, JUDGED = 1.0, 2.0, 0.5
"""s: time before the force step, time after it, and last part of each, over which the position is averaged."""

RECOVERED = 0.1  # recovery band as a share of the peak deviation; at least one step of the position sensor
SINE_FREQUENCIES = (1.0, 2.0, 4.0, 8.0, 12.0, 18.0, 27.0)  # Hz; force sines
SINE_SETTLING, SINE_WATCHED = 0.5, 1.0  # s (and two cycles each)


def sudden_force(config: TaskConfig) -> Iterator[Run]:
    """A sudden external force of drawn sign on an axis at rest, without sensor noise, which would hide the recovery.

    Columns: force_n, peak_mm (largest deviation), recovery_s (until the deviation stays within a tenth of the peak
    about its final value; NaN if not by the end, as in a limit cycle), remaining_mm (deviation at the end, absolute),
    static_mm_per_kn and dynamic_mm_per_kn (remaining and largest deviation per force).
    """
    newtons, begin = FORCE_SHARE * full_force(config.plant), BEFORE / (BEFORE + AFTER)
    task = _with_force(noiseless(config), newtons, BEFORE + AFTER, kind="step", start_range=(begin, begin))
    yield Run((task,), partial(_recovery, config, newtons))


def _recovery(config: TaskConfig, newtons: float, rollout: Rollout) -> dict[str, Any]:
    period = config.control_period
    first, judged = round(BEFORE / period), round(JUDGED / period)
    position = rollout.position.astype(np.float64)
    deviation = position - position[:, first - judged : first].mean(axis=1, keepdims=True)
    peak, remaining = np.abs(deviation[:, first:]).max(axis=1), deviation[:, -judged:].mean(axis=1)
    band = np.maximum(RECOVERED * peak, config.sensors.position.resolution)
    outside = np.abs(deviation[:, first:] - remaining[:, None]) > band[:, None]
    recovered = outside.shape[1] - np.argmax(outside[:, ::-1], axis=1)  # samples until the last one outside
    lasting = outside[:, -judged:].any(axis=1)
    return {
        "force_n": newtons,
        "peak_mm": 1e3 * peak,
        "recovery_s": np.where(lasting, np.nan, period * np.where(outside.any(axis=1), recovered, 0)),
        "remaining_mm": 1e3 * np.abs(remaining),
        "static_mm_per_kn": 1e6 * np.abs(remaining) / newtons,
        "dynamic_mm_per_kn": 1e6 * peak / newtons,
    }


def sine_forces(config: TaskConfig) -> Iterator[Run]:
    """Sines of the external force: amplitude of the position per amplitude of the force.

    Columns: frequency_hz, force_n, compliance_mm_per_kn.
    """
    newtons = FORCE_SHARE * full_force(config.plant)
    for frequency in SINE_FREQUENCIES:
        settling = max(SINE_SETTLING, 2.0 / frequency)
        cycles = max(round(SINE_WATCHED * frequency), 2)
        sine = {"kind": "sine", "start_range": (0.0, 0.0), "frequency_range": (frequency, frequency)}
        task = _with_force(config, newtons, settling + cycles / frequency, **sine)
        yield Run((task,), partial(_compliance, frequency, newtons, round(settling / config.control_period)))


def _compliance(frequency: float, newtons: float, first: int, rollout: Rollout) -> dict[str, Any]:
    answer, _ = sine_fit(rollout.position[:, first:], rollout.time[first:], frequency)
    return {"frequency_hz": frequency, "force_n": newtons, "compliance_mm_per_kn": 1e6 * np.abs(answer) / newtons}


def _with_force(config: TaskConfig, newtons: float, duration: float, **disturbance: Any) -> TaskConfig:
    """The task of holding the working position for some time (s) against an external force (N)."""
    held = np.full(round(duration / config.control_period) + 1, working_place(config.plant))
    force = {"force_range": (newtons, newtons), "force_share": (0.0, 0.0), **disturbance}
    return task_config(own_reference(config, held), disturbance=force)


# Parts of a protocol --------------------------------------------------------------------------------------------------

EXPERIMENTS = {
    "frequency": Experiment(sine_references, finish=_continuous_phase),
    "force_step": Experiment(sudden_force, plants=8),
    "force_sine": Experiment(sine_forces),
    "hold": Experiment(standstills, STANDSTILL_LEAKS, plants=8),
    "pause": Experiment(moves_after_pauses, (0.05, 2.0), plants=12),
}
"""Experiments by the names of their parts."""

TAKE_OVER = Experiment(motions, (0.05, 2.0, 6.0), plants=8)

Pair = tuple[Controller, Controller]  # the baseline, and the one that is measured


def _cells(work: Callable[..., Columns], arguments: tuple[str, ...], protocol: Any, chosen: Any) -> Iterator[Cell]:
    """An experiment on every controller of a robustness protocol; of several training seeds the first takes part."""
    controllers: dict[str, Controller] = {}
    for name, controller in chosen.controllers.items():
        controllers.setdefault(split_name(name)[0], controller)
    baseline = next(iter(controllers.values()))
    for name, controller in controllers.items():
        digest = fingerprint(baseline, controller) if work is taken_over else fingerprint(controller)
        job = Job(work, (baseline, controller), (protocol.task, *arguments), digest)
        yield Cell(name, known={"controller": name}, jobs=(job,))


def measured(pair: Pair, config: TaskConfig, experiment: str) -> Columns:
    """The table of an experiment on the second of two controllers.

    Raises:
        ControllerError: the controller raises an exception or returns no finite commands.
    """
    return columns_of(EXPERIMENTS[experiment](config, pair[1]))


def taken_over(pair: Pair, config: TaskConfig) -> Columns:
    """The second of two controllers takes over from the first, beside itself from the start (never_switched_um)."""
    switched = TAKE_OVER(config, TakesOver(*pair, periods=round(TAKEN_OVER / config.control_period)))
    return columns_of(switched.assign(never_switched_um=TAKE_OVER(config, pair[1])["largest_um"]))


def price(protocol: RobustnessProtocol, chosen: object) -> Iterator[Cell]:
    """The part ``leak_price``; no controller takes part."""
    del chosen
    yield Cell("leak", jobs=(Job(leak_costs, None, (protocol.task,), digest="plant"),))


def leak_costs(_: None, config: TaskConfig) -> Columns:
    """The table of the cost of a leak."""
    return columns_of(leak_price(config))


frequency, force_step, force_sine, hold, pause = (partial(_cells, measured, (name,)) for name in EXPERIMENTS)
take_over = partial(_cells, taken_over, ())
