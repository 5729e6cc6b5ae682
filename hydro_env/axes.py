"""Many axes at once: the episodes that both environments share.

:class:`ServoHydraulicEnv` is this with one axis, :class:`ServoHydraulicVectorEnv` with N; so they agree bit for bit.
The class holds the arrays and calls two compiled functions: one begins episodes, one advances a control period.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hydro_env.errors import ConfigurationError
from hydro_env.plant import kernel as plant_kernel
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parameters import PARAMETER_PATHS, PlantParameters, from_vector, to_vector
from hydro_env.plant.states import N_STATES
from hydro_env.reset_options import ResetOptions
from hydro_env.task import kernel as task_kernel
from hydro_env.task.configuration import REFERENCE_FAMILIES, TaskConfig
from hydro_env.task.packing import draw_table, limits_of, observation_layout, step_constants
from hydro_env.task.record import CANNOT_BE_HELD, FAILURES, Record

AXES_PER_THREAD = 256
"""A second thread starts when each has at least this many axes to work on: it takes a while to wake up."""

Floats = NDArray[np.float64]


class Axes:
    """N servo axes in episodes. Arrays are public for reading; ``record`` columns are named by ``Record``.

    Args:
        config: the task.
        count: number of axes N.
        threads: worker threads of a step; ``None`` takes as many as there are cores, where there are axes enough.

    Raises:
        ConfigurationError: the task is impossible.
    """

    def __init__(self, config: TaskConfig, count: int, threads: int | None = None) -> None:
        self.config = config
        self.count = count
        self.observation_names, self.observation_units, self.scale, self.limit = observation_layout(config)
        self.observation_space = spaces.Box(-self.limit.astype(np.float32), self.limit.astype(np.float32))
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

        self._limits = limits_of(config)
        self._constants = step_constants(config)
        self._base = to_vector(config.plant)
        self._draws = draw_table(config)
        weights = np.array([config.references.weights.get(name, 0.0) for name in REFERENCE_FAMILIES])
        self._family_weights = weights / weights.sum()

        samples = config.steps + 1 + max(config.preview_samples, default=0)
        self.state = np.zeros((count, N_STATES))
        self.coefficient = np.zeros((count, plant_kernel.N_COEFFICIENTS))
        self._voltage = np.zeros((count, 2))
        self._peaks = np.zeros((count, plant_kernel.N_PEAKS))
        self.physical = np.zeros((count, len(PARAMETER_PATHS)))
        self.record = np.zeros((count, len(Record._fields)))
        self.reference = np.zeros((count, samples))
        self._noise_key = np.zeros(count, dtype=np.uint64)
        self._roots = np.zeros(count, dtype=np.uint64)
        self._episodes = np.full(count, -1, dtype=np.int64)

        self.options = ResetOptions(config, count, samples)

        wanted = threads if threads is not None else (os.cpu_count() or 1)
        self._threads = max(1, min(wanted, count // AXES_PER_THREAD))
        self._pool: ThreadPoolExecutor | None = None

    # Randomness -----------------------------------------------------------------------------------------------------

    def seed(self, axis: int, generator: np.random.Generator) -> None:
        """Give an axis its root of randomness from its generator; its episodes count from 0 again."""
        self._roots[axis] = generator.integers(0, 2**64, dtype=np.uint64)
        self._episodes[axis] = -1

    # Episodes -------------------------------------------------------------------------------------------------------

    def begin(self, axes: NDArray[np.int64], observation: NDArray[np.float32]) -> None:
        """Begin new episodes on some axes; their rows of ``observation`` (N, n) are written.

        Raises:
            ConfigurationError: an initial position cannot be held by its plant.
        """
        self._episodes[axes] += 1
        task_kernel.begin_episodes(
            axes,
            self._constants,
            self._limits,
            self._base,
            self._draws,
            self._family_weights,
            self._roots,
            self._episodes,
            self.options.parameters,
            self.options.leakage_flow_lpm,
            self.options.initial_position,
            self.options.family,
            self.options.user_reference,
            self.state,
            self.coefficient,
            self.physical,
            self.record,
            self.reference,
            self._noise_key,
            observation,
        )
        self._check_begun(axes)
        self.options.used(axes)

    def _check_begun(self, axes: NDArray[np.int64]) -> None:
        failed = axes[self.column("failure")[axes] != 0.0]
        if len(failed):
            axis = int(failed[0])
            physical = dict(zip(PARAMETER_PATHS, self.physical[axis], strict=True))
            start = 1e3 * self.state[axis, 0]
            what = (
                f"initial position {start:.4g} mm cannot be held"
                if self.column("failure")[axis] == CANNOT_BE_HELD
                else self._unreachable(axis)
            )
            raise ConfigurationError(
                f"axis {axis}: {what} by its plant (supply {physical['supply.pressure'] / 1e5:.3g} bar, spring "
                f"{physical['load.spring_stiffness']:.4g} N/m, external force {physical['load.external_force']:.4g} N, "
                f"leakage {self.column('leak_flow')[axis]:.3g} l/min at 100 bar)"
            )

    def _unreachable(self, axis: int) -> str:
        """Which position of a reference asks for more force than the supply gives, and what that force can hold."""
        from hydro_env.plant.analysis import force_limits  # loaded only to refuse

        plant = self.parameters(axis)
        stiffness = plant.load.spring_stiffness
        if stiffness <= 0.0:
            return "no reference can be reached"
        out, back = force_limits(plant)
        low, high = -back / stiffness, out / stiffness
        row = self.reference[axis]
        farthest = row.max() if row.max() - high > low - row.min() else row.min()
        return (
            f"reference of {1e3 * farthest:.4g} mm cannot be reached, only {1e3 * low:.4g} to {1e3 * high:.4g} mm can,"
        )

    def step(
        self,
        actions: NDArray[Any],
        observation: NDArray[np.float32],
        reward: Floats,
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
    ) -> None:
        """Advance every axis by one control period; the four arrays, (N, n) and (N,), are written."""
        if self._threads == 1:
            self._step_range(actions, observation, reward, terminated, truncated, 0, self.count)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads - 1, thread_name_prefix="hydro_env")
        bounds = [self.count * part // self._threads for part in range(self._threads + 1)]
        waiting = [
            self._pool.submit(self._step_range, actions, observation, reward, terminated, truncated, first, last)
            for first, last in pairwise(bounds[1:])
        ]
        self._step_range(actions, observation, reward, terminated, truncated, bounds[0], bounds[1])
        for future in waiting:
            future.result()

    def _step_range(self, actions: Any, observation: Any, reward: Any, ended: Any, cut: Any, a: int, b: int) -> None:
        task_kernel.step_axes(
            self._constants,
            self.state,
            self.coefficient,
            self._voltage,
            self._peaks,
            self.record,
            self.reference,
            self._noise_key,
            actions,
            observation,
            reward,
            ended,
            cut,
            a,
            b,
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_pool": None}  # threads cannot be copied; they start again when needed

    def close(self) -> None:
        """Stop the worker threads; may be called more than once."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    # What the judge sees --------------------------------------------------------------------------------------------

    def column(self, name: str) -> Floats:
        """A view of one column of ``record``, shape (N,)."""
        return self.record[:, Record._fields.index(name)]

    def leakage_class(self, flow_lpm: Floats) -> NDArray[np.int64]:
        """Class label (index into LEAKAGE_CLASSES) of leaks in l/min at 100 bar."""
        return np.searchsorted(np.array(self.config.leakage.class_bounds) * (1 + 1e-9), flow_lpm)

    def parameters(self, axis: int) -> PlantParameters:
        """The physical parameters of an axis in its present episode, leakage included."""
        vector = self.physical[axis].copy()
        names = Coefficients._fields
        conductance = self.coefficient[axis, names.index("leakage_conductance")]
        vector[PARAMETER_PATHS.index("leakage.internal_resistance")] = (
            1.0 / conductance if conductance > 0.0 else np.inf
        )
        orifice = self.coefficient[axis, names.index("leakage_orifice_gain")]
        vector[PARAMETER_PATHS.index("leakage.orifice_gain")] = orifice
        return from_vector(vector)

    def external_force(self, axis: int) -> float:
        """External force in N that acts on an axis now, disturbance included."""
        row = Coefficients._fields.index("external_force")
        return float(self.coefficient[axis, row])


def failure_name(code: float) -> str:
    """What ended an episode, in words."""
    return FAILURES[int(code)]
