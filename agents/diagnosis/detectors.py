"""The two detectors on the windows of a recording: the leakage head, and the estimator with the simulator as model.

The estimator takes as unknown what the task draws and, besides, what wears: the valve's null shift, its edges, its flow
and the return line. The model without these is wrong for a worn valve and would read a leak that is none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.diagnosis.verdict import HALF_WIDTH, Reading
from agents.diagnosis.windows import Windows
from agents.estimation.estimate import Estimate, estimate
from agents.estimation.names import BIASES, EXTERNAL_LEAKAGE, EXTERNAL_RESISTANCE, LEAKAGE
from agents.estimation.priors import Prior
from agents.estimation.unknowns import default_unknowns
from agents.leakage.features import LABELS
from agents.leakage.head import LeakageHead
from agents.report.text import number
from hydro_env import TaskConfig
from hydro_env.task.randomisation import own_value
from hydro_env.units import LITRE_PER_MINUTE, flow_from_resistance

Floats = NDArray[np.float64]
Progress = Callable[[int], None]

SURE = 3.0
"""Standard deviations by which an estimate must lie beyond its healthy range to name a fault."""

WIDE_BIAS = 3.0
"""Standard deviation of a sensor's offset, in parts of the largest one of its data sheet."""

DETERMINED = 0.05
"""Largest standard deviation in l/min at 100 bar, or share of the leak, of a reading that counts."""


HEAD_FAULTS = {
    "external_leak": "external leak past the rod seal",
    "valve_fault": "fault of the valve",
    "sensor_fault": "fault of a sensor",
    "return_line": "raised pressure in the return line",
}
"""Faults that the leakage head tells from a leak past the piston, in words."""


def read_head(windows: Windows, head: LeakageHead) -> Reading:
    """Readings of the leakage head; it needs all commands, and does not count where it has seen nothing alike."""
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
    """Priors of what wears or drifts: wide enough for the faults of :mod:`hydro_env.task.faults`."""
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
    """Names of all unknowns: what an episode draws, the start, and what wears."""
    drawn = default_unknowns(config)
    return (*drawn, *(name for name in wear_priors(config) if name not in drawn))


def read_estimator(windows: Windows, config: TaskConfig, progress: Progress | None = None) -> Reading:
    """Readings of the estimator; it needs all commands, and any sensor may be absent.

    Windows that show no wear are fitted again without it: the simpler model knows the leak better.

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


NO_COMMANDS = "commands are missing in the window"
MISFIT = "the model does not explain the readings"
OUTSIDE = "unlike all that the leakage head was trained on"
UNDETERMINED = "the window does not determine the leak; more motion is needed"


class Shown(NamedTuple):
    """How a person reads an unknown that names a fault."""

    what: str
    factor: float  # units of a person per unit of the unknown
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
"""Unknowns that name a fault. An offset of the position is none: its zero is a matter of agreement."""

LARGEST_NULL_SHIFT, LARGEST_BACK_PRESSURE, LARGEST_BIAS = 0.004, 1.5e5, 2.0
"""Of a healthy axis: null shift in parts of full stroke, Pa in the return line beyond the data sheet's, and offset of a
sensor in parts of that of its data sheet."""


def healthy_range(config: TaskConfig, name: str) -> tuple[float, float]:
    """Lowest and highest value of an unknown on an axis without a fault: those that the task draws."""
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
    """Names of the unknowns that surely lie beyond their healthy range."""
    faults = []
    for name in NAMED_FAULTS:
        if name in found.names:
            value, sigma = found.value(name)[window], found.deviation(name)[window]
            low, high = healthy_range(config, name)
            if max(low - value, value - high) > SURE * sigma:
                faults.append(name)
    return faults


def _in_words(found: Estimate, faults: list[list[str]]) -> list[str]:
    """The faults of each window in words; a fault has its median size of all windows that show it."""
    words = {}
    for name, shown in NAMED_FAULTS.items():
        rows = [row for row, names in enumerate(faults) if name in names]
        if rows:
            size = shown.factor * float(np.median(found.value(name)[rows]))
            words[name] = f"{shown.what} ({number(size)} {shown.unit})"
    return [" and ".join(words[name] for name in names) for names in faults]
