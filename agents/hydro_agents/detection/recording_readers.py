"""The two detectors on the windows of a recording: the leakage head, and the estimator with the simulator as model.

The unknowns of the estimator are the parameters that the task draws and those that change by wear: the valve's null
shift, its edges, its flow and the return line. Without the latter the model would read a leak on an axis with a worn
valve.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.features import LABELS
from hydro_agents.detection.head import LeakageHead
from hydro_agents.estimation.estimate import Estimate, estimate
from hydro_agents.estimation.unknowns import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    LEAKAGE,
    Prior,
    default_unknowns,
)
from hydro_agents.rigs.diagnosis_windows import Windows
from hydro_agents.rigs.verdict import HALF_WIDTH, NO_COMMANDS, Reading
from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.task.randomisation import own_value
from hydro_env.units import LITRE_PER_MINUTE, flow_from_resistance

Floats = NDArray[np.float64]
Progress = Callable[[int], None]

SURE = 3.0
"""Distance of an estimate from its healthy range that names a fault, in standard deviations."""

WIDE_BIAS = 3.0
"""Standard deviation of a sensor's offset, relative to the largest offset of the data sheet."""

DETERMINED = 0.05
"""Largest standard deviation of a valid reading, in l/min at 100 bar, or as a share of the leak."""


HEAD_FAULTS = {
    "external_leak": "external leak past the rod seal",
    "valve_fault": "fault of the valve",
    "sensor_fault": "fault of a sensor",
    "return_line": "raised pressure in the return line",
}
"""Names of the faults that the leakage head distinguishes from a leak past the piston."""


def read_head(windows: Windows, head: LeakageHead) -> Reading:
    """Readings of the leakage head; it needs all commands, and is not valid for windows unlike its training."""
    count, chosen = len(windows.begin), np.flatnonzero(windows.commanded)
    leak, low, high = (np.full(count, np.nan) for _ in range(3))
    holds, misfits = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    fault, why = np.full(count, "", dtype=object), np.full(count, NO_COMMANDS, dtype=object)
    if len(chosen):
        found = head.estimate_windows(windows.signals[chosen])
        leak[chosen], low[chosen], high[chosen] = found.flow_lpm, found.low_lpm, found.high_lpm
        misfits[chosen] = found.outside > 0.0
        holds[chosen] = ~misfits[chosen] & np.isfinite(found.flow_lpm)
        why[chosen] = np.where(holds[chosen], "", OUTSIDE)
        limits = dict(zip(LABELS, head.tensors["thresholds"], strict=True))
        shown = {name: getattr(found, name) > limits[name] for name in HEAD_FAULTS}
        fault[chosen] = [
            " and ".join(words for name, words in HEAD_FAULTS.items() if shown[name][place])
            for place in range(len(chosen))
        ]
    return Reading(leak, low, high, holds, tuple(fault.tolist()), tuple(why.tolist()), misfits)


def head_misfit(head: LeakageHead, config: TaskConfig, windows: Windows) -> str:
    """Why a head cannot read these windows; empty if it can."""
    task = head.settings.task
    if task.plant != config.plant:
        return "The leakage head was trained for another rig."
    if task.control_period != config.control_period:
        return f"The leakage head was trained for a control period of {1e3 * task.control_period:g} ms."
    if windows.signals.shape[2] < head.settings.window:
        return f"The leakage head reads windows of at least {head.settings.window * task.control_period:g} s."
    return ""


def wear_priors(config: TaskConfig) -> dict[str, Prior]:
    """Priors of the parameters that wear or drift, wide enough for the faults of :mod:`hydro_env.task.faults`."""
    valve = config.plant.valve
    wide = {
        "valve.null_shift": Prior(valve.null_shift, 0.01),
        "valve.underlap": Prior(max(valve.underlap, 1e-3), 0.6, True),
        "valve.rated_flow": Prior(valve.rated_flow, 0.2, True),
        "supply.tank_pressure": Prior(config.plant.supply.tank_pressure, 3e5),
        EXTERNAL_LEAKAGE: Prior(0.0, 1.0),
    }
    for channel in ("pressure_a", "pressure_b", "spool_position"):
        wide[f"{channel}_bias"] = Prior(0.0, WIDE_BIAS * getattr(config.sensors, channel).bias)
    return {name: prior for name, prior in wide.items() if prior.deviation > 0.0}


def unknowns_of(config: TaskConfig) -> tuple[str, ...]:
    """Names of all unknowns: parameters that an episode draws, initial state, and wear."""
    drawn = default_unknowns(config)
    return (*drawn, *(name for name in wear_priors(config) if name not in drawn))


def read_estimator(windows: Windows, config: TaskConfig, progress: Progress | None = None) -> Reading:
    """Readings of the estimator; it needs all commands, and any sensor may be absent.

    Windows without signs of wear are fitted again without it: the simpler model gives the leak more precisely.

    Args:
        windows: of the recording.
        config: the task.
        progress: called with the number of finished fits, at most two per window with commands.
    """
    count = len(windows.begin)
    leak, low, high = (np.full(count, np.nan) for _ in range(3))
    holds, misfits = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    fault, why = np.full(count, "", dtype=object), np.full(count, NO_COMMANDS, dtype=object)
    chosen = np.flatnonzero(windows.commanded)
    if len(chosen):
        signals = windows.signals[chosen]
        worn = estimate(signals, config, unknowns_of(config), priors=wear_priors(config), progress=progress)
        faults = [_faults(worn, place, config) for place in range(len(chosen))]
        value, deviation = worn.value(LEAKAGE).copy(), worn.deviation(LEAKAGE).copy()
        simple = np.flatnonzero(worn.holds & np.array([not names for names in faults]))
        if len(simple):
            plain = estimate(
                signals[simple],
                config,
                progress=None if progress is None else lambda done: progress(len(chosen) + done),
            )
            better = simple[plain.holds]
            value[better], deviation[better] = (
                plain.value(LEAKAGE)[plain.holds],
                plain.deviation(LEAKAGE)[plain.holds],
            )
        fits = worn.holds & (value + SURE * deviation >= 0.0)  # a negative leak: the model is wrong
        known = deviation <= np.maximum(DETERMINED, DETERMINED * value)
        leak[chosen], low[chosen], high[chosen] = value, value - HALF_WIDTH * deviation, value + HALF_WIDTH * deviation
        misfits[chosen], holds[chosen] = ~fits, fits & known
        why[chosen] = np.where(~fits, MISFIT, np.where(known, "", UNDETERMINED))
        fault[chosen] = _in_words(worn, faults)
    return Reading(leak, low, high, holds, tuple(fault.tolist()), tuple(why.tolist()), misfits)


MISFIT = "the model does not explain the readings"
OUTSIDE = "unlike all that the leakage head was trained on"
UNDETERMINED = "the window does not determine the leak; more motion is needed"


class Shown(NamedTuple):
    """Name and unit of an unknown for a reader."""

    what: str
    factor: float  # displayed units per unit of the unknown
    unit: str


NAMED_FAULTS: dict[str, Shown] = {
    "valve.null_shift": Shown("null shift of the valve", 100.0, "% of full stroke"),
    "valve.underlap": Shown("worn edges of the valve, underlap", 100.0, "%"),
    "valve.rated_flow": Shown("rated flow of the valve", 1.0 / LITRE_PER_MINUTE, "l/min"),
    "supply.tank_pressure": Shown("pressure in the return line", 1e-5, "bar"),
    EXTERNAL_LEAKAGE: Shown("external leak past the rod seal", 1.0, "l/min at 100 bar"),
    "pressure_a_bias": Shown("offset of the pressure sensor of chamber a", 1e-5, "bar"),
    "pressure_b_bias": Shown("offset of the pressure sensor of chamber b", 1e-5, "bar"),
    "spool_position_bias": Shown("offset of the spool sensor", 100.0, "% of full stroke"),
}
"""Unknowns that name a fault. An offset of the position is no fault: its zero is arbitrary."""

LARGEST_NULL_SHIFT, LARGEST_BACK_PRESSURE, LARGEST_BIAS = 0.004, 1.5e5, 2.0
"""Limits of a healthy axis: null shift as a fraction of full stroke, return pressure above the data sheet's in Pa, and
offset of a sensor relative to its data sheet."""


def healthy_range(config: TaskConfig, name: str) -> tuple[float, float]:
    """Lowest and highest value of an unknown on an axis without a fault, from the ranges of the task."""
    if name == "valve.null_shift":
        middle, reach = config.plant.valve.null_shift, LARGEST_NULL_SHIFT
    elif name == "supply.tank_pressure":
        middle, reach = config.plant.supply.tank_pressure, LARGEST_BACK_PRESSURE
    elif name in BIASES:
        middle, reach = 0.0, LARGEST_BIAS * getattr(config.sensors, name.removesuffix("_bias")).bias
    else:
        path = EXTERNAL_RESISTANCE if name == EXTERNAL_LEAKAGE else name
        own = own_value(config.plant, path)
        bounds = config.randomisation[path].bounds(own) if path in config.randomisation else (own, own)
        if name != EXTERNAL_LEAKAGE:
            return bounds
        middle, reach = 0.0, flow_from_resistance(min(bounds))
    return middle - reach, middle + reach


def _faults(found: Estimate, window: int, config: TaskConfig) -> list[str]:
    """Names of the unknowns that lie significantly outside their healthy range."""
    faults = []
    for name in NAMED_FAULTS:
        if name in found.names:
            value, sigma = found.value(name)[window], found.deviation(name)[window]
            low, high = healthy_range(config, name)
            if max(low - value, value - high) > SURE * sigma:
                faults.append(name)
    return faults


def _in_words(found: Estimate, faults: list[list[str]]) -> list[str]:
    """The faults of each window as text; the size of a fault is the median over all windows that show it."""
    words = {}
    for name, shown in NAMED_FAULTS.items():
        rows = [row for row, names in enumerate(faults) if name in names]
        if rows:
            size = shown.factor * float(np.median(found.value(name)[rows]))
            words[name] = f"{shown.what} ({number(size)} {shown.unit})"
    return [" and ".join(words[name] for name in names) for names in faults]
