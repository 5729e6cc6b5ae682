"""The Cramér–Rao bound: the smallest standard deviation with which any method can estimate an unknown from a window.

The readings are r = h(θ) + noise, with the simulator as h, white noise of each sensor (its 16-bit steps included), and
a normal prior of each unknown. The information about θ is then I = Jᵀ W J + P, with J = ∂h/∂θ at the truth, W the
inverse variances of the noise and P those of the priors; no unbiased estimate of θ_i has a variance below (I⁻¹)_ii
(Kay, *Fundamentals of Statistical Signal Processing: Estimation Theory*, 1993, chapter 3; with priors: Van Trees,
*Detection, Estimation, and Modulation Theory* I, 1968, section 2.4). Information adds up over sensors and samples; one
Jacobian therefore serves every choice of sensors, every shorter window and every smaller set of unknowns.

The bound assumes that the model has the true structure. It depends on what else is unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hydro_agents.detection.operations import ACTING
from hydro_agents.evaluation.conditions import Cell
from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import Columns, Job
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.mistakes import one_of
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Floats
from hydro_rig.estimation.estimate import usable_readings
from hydro_rig.estimation.known_windows import KnownWindows, known_windows
from hydro_rig.estimation.model import Model
from hydro_rig.estimation.unknowns import LEAKAGE, Prior, priors_of

TOLERANCE = 1e-8  # tolerance of the integrator for the derivatives; a smaller one changes the bound by less than 0.1 %

RESPONSE = 3.0
"""Change of the readings by one step of a difference, in standard deviations of their noise, over all samples.

With smaller steps the integrator's error dominates; with larger ones the readings do not change linearly. A tenth of
this step changes the bound by 0.01 %, a step ten times as large by up to 1 %.
"""


class Information(NamedTuple):
    """Information of B windows about P unknowns, by length of the window and by sensor, for scaled unknowns.

    An unknown is scaled by the standard deviation of its prior (of its logarithm, for a logarithmic prior).
    """

    names: tuple[str, ...]  # of the unknowns
    matrix: Floats  # (B, lengths, channels, P, P), of the readings from the start to that length
    unit: Floats  # (B, P), change of each unknown, in its unit, per scaled one


def information(
    config: TaskConfig,
    windows: KnownWindows,
    priors: Mapping[str, Prior],
    lengths: Sequence[float] | None = None,
    threads: int | None = None,
) -> Information:
    """Information of the readings of known windows about the unknowns, without the priors.

    Args:
        config: the task.
        windows: the windows; their commands are replayed on the true plants.
        priors: the unknowns, as :func:`hydro_rig.estimation.unknowns.priors_of` gives them.
        lengths: of the windows, from their start, s; ``None``: the whole windows.
        threads: worker threads; ``None`` takes one per core.

    Raises:
        ConfigurationError: a length is not above 0, or longer than the windows.
    """
    period, samples = config.control_period, windows.signals.shape[2]
    whole = (samples - 1) * period
    given = tuple(sorted(lengths)) if lengths is not None else (whole,)
    for length in given:
        if not period <= length <= whole * (1.0 + 1e-9):
            raise ConfigurationError(f"window = {length:g} s: must be within {period:g} to {whole:g} s")
    ends = [round(length / period) + 1 for length in given]
    model, scaled = true_model(config, windows, priors, threads)
    used = np.isfinite(usable_readings(windows.signals, config, model))
    jacobian = np.where(used[:, None], jacobian_at(model, scaled), 0.0)[:, :, :, : ends[-1]]
    pieces = np.split(jacobian, ends[:-1], axis=3)
    steps = [np.einsum("bpct,bqct->bcpq", piece, piece, optimize=True) for piece in pieces]
    return Information(tuple(priors), np.cumsum(np.stack(steps, axis=1), axis=1), model.derivative(scaled))


def true_model(
    config: TaskConfig, windows: KnownWindows, priors: Mapping[str, Prior], threads: int | None = None
) -> tuple[Model, Floats]:
    """The model of known windows with a strict integrator, and the true scaled unknowns (B, P)."""
    strict = task_config(config, tolerance=min(config.tolerance, TOLERANCE))
    model = Model(strict, priors, windows.signals[:, -1], windows.physical, windows.start, threads)
    return model, model.scaled(np.stack([windows.value(name) for name in priors], axis=1))


def jacobian_at(model: Model, scaled: Floats) -> Floats:
    """Derivatives of the readings over their noise, (B, P, channels, T), by central differences.

    A first, coarse derivative gives the steps: each changes the readings by about :data:`RESPONSE`.
    """
    coarse = model.linearise(scaled)[1][:, model.simulated]
    steps = np.clip(RESPONSE / np.sqrt(1.0 + (coarse**2).sum(axis=(2, 3))), 1e-7, 0.1)
    directions = steps[:, :, None] * np.eye(len(model.simulated))
    above, below = (model.linearise(scaled, sign * directions)[1] for sign in (1.0, -1.0))
    return 0.5 * (above + below)


def sigma(
    known: Information,
    name: str = LEAKAGE,
    unknowns: Sequence[str] | None = None,
    sensors: Sequence[str] = SENSORS,
) -> Floats:
    """The bound of one unknown: its smallest standard deviation, (B, lengths), in its unit.

    Args:
        known: information of the readings.
        name: of the unknown.
        unknowns: names of all unknowns, the others are known exactly; ``None``: all.
        sensors: available sensors.

    Raises:
        ConfigurationError: an unknown or a sensor is not in ``known``.
    """
    names = known.names if unknowns is None else tuple(unknowns)
    for what, choice, allowed in (("unknowns", names, known.names), ("sensors", sensors, SENSORS)):
        for one in choice:
            if one not in allowed:
                raise ConfigurationError(f"{what}: '{one}': {one_of(one, allowed)}")
    places = [known.names.index(one) for one in names]
    rows = [SENSORS.index(sensor) for sensor in sensors]
    matrix = known.matrix[:, :, rows].sum(axis=2)[..., places, :][..., places]
    matrix = matrix + np.eye(len(names))  # the priors
    # The unknowns have very different information; scaling each by its own keeps the inverse accurate.
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("...ii->...i", matrix), 1e-300))
    inverse = np.linalg.inv(matrix * scale[..., :, None] * scale[..., None, :])
    place = names.index(name)
    unit = (known.unit[:, None, places] * scale)[..., place]
    result: Floats = np.sqrt(inverse[..., place, place] * unit * unit)
    return result


def leak_bound(protocol: LeakProtocol, chosen: object) -> Iterator[Cell]:
    """The part ``leak_bound``: the bound of some windows of the conditions that a protocol names."""
    del chosen
    for name in protocol.bound_conditions:
        condition, config = protocol.conditions[name], protocol.task_in(name)
        begin = 0.0 if condition.begins == "at rest" else condition.duration
        times = (begin, condition.duration - config.control_period)
        for level in protocol.levels_in(name):
            if level >= 0.0:
                cases = protocol.cases_in(name, level, protocol.bound_windows)
                arguments = (config, protocol.known_task(name), condition.acting, *times, cases)
                job = Job(bound_of_windows, None, arguments, digest="bound")
                yield Cell("bound", name, {"condition": name, "level": level}, (job,))


def bound_of_windows(
    _: None, config: TaskConfig, known: TaskConfig, acting: str, begin: float, duration: float, cases: Cases
) -> Columns:
    """Smallest standard deviation of the leak, l/min at 100 bar; all quantities that the task draws are unknown.

    Args:
        config: task of the runs.
        known: task that the priors follow from.
        acting: controller of the axes.
        begin: of the windows, s.
        duration: of the windows, s.
        cases: of the runs.

    Raises:
        ConfigurationError: the bound cannot be computed.
    """
    controller = ACTING[acting].make(config, len(cases), int(cases.seeds[0]))
    windows = known_windows(config, controller, cases, begin, duration)
    found = np.full(len(cases), np.nan)
    found[windows.case] = sigma(information(config, windows, priors_of(known), threads=1))[:, -1]
    return {"seed": cases.seeds.astype(np.float64), "sigma_lpm": found}
