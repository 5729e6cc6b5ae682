"""Episodes of many axes at once: the core of both environments.

:class:`ServoHydraulicEnv` uses it with one axis, :class:`ServoHydraulicVectorEnv` with N; both agree bit for bit.
:class:`Axes` holds the arrays and calls two compiled functions: one begins episodes, one advances a control period.
"""

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from gymnasium import spaces

from hydro_env.errors import ConfigurationError
from hydro_env.plant.arrays import N_DERIVED, functions_of
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parameters import PARAMETER_PATHS, PlantParameters, from_vector, to_vector
from hydro_env.plant.parts.leakage import LEAK_LAWS, ROD_SEAL
from hydro_env.plant.states import ALL_STATES, N_STATES, columns_of
from hydro_env.reset_options import ResetOptions
from hydro_env.task import kernel as task_kernel
from hydro_env.task.configuration import TaskConfig
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.faults import FAULT_KINDS, FAULTS, KIND_OF_FAULT
from hydro_env.task.record import (
    CANNOT_BE_HELD,
    FIRST_COEFFICIENT,
    FIRST_PEAK,
    FIRST_VOLTAGE,
    NO_FAILURE,
    PLANT_COLUMNS,
    RECORD,
    SEEDS,
    AxisArrays,
    Chances,
    table,
)
from hydro_env.task.reference_signals import REFERENCE_FAMILIES, RESTING_FROM, USER_FAMILY
from hydro_env.task.settings import padded_draws, settings_of
from hydro_env.task.signals import POSITION, layout_of, observation_layout
from hydro_env.types import Array, Arrays, ByName, Floats, Indices, Mask

AXES_PER_THREAD = 256  # smallest number of axes per thread; with fewer, starting the thread takes longer than its work

_TIP = list(ALL_STATES).index("tip_position")

COLUMN = {name: offset // 8 for name, (_, offset, *_) in (RECORD.fields or {}).items()}
"""Column of :attr:`Axes.numbers` for the (first) number of each field of a record, up to ``noise_key``."""


@dataclass(frozen=True)
class AxesState:
    """Complete state of an environment; it can be pickled and set on any one with the same task.

    ``arrays`` have one row per axis; ``generator`` is the state of ``np_random``, ``history`` holds the past positions
    and references of the drawing.
    """

    config: TaskConfig
    arrays: Arrays
    generator: Mapping[str, Any] | None = None
    history: tuple[tuple[float, float], ...] = ()

    @property
    def count(self) -> int:
        """Number of axes."""
        return len(self.arrays["record"])


class Axes:
    """N servo axes and their episodes. Arrays are public for reading; ``record`` has the fields of ``RECORD``.

    A step has at most so many ``threads``, and no more than the number of axes needs; ``None``: one per core.

    Raises:
        ConfigurationError: the task is impossible, or the axes do not fit into memory.
    """

    def __init__(self, config: TaskConfig, count: int, threads: int | None = None) -> None:
        if config.sensors.differential_pressure:
            raise ConfigurationError("sensors.differential_pressure = true: for recordings; the environment has none")
        self.config = config
        self.count = count
        self.observation_names, self.observation_units, self.scale, self.limit = observation_layout(config)
        self.observation_space = spaces.Box(-self.limit.astype(np.float32), self.limit.astype(np.float32))
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

        self.tasks = rig_tasks(config)
        structures = [task.plant.structure for task in self.tasks]
        self._tips = np.array([structure.tip for structure in structures])
        self.has_tip = self._tips.any()  # whether any rig of the task has a second mass
        self._has_waves = any(structure.lines for structure in structures)
        self._kinds = sorted(set(structures))
        self._kind_of_rig = np.array([self._kinds.index(structure) for structure in structures])
        self._task = np.concatenate([settings_of(task) for task in self.tasks])
        self._layout = np.stack([layout_of(task, config.law) for task in self.tasks])
        samples = self._task["samples"].max()
        try:
            self.arrays = AxisArrays(
                record=table(count, RECORD),
                plant=np.zeros((count, PLANT_COLUMNS)),
                reference=np.zeros((count, samples)),
                observation=np.zeros((count, len(self.scale)), np.float32),
            )
            self.physical = np.zeros((count, len(PARAMETER_PATHS)))
            self.options = ResetOptions(self.tasks, count, samples)
        except MemoryError:
            raise ConfigurationError(f"num_envs = {count} with {config.steps} steps: too large for memory") from None
        self._name_parts()

        weights = np.array([config.references.weights.get(name, 0.0) for name in REFERENCE_FAMILIES])
        self._chances = Chances(
            seeds=table(count, SEEDS),
            plant=np.array([to_vector(task.plant) for task in self.tasks]),
            draws=padded_draws(self.tasks),
            family_weights=weights / weights.sum(),
        )
        self._chances.seeds["episode"] = -1
        drawn = any(getattr(config.faults, kind).probability > 0.0 for kind in FAULT_KINDS)
        self._is_rare = drawn or weights[RESTING_FROM:USER_FAMILY].any() or config.disturbance.kind != "none"

        self._threads = threads or os.cpu_count() or 1
        self._undivided = len(self._kinds) == 1 and min(self._threads, count // AXES_PER_THREAD) <= 1
        self._pool: ThreadPoolExecutor | None = None
        self._scheduled = False

    def _name_parts(self) -> None:
        """Make views of the arrays.

        ``numbers`` holds the records as rows of plain numbers (:data:`COLUMN`), which Python reads faster than fields;
        it ends before the fields that are not needed in a step of an environment.
        """
        self._kernels = [task_kernel.step_of(kind) for kind in self._kinds]
        self._fixed_arguments = (self._task, self._layout, *self.arrays)
        self.record, plant, self.reference, self.observation = self.arrays
        self.state = plant[:, :N_STATES]
        self.complete_state = plant[:, :FIRST_COEFFICIENT]
        self.coefficient = plant[:, FIRST_COEFFICIENT:FIRST_VOLTAGE]
        self.peaks = plant[:, FIRST_PEAK:]
        self.numbers = self.record.view(np.ndarray).view(np.float64).reshape(self.count, -1)[:, : COLUMN["noise_key"]]

    def seed(self, axis: int, generator: np.random.Generator) -> None:
        """Seed an axis from its generator; its episode number restarts at 0."""
        self._chances.seeds["root"][axis] = generator.integers(0, 2**64, dtype=np.uint64)
        self._chances.seeds["episode"][axis] = -1

    def begin(self, axes: Indices) -> None:
        """Begin new episodes on some axes.

        Raises:
            ConfigurationError: no drawn plant can hold its initial position.
        """
        self._chances.seeds["episode"][axes] += 1
        self.record[axes] = np.zeros((), RECORD)
        rare = self._rare(axes)
        begins = [(task_kernel.begin_usual, axes[~rare]), (task_kernel.begin_any, axes[rare])]
        if self._has_waves:
            begins = [(task_kernel.begin_with_lines, axes)]
        for begin, chosen in begins:
            if len(chosen):
                begin(chosen, self._task, self._layout, self._chances, self.options.fixed, self.physical, *self.arrays)
        self._check_begun(axes)
        self._note_schedules()
        self.options.fix({}, axes)

    def _rare(self, axes: Indices) -> Mask:
        """Which of these axes may begin with a fault, a changing force, or a reference at which they hardly move."""
        family, faults = self.options.fixed.family[axes], self.options.fixed.faults[axes]
        return ((family >= RESTING_FROM) & (family != USER_FAMILY)) | ~np.isnan(faults).all(axis=1) | self._is_rare

    def _note_schedules(self) -> None:
        """Note whether leak, faults or force of any axis may change during its episode."""
        changing = self.column("leak_schedule").any() or self.column("faulty").any()
        self._scheduled = bool(changing) or self.config.disturbance.kind != "none"

    def _check_begun(self, axes: Indices) -> None:
        failed = axes[self.column("failure")[axes] != NO_FAILURE]
        if not len(failed):
            return
        axis = failed[0]
        plant, what = self.parameters(axis), "its reference cannot be reached"
        if self.column("failure")[axis] == CANNOT_BE_HELD:
            shift = self._task["start_bias_share"][0] * self.column("bias")[axis, POSITION]
            what = f"initial position {1e3 * (self.column('position')[axis] + shift):.4g} mm cannot be held"
        raise ConfigurationError(
            f"axis {axis}: {what} by its plant (supply {plant.supply.pressure / 1e5:.3g} bar, spring "
            f"{plant.load.spring_stiffness:.4g} N/m, external force {plant.load.external_force:.4g} N, leakage "
            f"{self.column('leak_flow')[axis]:.3g} l/min at 100 bar), nor by {task_kernel.MOST_DRAWS - 1} others that "
            "were drawn"
        )

    def step(self, actions: Array) -> None:
        """Advance every axis by one control period with the commands ``actions``, (N,), within −1 to 1."""
        if self._scheduled:
            task_kernel.follow(self._task, self.record, self.arrays.plant, 0, self.count)
        if self._undivided:  # at once: the calls of the other ways would cost one axis a twentieth of its step
            self._kernels[0].loaded(*self._fixed_arguments, actions, 0, self.count)
            return
        if len(self._kernels) == 1:
            self._advance(self._kernels[0], self._fixed_arguments, actions)
            return
        for kind, axes in self._groups():
            record, plant, reference, observation = self.arrays
            part = AxisArrays(record[axes], plant[axes], reference[axes], observation[axes])
            self._advance(self._kernels[kind], (self._task, self._layout, *part), actions[axes])
            own: Any
            for own, moved in zip(self.arrays, part, strict=True):
                own[axes] = moved

    def _groups(self) -> list[tuple[int, Indices]]:
        """Number of each structure among the task's, and the axes that have it now."""
        numbers = self._kind_of_rig[self.rigs()]
        return [(number, np.flatnonzero(numbers == number)) for number in np.unique(numbers)]

    def _advance(self, kernel: Any, arguments: tuple[Any, ...], actions: Array) -> None:
        """Advance axes that have one structure, in several threads if they are many."""
        count = len(actions)
        threads = min(self._threads, count // AXES_PER_THREAD)
        if threads <= 1:
            kernel.loaded(*arguments, actions, 0, count)
            return
        if not self._pool:
            self._pool = ThreadPoolExecutor(self._threads - 1, thread_name_prefix="hydro_env")
        bounds = [count * part // threads for part in range(threads + 1)]
        advance = partial(kernel.loaded, *arguments, actions)
        waiting = [self._pool.submit(advance, first, last) for first, last in pairwise(bounds[1:])]
        advance(bounds[0], bounds[1])
        for future in waiting:
            future.result()

    def ended(self) -> Mask:
        """True for the axes that have failed or reached the end of their episode, shape (N,)."""
        return (self.column("failure") != NO_FAILURE) | (self.column("step") >= self.steps())

    def tip_position(self) -> Floats:
        """Position of the second mass, m, (N,); of a rigid load that of the piston."""
        return np.where(self._tips[self.rigs()], self.complete_state[:, _TIP], self.column("position"))

    def rigs(self) -> Indices:
        """Number of each axis's rig among :attr:`tasks`, (N,)."""
        return self.column("rig").astype(np.int64)

    def steps(self) -> Floats | float:
        """Control periods in the present episode of each axis, (N,), or of all axes."""
        return self._task["steps"][self.rigs()] if len(self.tasks) > 1 else float(self.tasks[0].steps)

    def __getstate__(self) -> ByName:
        views = ("record", "state", "complete_state", "coefficient", "peaks", "reference", "observation", "numbers")
        return {
            **self.__dict__,
            **dict.fromkeys((*views, "_fixed_arguments", "_kernels")),
            "_pool": None,
        }  # threads start again when needed

    def __setstate__(self, state: ByName) -> None:
        self.__dict__.update(state)
        self._name_parts()

    def derived(self) -> Floats:
        """Quantities that follow from the states, (N, N_DERIVED), in the order of ``Derived``."""
        found = np.empty((self.count, N_DERIVED))
        for number, axes in self._groups():
            kind = self._kinds[number]
            states, coefficients = self.complete_state[axes][:, columns_of(kind)], self.coefficient[axes]
            found[axes] = functions_of(kind).derived(states, coefficients)
        return found

    def close(self) -> None:
        """Stop the worker threads; may be called more than once."""
        if self._pool:
            self._pool.shutdown()
            self._pool = None

    def _rows(self) -> Arrays:
        """Every array that an episode depends on, by name; one row per axis."""
        arrays = {**self.arrays._asdict(), "physical": self.physical, "seeds": self._chances.seeds}
        for name, values in self.options.fixed._asdict().items():
            arrays[f"fixed_{name}"] = values
        return arrays

    def get_state(self) -> Arrays:
        """Every array that an episode depends on, by name, as copies; one row per axis."""
        return {name: values.copy() for name, values in self._rows().items()}

    def set_state(self, rows: Mapping[str, Array]) -> None:
        """Set arrays of :meth:`get_state`, which have one row per axis or one for all."""
        for name, own in self._rows().items():
            own[:] = rows[name]
        self._note_schedules()

    def column(self, name: str) -> Floats:
        """A view of one field of ``record``, shape (N,), or (N, entries)."""
        return self.record[name]

    def faults(self) -> dict[str, Floats]:
        """Present magnitude of each fault that any axis has, by name; (N,) each, 0 for none."""
        if not self.column("faulty").any():
            return {}
        magnitudes = self.column("fault")
        return {FAULTS[index]: magnitudes[:, index].copy() for index in np.flatnonzero(magnitudes.any(axis=0))}

    def drawn_faults(self) -> dict[str, Floats]:
        """Present magnitude, (N,), of each fault that the task may draw, by name."""
        return {
            name: self.column("fault")[:, index].copy()
            for index, name in enumerate(FAULTS)
            if getattr(self.config.faults, KIND_OF_FAULT[name]).probability > 0.0
        }

    def parameters(self, axis: int) -> PlantParameters:
        """The physical parameters of an axis in its present episode, leakage and faults included."""
        vector, at = self.physical[axis].copy(), PARAMETER_PATHS.index
        for law in LEAK_LAWS.values():
            coefficient = self.coefficient[axis, Coefficients._fields.index(law.coefficient)]
            vector[at(f"leakage.{law.parameter}")] = law.value_of_coefficient(coefficient)
        faults = dict(zip(FAULTS, self.column("fault")[axis], strict=True))
        vector[at("valve.null_shift")] += faults["valve_null_shift"]
        vector[at("valve.underlap")] += faults["valve_underlap"]
        vector[at("valve.rated_flow")] *= 1.0 + faults["valve_flow"]
        vector[at("supply.tank_pressure")] += faults["tank_pressure"]
        if faults["external_leak"] > 0.0:
            rod_seal = at(f"leakage.{ROD_SEAL.parameter}")
            vector[rod_seal] = 1.0 / (1.0 / vector[rod_seal] + 1.0 / ROD_SEAL.value(faults["external_leak"]))
        return from_vector(vector)

    def external_force(self, axis: int) -> float:
        """External force in N that acts on an axis now, disturbance included."""
        return self.coefficient[axis, Coefficients._fields.index("external_force")]
