"""Frequency response from the reference to the true position by a sine sweep, with any controller in the loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.sweeps import (
    LEAKS,
    Array,
    HiddenPreview,
    full_speed,
    run_sweep,
    sine_fit,
    working_place,
)
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.running.tasks import own_reference
from hydro_env import TaskConfig
from hydro_env.plant.analysis import reachable_range

FREQUENCIES = (0.5, 1.0, 2.0, 3.0, 4.5, 6.5, 9.0, 12.0, 16.0, 22.0, 30.0, 40.0, 55.0)
"""Hz; frequencies from a third of the sampling frequency upwards are left out."""

AMPLITUDE_SHARE = 0.01
"""Amplitude of the sines as a share of the range of positions that the supply can hold."""

SPEED_SHARE = 0.15
"""Largest speed of the sines, as a share of the speed at full command; it keeps the valve far from its limits."""

SETTLING = 0.5
"""s (plus two cycles) until the response is steady."""

WATCHED = 0.5
"""s (plus three cycles) of the fit."""


def frequency_response(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    leaks: Sequence[float] = LEAKS,
    plants: int = 4,
    frequencies: Sequence[float] = FREQUENCIES,
    amplitude: float | None = None,
    place: float | None = None,
    first_seed: int = EXPERIMENT_AXES.first,
) -> pd.DataFrame:
    """Gain and phase of each controller, leak, plant and frequency, with the preview and with the preview hidden.

    Args:
        config: the task, for its plants, sensors and timing.
        controllers: by name.
        leaks: l/min at 100 bar.
        plants: number of plants, drawn.
        frequencies: Hz.
        amplitude: m, of the reference; default: a share of the range, smaller if the speed would be too high.
        place: m, centre of the sines; default :func:`~hydro_agents.evaluation.sweeps.working_place`.
        first_seed: seed of the first plant.

    Returns:
        Columns controller, preview (whether the controller sees it), leakage_flow_lpm, seed, frequency_hz,
        amplitude_mm, gain (1), phase_deg, rest (root mean square of the residual, as a share of the amplitude).

    Raises:
        ControllerError: a controller raises an exception or returns no finite commands.
    """
    centre = working_place(config.plant) if place is None else place
    low, high = reachable_range(config.plant)
    previews = (True, False) if config.references.preview_times else (False,)
    tables = []
    for frequency in [f for f in frequencies if 3.0 * f * config.control_period <= 1.0]:
        largest = SPEED_SHARE * full_speed(config.plant, centre) / (2.0 * np.pi * frequency)
        size = min(AMPLITUDE_SHARE * (high - low), largest) if amplitude is None else amplitude
        time, first = _samples(frequency, config.control_period)
        task = own_reference(config, centre + size * np.sin(2.0 * np.pi * frequency * time))
        for name, controller in controllers.items():
            for preview in previews:
                watched = controller if preview else HiddenPreview(controller, config)
                sweep = run_sweep(task, watched, leaks, plants, first_seed)
                rollout = sweep.rollout
                answer, rest = sine_fit(rollout.position[:, first:], rollout.time[first:], frequency)
                asked, _ = sine_fit(rollout.reference[:, first:], rollout.time[first:], frequency)
                columns = {
                    "preview": preview,
                    "frequency_hz": frequency,
                    "amplitude_mm": 1e3 * size,
                    "gain": np.abs(answer / asked),
                    "phase_deg": np.angle(answer / asked, deg=True),
                    "rest": rest / size,
                }
                tables.append(sweep.table(name, **columns))
    table = pd.concat(tables, ignore_index=True)
    parts = table.groupby(["controller", "preview", "leakage_flow_lpm", "seed"], sort=False)
    table["phase_deg"] = parts["phase_deg"].transform(lambda phase: np.unwrap(phase, period=360.0))
    return table


def _samples(frequency: float, period: float) -> tuple[Array, int]:
    """Times of all samples in s, and the first sample of the fit; the fit covers whole cycles."""
    settling = max(SETTLING, 2.0 / frequency)
    cycles = max(int(np.ceil(WATCHED * frequency)), 3)
    first = round(settling / period)
    last = first + round(cycles / (frequency * period))
    return period * np.arange(last + 1, dtype=np.float64), first


def bandwidths(table: pd.DataFrame) -> pd.DataFrame:
    """Frequencies at which the gain falls below −3 dB and the phase below −90°, and the highest gain.

    Args:
        table: of :func:`frequency_response`.

    Returns:
        Per controller, preview and leak: minus_3_db_hz, minus_90_deg_hz (medians of the plants; infinity: beyond the
        sweep), the lowest value of all plants (``_lowest``), and peak_gain (highest of all plants and frequencies).
    """
    rows = []
    for key, frame in table.groupby(["controller", "preview", "leakage_flow_lpm"], sort=False):
        gain, phase = [], []
        for _, plant in frame.groupby("seed", sort=False):
            frequency = plant["frequency_hz"].to_numpy(dtype=np.float64)
            gain.append(crossing(frequency, 20.0 * np.log10(plant["gain"].to_numpy(dtype=np.float64)), -3.0))
            phase.append(crossing(frequency, plant["phase_deg"].to_numpy(dtype=np.float64), -90.0))
        rows.append(
            {
                **dict(zip(("controller", "preview", "leakage_flow_lpm"), key, strict=True)),
                "minus_3_db_hz": float(np.median(gain)),
                "minus_3_db_hz_lowest": min(gain),
                "minus_90_deg_hz": float(np.median(phase)),
                "minus_90_deg_hz_lowest": min(phase),
                "peak_gain": float(frame["gain"].max()),
            }
        )
    return pd.DataFrame(rows)


def crossing(frequency: Array, values: NDArray[np.floating], level: float) -> float:
    """First frequency at which values fall below a level, interpolated over log f; infinity if they never do."""
    below = np.flatnonzero(np.asarray(values) < level)
    if len(below) == 0:
        return float("inf")
    i = int(below[0])
    if i == 0:
        return float(frequency[0])
    share = (values[i - 1] - level) / (values[i - 1] - values[i])
    return float(frequency[i - 1] * (frequency[i] / frequency[i - 1]) ** share)
