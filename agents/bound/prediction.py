"""Predicts the positions of many axes for many sequences of commands, with the simulator's own integrator."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env import TaskConfig
from hydro_env.axes import Axes
from hydro_env.compiling import SOURCES, compiled
from hydro_env.plant.arrays import coefficient_array
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.kernel import (
    IMPACT_SPEED,
    MOST_STEPS_PER_PERIOD,
    N_PEAKS,
    PEAK_PRESSURE,
    Accuracy,
    Plants,
    integrate,
)
from hydro_env.plant.states import N_STATES, State
from hydro_env.task.kernel import FULL_VOLTAGE
from hydro_env.task.schedules import follow_schedules
from hydro_env.task.settings import settings_of

Array = NDArray[np.float64]

SCHEDULED = tuple(
    Coefficients._fields.index(name) for name in ("leakage_conductance", "leakage_orifice_gain", "external_force")
)
"""Coefficients that change during an episode."""

POSITION = State._fields.index("position")
PERTURBATION = 0.01
"""Change of a command, in parts of 10 V, that gives the sensitivities; it exceeds the integrator's error far."""

ROWS_PER_THREAD = 128
"""Each thread gets at least this many rows; with fewer, waking it takes longer than its work."""


class Prediction:
    """The positions of N axes over a horizon, from given states and commands.

    Args:
        config: the task.
        coefficients: of each plant, (N, coefficients).
        schedule: the coefficients :data:`SCHEDULED` in each control period of the episode and of the horizon beyond
            its end, (periods, N, 3).
        threads: worker threads; ``None`` takes one per core.
    """

    def __init__(self, config: TaskConfig, coefficients: Array, schedule: Array, threads: int | None = None) -> None:
        self.count = len(coefficients)
        self._failure = config.failure
        self._coefficients = coefficients
        self._schedule = schedule
        self._durations = np.array([config.command_latency, config.control_period - config.command_latency])
        self._accuracy = Accuracy(config.maximum_step, config.tolerance, MOST_STEPS_PER_PERIOD)
        self._repeated: dict[int, Array] = {}
        self._threads = threads if threads is not None else (os.cpu_count() or 1)
        self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="bound") if self._threads > 1 else None

    def positions(self, state: Array, before: Array, commands: Array, step: int, drift: Array | None = None) -> Array:
        """Positions (N, M, H), m, at the end of each period; infinite from a failure on.

        Args:
            state: of each plant now, (N, states).
            before: the command that acts until the first one of ``commands`` does, (N,), in parts of 10 V.
            commands: M sequences for each axis, (N, M, H), in parts of 10 V.
            step: number of the period that begins.
            drift: what the model misses in each period, added to the state at its end, (N, states).
        """
        axes, sequences, horizon = commands.shape
        rows = axes * sequences
        states = np.repeat(state, sequences, axis=0)
        drifts = None if drift is None else np.repeat(drift, sequences, axis=0)
        volts = FULL_VOLTAGE * commands.reshape(rows, horizon)
        voltage = np.empty((rows, 2))
        voltage[:, 1] = FULL_VOLTAGE * np.repeat(before, sequences)
        peaks = np.zeros((rows, N_PEAKS))
        positions = np.empty((rows, horizon))
        failed = np.zeros(rows, dtype=np.bool_)
        for period in range(horizon):
            voltage[:, 0] = voltage[:, 1]
            voltage[:, 1] = volts[:, period]
            coefficients = self._coefficients_at(step + period, sequences, along_rows=True)
            self._advance(states, coefficients, voltage, peaks, rows)
            failed |= (peaks[:, IMPACT_SPEED] > self._failure.end_stop_speed) | (
                peaks[:, PEAK_PRESSURE] > self._failure.pressure_rating
            )
            if drifts is not None:
                states += drifts
            position = states[:, POSITION]
            failed |= ~np.isfinite(position)
            positions[:, period] = np.where(failed, np.inf, position)
        return positions.reshape(axes, sequences, horizon)

    def sensitivities(
        self, state: Array, before: Array, commands: Array, step: int, drift: Array | None = None
    ) -> tuple[Array, Array]:
        """Positions (N, H) of one sequence of commands (N, H), and their change per change of each command (N, H, H).

        Entry [n, i, j] is the change of the position at the end of period i, m per 1 of command j. The differences are
        one-sided, towards the middle of the range of commands. The other arguments are those of :meth:`positions`.
        """
        axes, horizon = commands.shape
        # Block 0 holds the plants as they are; block j + 1 leaves it at period j, with another command.
        changes = np.where(commands > 0.0, -PERTURBATION, PERTURBATION)
        states = np.empty((horizon + 1, axes, N_STATES))
        states[0] = state
        voltage = np.empty((horizon + 1, axes, 2))
        voltage[0, :, 1] = FULL_VOLTAGE * before
        peaks = np.zeros(((horizon + 1) * axes, N_PEAKS))
        positions = np.zeros((horizon, horizon + 1, axes))
        for period in range(horizon):
            last = period + 2
            states[period + 1] = states[0]
            voltage[period + 1] = voltage[0]
            voltage[:last, :, 0] = voltage[:last, :, 1]
            voltage[:last, :, 1] = FULL_VOLTAGE * commands[:, period]
            voltage[period + 1, :, 1] += FULL_VOLTAGE * changes[:, period]
            coefficients = self._coefficients_at(step + period, horizon + 1, along_rows=False)
            self._advance(states.reshape(-1, N_STATES), coefficients, voltage.reshape(-1, 2), peaks, last * axes)
            if drift is not None:
                states[:last] += drift
            positions[period, :last] = states[:last, :, POSITION]
            positions[period, last:] = positions[period, 0]
        # (periods, changed commands, N) to (N, periods, changed commands)
        differences = (positions[:, 1:] - positions[:, :1]) / changes.T[None]
        return np.ascontiguousarray(positions[:, 0].T), np.ascontiguousarray(differences.transpose(2, 0, 1))

    def next_state(self, state: Array, before: Array, command: Array, step: int) -> Array:
        """State (N, states) after one period with one command (N,) for each axis."""
        states = state.copy()
        voltage = FULL_VOLTAGE * np.stack([before, command], axis=1)
        self._advance(states, self._coefficients_at(step, 1, True), voltage, np.zeros((len(state), N_PEAKS)), len(state))
        return states

    def close(self) -> None:
        """Stop the worker threads; may be called more than once."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def _coefficients_at(self, step: int, copies: int, along_rows: bool) -> Array:
        """Coefficients of a period for several copies of each plant, which follow each other or are N rows apart."""
        key = copies if along_rows else -copies
        if key not in self._repeated:
            source = self._coefficients
            self._repeated[key] = np.repeat(source, copies, 0) if along_rows else np.tile(source, (copies, 1))
        rows = self._repeated[key]
        now = self._schedule[min(step, len(self._schedule) - 1)]
        rows[:, SCHEDULED] = np.repeat(now, copies, 0) if along_rows else np.tile(now, (copies, 1))
        return rows

    def _advance(self, states: Array, coefficients: Array, voltage: Array, peaks: Array, rows: int) -> None:
        """Advance the first rows by one control period, in place."""
        plants = Plants(states, coefficients, voltage, peaks)
        parts = max(1, min(self._threads, rows // ROWS_PER_THREAD))
        bounds = [rows * part // parts for part in range(parts + 1)]
        if self._pool is None or parts == 1:
            integrate(plants, self._durations, self._accuracy, 0, rows)
            return
        for work in [self._pool.submit(integrate, plants, self._durations, self._accuracy, *b) for b in pairwise(bounds)]:
            work.result()


def true_schedule(config: TaskConfig, axes: Axes, periods: int) -> Array:
    """The coefficients :data:`SCHEDULED` of the true plants in each control period, (periods, N, 3)."""
    schedule = np.empty((periods, axes.count, len(SCHEDULED)))
    _follow(settings_of(config), axes.record.copy(), axes.coefficient.copy(), np.array(SCHEDULED), schedule)
    return schedule


def nominal_plants(config: TaskConfig, count: int) -> Array:
    """The coefficients of the task's nominal plant, once for each axis, (N, coefficients)."""
    return np.tile(coefficient_array(config.plant), (count, 1))


def _build(sources: int) -> Any:
    def follow(task: Any, record: Any, coefficient: Array, columns: Sequence[int], schedule: Array) -> None:
        assert sources >= 0  # keys numba's cache
        settings = task[0]
        for axis in range(record.shape[0]):
            row = record[axis]
            for period in range(schedule.shape[0]):
                row.step = period
                follow_schedules(row, coefficient[axis], settings)
                for index in range(schedule.shape[2]):
                    schedule[period, axis, index] = coefficient[axis, columns[index]]

    return compiled(follow)


_follow = _build(SOURCES)
