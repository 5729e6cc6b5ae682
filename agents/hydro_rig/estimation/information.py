"""The Cramér–Rao bound: the smallest standard deviation with which any method can estimate an unknown from a window.

The readings are r = h(θ) + noise, with the simulator as h, white noise of each sensor (its 16-bit steps included), and
a normal prior of each unknown. The information about θ is then I = Jᵀ W J + P, with J = ∂h/∂θ at the truth, W the
inverse variances of the noise and P those of the priors; no unbiased estimate of θ_i has a variance below (I⁻¹)_ii
(Kay, *Fundamentals of Statistical Signal Processing: Estimation Theory*, 1993, chapter 3; with priors: Van Trees,
*Detection, Estimation, and Modulation Theory* I, 1968, section 2.4).

The bound assumes that the model has the true structure. It depends on what else is unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hydro_agents.detection.operations import ACTING
from hydro_agents.evaluation.conditions import Cell
from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import Columns, Job
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.types import Floats
from hydro_rig.estimation.estimate import usable_readings
from hydro_rig.estimation.known_windows import KnownWindows, known_windows
from hydro_rig.estimation.model import Model
from hydro_rig.estimation.solver import Problem
from hydro_rig.estimation.unknowns import LEAKAGE, Prior, priors_of

TOLERANCE = 1e-8  # tolerance of the integrator for the derivatives; a smaller one changes the bound by less than 0.1 %

RESPONSE = 3.0
"""Change of the readings by one step of a difference, in standard deviations of their noise, over all samples.

With smaller steps the integrator's error dominates; with larger ones the readings do not change linearly. A tenth of
this step changes the bound by 0.01 %, a step ten times as large by up to 1 %.
"""


def bound(
    config: TaskConfig,
    windows: KnownWindows,
    priors: Mapping[str, Prior],
    name: str = LEAKAGE,
    threads: int | None = None,
) -> Floats:
    """The smallest standard deviation of one unknown, (B,), in its unit, when all others are unknown too.

    Args:
        config: the task.
        windows: B known windows; their commands are replayed on the true plants.
        priors: the unknowns, as :func:`hydro_rig.estimation.unknowns.priors_of` gives them.
        name: of the unknown.
        threads: worker threads; ``None`` takes one per core.
    """
    model, scaled = true_model(config, windows, priors, threads)
    problem, place = Problem(model, usable_readings(windows.signals, config, model)), model.names.index(name)
    linear = problem.linearised(scaled, steps_at(model, scaled), central=True)
    deviation: Floats = np.sqrt(linear.covariance()[:, place, place])
    return deviation * model.derivative(scaled)[:, place]


def true_model(
    config: TaskConfig, windows: KnownWindows, priors: Mapping[str, Prior], threads: int | None = None
) -> tuple[Model, Floats]:
    """The model of known windows with a strict integrator, and the true scaled unknowns (B, P)."""
    strict = task_config(config, tolerance=min(config.tolerance, TOLERANCE))
    model = Model(strict, priors, windows.signals[:, -1], windows.physical, windows.start, threads)
    return model, model.scaled(np.stack([windows.value(name) for name in priors], axis=1))


def steps_at(model: Model, scaled: Floats) -> Floats:
    """Steps of the differences, (B, S, S): by a coarse derivative each changes the readings by :data:`RESPONSE`."""
    coarse = model.linearise(scaled)[1][:, model.simulated]
    steps = np.clip(RESPONSE / np.sqrt(1.0 + (coarse**2).sum(axis=(2, 3))), 1e-7, 0.1)
    return np.asarray(steps[:, :, None] * np.eye(len(model.simulated)))


def leak_bound(protocol: LeakProtocol) -> Iterator[Cell]:
    """The bound of some windows of the conditions that a protocol names."""
    for name in protocol.bound_conditions:
        condition, config = protocol.conditions[name], protocol.task_in(name)
        begin = 0.0 if condition.begins == "at rest" else condition.duration
        times = (begin, condition.duration - config.control_period)
        for level in protocol.levels_in(name):
            if level >= 0.0:
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
    controller = ACTING[acting].make(config, len(cases), int(cases.seeds[0]))
    windows = known_windows(config, controller, cases, begin, duration)
    found = np.full(len(cases), np.nan)
    found[windows.case] = bound(config, windows, priors_of(known), threads=1)
    return {"seed": cases.seeds.astype(np.float64), "sigma_lpm": found}
