"""Stiffness: deviation of a controlled axis under an external force, after a step and over frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.sweeps import (
    LEAKS,
    Array,
    full_force,
    run_sweep,
    sine_fit,
    working_place,
)
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.running.tasks import noiseless, own_reference
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config

FORCE_SHARE = 0.2
"""Amplitude of the force as a share of the force that the supply of the nominal rig gives."""

BEFORE, AFTER, JUDGED = 1.0, 2.0, 0.5
"""s: time before the force step, time after it, and last part of each, over which the position is averaged."""

RECOVERED = 0.1
"""Recovery band as a share of the peak deviation; at least one step of the position sensor."""

SINE_FREQUENCIES = (1.0, 2.0, 4.0, 8.0, 12.0, 18.0, 27.0)
"""Hz; force sines."""

SINE_SETTLING, SINE_WATCHED = 0.5, 1.0
"""s (and two cycles each)."""


def force_step(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    leaks: Sequence[float] = LEAKS,
    plants: int = 8,
    force: float | None = None,
    place: float | None = None,
    first_seed: int = EXPERIMENT_AXES.first,
) -> pd.DataFrame:
    """Deviation after a sudden external force on an axis at rest, without sensor noise, which would hide the recovery.

    Args:
        config: the task, for its plants, sensors and timing.
        controllers: by name.
        leaks: l/min at 100 bar.
        plants: number of plants, drawn.
        force: N; default: a fifth of the force of the supply. Its sign is drawn.
        place: m, where the axis is held; default :func:`~hydro_agents.evaluation.sweeps.working_place`.
        first_seed: seed of the first plant.

    Returns:
        Columns controller, leakage_flow_lpm, seed, force_n, peak_mm (largest deviation), recovery_s (until the
        deviation stays within a tenth of the peak about its final value; NaN if not by the end, as in a limit cycle),
        remaining_mm (deviation at the end, absolute), static_mm_per_kn and dynamic_mm_per_kn (remaining and largest
        deviation per force).

    Raises:
        ControllerError: a controller raises an exception or returns no finite commands.
    """
    newtons = FORCE_SHARE * full_force(config.plant) if force is None else force
    task, period = _held(noiseless(config), place, BEFORE + AFTER), config.control_period
    task = _with_force(task, "step", newtons, BEFORE / (BEFORE + AFTER))
    first, judged = round(BEFORE / period), round(JUDGED / period)
    tables = []
    for name, controller in controllers.items():
        sweep = run_sweep(task, controller, leaks, plants, first_seed)
        position = sweep.rollout.position.astype(np.float64)
        deviation = position - position[:, first - judged : first].mean(axis=1, keepdims=True)
        peak, remaining = np.abs(deviation[:, first:]).max(axis=1), deviation[:, -judged:].mean(axis=1)
        band = np.maximum(RECOVERED * peak, config.sensors.position.resolution)
        outside = np.abs(deviation[:, first:] - remaining[:, None]) > band[:, None]
        recovered = outside.shape[1] - np.argmax(outside[:, ::-1], axis=1)  # samples until the last one outside
        lasting = outside[:, -judged:].any(axis=1)
        columns = {
            "force_n": newtons,
            "peak_mm": 1e3 * peak,
            "recovery_s": np.where(lasting, np.nan, period * np.where(outside.any(axis=1), recovered, 0)),
            "remaining_mm": 1e3 * np.abs(remaining),
            "static_mm_per_kn": 1e6 * np.abs(remaining) / newtons,
            "dynamic_mm_per_kn": 1e6 * peak / newtons,
        }
        tables.append(sweep.table(name, **columns))
    return pd.concat(tables, ignore_index=True)


def force_sine(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    leaks: Sequence[float] = LEAKS,
    plants: int = 4,
    frequencies: Sequence[float] = SINE_FREQUENCIES,
    force: float | None = None,
    place: float | None = None,
    first_seed: int = EXPERIMENT_AXES.first,
) -> pd.DataFrame:
    """Compliance over frequency: amplitude of the position per amplitude of a sinusoidal external force.

    Arguments as for :func:`force_step`; frequencies in Hz.

    Returns:
        Columns controller, leakage_flow_lpm, seed, frequency_hz, force_n, compliance_mm_per_kn.
    """
    newtons = FORCE_SHARE * full_force(config.plant) if force is None else force
    tables = []
    for frequency in frequencies:
        settling = max(SINE_SETTLING, 2.0 / frequency)
        cycles = max(round(SINE_WATCHED * frequency), 2)
        task = _with_force(_held(config, place, settling + cycles / frequency), "sine", newtons, 0.0, frequency)
        first = round(settling / config.control_period)
        for name, controller in controllers.items():
            sweep = run_sweep(task, controller, leaks, plants, first_seed)
            time: Array = sweep.rollout.time[first:]
            answer, _ = sine_fit(sweep.rollout.position[:, first:], time, frequency)
            compliance = 1e6 * np.abs(answer) / newtons
            table = sweep.table(name, frequency_hz=frequency, force_n=newtons, compliance_mm_per_kn=compliance)
            tables.append(table)
    return pd.concat(tables, ignore_index=True)


def _held(config: TaskConfig, place: float | None, duration: float) -> TaskConfig:
    """The task of holding one position (m) for a duration (s)."""
    position = working_place(config.plant) if place is None else place
    return own_reference(config, np.full(round(duration / config.control_period) + 1, position))


def _with_force(config: TaskConfig, kind: str, newtons: float, start: float, frequency: float = 1.0) -> TaskConfig:
    """The task with an external force of one amplitude (N) that begins after a share of the episode."""
    disturbance = {
        "kind": kind,
        "force_range": (newtons, newtons),
        "force_share": (0.0, 0.0),
        "start_range": (start, start),
        "frequency_range": (frequency, frequency),
    }
    return task_config(config, disturbance=disturbance)
