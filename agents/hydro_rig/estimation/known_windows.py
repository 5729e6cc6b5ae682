"""Windows of simulated axes: the signals that a rig measures, the hidden true values, and the Cramér–Rao bound.

The bound is the smallest standard deviation with which any method can estimate an unknown from a window. The
information about the unknowns θ is I = Jᵀ W J + P, with J = ∂h/∂θ of the simulated readings at the truth, W the inverse
variances of the sensors' noise and P those of the priors; no unbiased estimate of θ_i has a variance below (I⁻¹)_ii
(Kay, *Fundamentals of Statistical Signal Processing: Estimation Theory*, 1993, chapter 3; with priors: Van Trees,
*Detection, Estimation, and Modulation Theory* I, 1968, section 2.4), if the model has the true structure.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.operations import ACTING
from hydro_agents.evaluation.conditions import Cell
from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.running.cases import Cases, TrueStateController, run_cases
from hydro_agents.running.jobs import Columns, Job
from hydro_agents.running.tasks import steady
from hydro_env import ConfigurationError, TaskConfig, task_config
from hydro_env.axes import Axes
from hydro_env.plant.parameters import PARAMETER_PATHS, to_vector
from hydro_env.plant.parts.leakage import ROD_SEAL
from hydro_env.task.faults import FAULTS
from hydro_env.task.sensors import SENSOR_COLUMNS, SENSORS
from hydro_env.types import Floats, Indices
from hydro_rig.estimation.estimate import usable_readings
from hydro_rig.estimation.model import Model
from hydro_rig.estimation.solver import Problem
from hydro_rig.estimation.unknowns import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    LATENCY,
    LEAKAGE,
    STARTS,
    Priors,
    priors_of,
)

TOLERANCE = 1e-8  # tolerance of the integrator for the derivatives; a smaller one changes the bound by less than 0.1 %


class KnownWindows(NamedTuple):
    """B windows of T samples."""

    signals: Floats  # (B, 5, T), SI: the measured signals (NaN without sensor) and the command that acts at each sample
    leakage_flow_lpm: Floats  # (B,), l/min at 100 bar
    physical: Floats  # (B, parameters), the true plants with their faults, in the order of PARAMETER_PATHS
    start: Floats  # (B, N_ALL_STATES), true state at the first sample
    latency: Floats  # (B,), s
    bias: Floats  # (B, channels), SI; a fault's offset included
    case: Indices  # (B,), index of the case; failed cases are left out

    def value(self, name: str) -> Floats:
        """True values (B,) of an unknown of :mod:`hydro_rig.estimation.unknowns`, in its unit."""
        if name == LEAKAGE:
            return self.leakage_flow_lpm
        if name == EXTERNAL_LEAKAGE:
            return ROD_SEAL.flow(self.physical[:, PARAMETER_PATHS.index(EXTERNAL_RESISTANCE)])
        if name == LATENCY:
            return self.latency
        for names, values in ((BIASES, self.bias), (STARTS, self.start)):
            if name in names:
                return values[:, names.index(name)]
        return self.physical[:, PARAMETER_PATHS.index(name)]


def known_windows(
    config: TaskConfig, controller: Controller, cases: Cases, begin: float, length: float
) -> KnownWindows:
    """Run every case and extract one window, which begins ``begin`` s after the start of the episode; ``length`` in s.

    Leak, faults and external force stay constant during an episode, as the model assumes.

    Raises:
        ConfigurationError: the window is shorter than two control periods, or no case reaches its end.
    """
    first, periods = round(begin / config.control_period), round(length / config.control_period)
    if periods < 2:
        raise ConfigurationError(f"window = {length:g} s: must last two control periods or more")
    task = task_config(steady(config), episode_duration=(first + periods + 1) * config.control_period)
    watcher = _Watcher(controller, first, periods + 1)
    run = run_cases(task, watcher, cases)
    kept = np.flatnonzero((run.failed_at < 0) | (run.failed_at >= first + periods))
    if not len(kept):
        raise ConfigurationError(f"windows: all {len(cases)} axes failed before the end of their window")
    signals = np.stack(watcher.columns, axis=2)[kept]
    signals[:, [place for place, sensor in enumerate(config.sensors.in_order) if not sensor.fitted]] = np.nan
    return KnownWindows(
        signals=signals,
        leakage_flow_lpm=run.leakage_flow_lpm[kept],
        case=kept,
        **{name: values[kept] for name, values in watcher.truth.items()},
    )


class _Watcher:
    """Passes on the commands of a controller, and records the state of the axes."""

    def __init__(self, controller: Controller, first: int, samples: int) -> None:
        self.controller, self.first, self.last = controller, first, first + samples
        self.columns: list[Floats] = []
        self.truth: dict[str, Floats] = {}
        self._step = 0

    def begin(self, axes: Axes) -> None:
        self._axes = axes
        if isinstance(self.controller, TrueStateController):
            self.controller.begin(axes)

    def predict(self, *given: Any, **more: Any) -> Any:
        axes = self._axes
        if self._step == self.first:
            self.truth = {
                "physical": np.array([_physical(axes, axis) for axis in range(axes.count)]),
                "start": axes.complete_state.copy(),
                "latency": axes.column("latency").copy(),
                "bias": _biases(axes),
            }
        if self.first <= self._step < self.last:
            self.columns.append(np.column_stack([axes.column("measured")[:, SENSOR_COLUMNS], axes.column("command")]))
        self._step += 1
        return self.controller.predict(*given, **more)


def _physical(axes: Axes, axis: int) -> Floats:
    """Present parameters of an axis; its external force includes the constant part that the task adds."""
    vector = to_vector(axes.parameters(axis))
    vector[PARAMETER_PATHS.index("load.external_force")] = axes.external_force(axis)
    return vector


def _biases(axes: Axes) -> Floats:
    """Biases of the sensors of all axes now, (N, sensors), SI, offsets by a fault included."""
    offset = axes.column("fault")[:, [FAULTS.index(f"{name}_offset") for name in SENSORS]]
    spans = np.array([sensor.high - sensor.low for sensor in axes.config.sensors.in_order])
    return axes.column("bias")[:, SENSOR_COLUMNS] + offset * spans


def leak_cases(seeds: range, count: int, leakage_flow_lpm: float, faults: Mapping[str, float] | None = None) -> Cases:
    """The first seeds of a range as cases, all with the same leak (l/min at 100 bar) and the same faults."""
    levels = np.full(count, leakage_flow_lpm)
    every = {name: np.full(count, size) for name, size in (faults or {}).items()}
    return Cases(np.array(seeds[:count], np.int64), levels, faults=every)


def bound(config: TaskConfig, windows: KnownWindows, priors: Priors, threads: int | None = None) -> Floats:
    """The smallest standard deviation of the leak, (B,), l/min at 100 bar, when the other unknowns are unknown too.

    The commands of the windows are replayed on the true plants; ``threads``: ``None`` takes one per core.
    """
    model, scaled = true_model(config, windows, priors, threads)
    linear = Problem(model, usable_readings(windows.signals, config, model)).linearised(scaled, central=True)
    place = model.names.index(LEAKAGE)
    return np.sqrt(linear.covariance()[:, place, place]) * model.prior.slope(scaled)[:, place]


def true_model(
    config: TaskConfig, windows: KnownWindows, priors: Priors, threads: int | None = None
) -> tuple[Model, Floats]:
    """The model of known windows with a strict integrator, and the true scaled unknowns (B, P)."""
    strict = task_config(config, tolerance=min(config.tolerance, TOLERANCE))
    model = Model(strict, priors, windows.signals[:, -1], windows.physical, windows.start, threads)
    return model, model.prior.scaled(np.stack([windows.value(name) for name in priors], axis=1))


def leak_bound(protocol: LeakProtocol) -> Iterator[Cell]:
    """The bound of some windows of the conditions that a protocol names."""
    for name in protocol.bound_conditions:
        condition, config = protocol.conditions[name], protocol.tasks[name]
        begin = 0.0 if condition.begins == "at rest" else condition.duration
        times = (begin, condition.duration - config.control_period)
        for level in condition.levels or protocol.levels:
            cases = protocol.cases_in(name, level, protocol.bound_windows)
            arguments = (config, protocol.known_task(name), condition.acting, *times, cases)
            job = Job(bound_of_windows, None, arguments, digest="bound")
            yield Cell("bound", "bound", name, {"condition": name, "level": level}, (job,))


def bound_of_windows(
    _: None, config: TaskConfig, known: TaskConfig, acting: str, begin: float, duration: float, cases: Cases
) -> Columns:
    """Smallest standard deviation of the leak, l/min at 100 bar; all quantities that the task draws are unknown.

    The runs are those of ``config``, the priors follow from ``known``; ``begin`` and ``duration`` of the windows in s.
    """
    windows = known_windows(config, ACTING[acting](config, len(cases), cases.seeds[0]), cases, begin, duration)
    found = np.full(len(cases), np.nan)
    found[windows.case] = bound(config, windows, priors_of(known), threads=1)
    return {"seed": cases.seeds.astype(float), "sigma_lpm": found}
