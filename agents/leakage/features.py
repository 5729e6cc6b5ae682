"""What the leakage head reads from a window of measured signals: the flow balance, and plain statistics of motion."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.leakage.balance import PARTS, fit_balance
from agents.leakage.sheet import Sheet, Unknowns
from agents.leakage.stuck import run_lengths
from hydro_env.plant.equations import Coefficients

SIGNALS = ("position", "pressure_a", "pressure_b", "spool_position", "previous_command")
"""Measured signals that the head reads, in this order."""

SENSORS = SIGNALS[:4]

LABELS = ("internal_leak", "external_leak", "valve_fault", "sensor_fault", "return_line")
"""What the head tells from each other. An axis may have several at once, so each has a probability of its own."""

LONGEST_GAP = 5
"""Samples; a reading that stays at the lower end of its range for longer is believed."""

FAR_FROM_END = np.array([0.05, 0.05, 0.05, 0.3])[:, None]
"""Part of its range by which a sensor does not fall within one period: a reading that does is a lost sample."""

LAST_PARTS = 3
"""Parts of the window before its end whose own leak is a feature; it tells the size of a leak that grows."""

STILL_COMMAND = 2e-3
"""Change of the command within one period below which the spool ought to stand where it is told."""

FEATURES = (
    *(f"fitted {name}" for name in Unknowns._fields),
    *(f"deviation of {name}" for name in Unknowns._fields),
    "misfit of travel",
    "misfit of flows",
    "small internal leak",
    "small external leak",
    "internal leak over deviation",
    "external leak over deviation",
    "mean spool error",
    "spread of spool error",
    "spool error over position",
    "spool error against direction",
    "spool error at rest",
    "mean pressure a",
    "mean pressure b",
    "mean pressure difference",
    "mean size of pressure difference",
    "spread of pressure a",
    "spread of pressure b",
    "change of pressure a",
    "change of pressure b",
    "mean spool",
    "mean size of spool",
    "spread of spool",
    "change of spool",
    "change of command",
    "share of full command",
    "mean position",
    "spread of position",
    "change of position",
    "spring",
    "force offset",
    "friction",
    "misfit of force",
    *(f"lost samples of {name}" for name in SENSORS),
    *(f"change of leak in part {part + 1}" for part in range(PARTS)),
    *(f"leak in part {part + 1}" for part in range(PARTS - LAST_PARTS, PARTS)),
    "deviation of leak in last part",
    "change of leak",
    "duration",
)
"""Names of the features."""

SPREAD = FEATURES.index("spread of position")
STILL = np.log10(3e-4)
"""Value of this feature below which the axis stands still."""

CHANGE = FEATURES.index("change of leak")
"""The feature by which windows with a constant leak and with a changing one are told apart."""


class Repaired(NamedTuple):
    """Signals without gaps."""

    signals: NDArray[np.float64]  # (N, 5, T), lost samples replaced by the reading before
    lost: NDArray[np.float64]  # (N, 4), share of lost samples of each sensor


def repaired(signals: NDArray[Any], sheet: Sheet) -> Repaired:
    """Fill lost samples: NaN, and short falls to the lower end of a sensor's range."""
    filled = np.array(signals, dtype=np.float64)
    lost = np.isnan(filled)
    low, high = sheet.sensor_low[:, None], sheet.sensor_high[:, None]
    at_end = filled[:, :4] <= low + 1e-9 * (high - low)
    if at_end.any():
        before = np.concatenate([filled[:, :4, :1], filled[:, :4, :-1]], axis=2)
        fallen = at_end & (np.roll(at_end, 1, axis=2) | (before > low + FAR_FROM_END * (high - low)))
        short = at_end & ~_held_for(at_end, LONGEST_GAP + 1)
        lost[:, :4] |= fallen & short
    if lost.any():
        places = np.where(lost, 0, np.arange(filled.shape[2]))
        first = np.argmin(lost, axis=2)  # gaps at the start take the first reading
        places = np.maximum(np.maximum.accumulate(places, axis=2), first[:, :, None])
        filled = np.nan_to_num(np.take_along_axis(filled, places, axis=2))
    return Repaired(filled, lost[:, :4].mean(axis=2))


def _held_for(mask: NDArray[np.bool_], samples: int) -> NDArray[np.bool_]:
    """True where a run of true values is at least so long."""
    lengths = run_lengths(mask)
    backwards = run_lengths(mask[:, :, ::-1])[:, :, ::-1]
    longer: NDArray[np.bool_] = mask & (lengths + backwards - 1 >= samples)
    return longer


def _logarithm(values: NDArray[np.float64], floor: float) -> NDArray[np.float64]:
    result: NDArray[np.float64] = np.log10(np.abs(values) + floor)
    return result


def _spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
    result: NDArray[np.float64] = np.sqrt(np.maximum(np.mean(values**2, axis=1) - np.mean(values, axis=1) ** 2, 0.0))
    return result


def _change(values: NDArray[np.float64]) -> NDArray[np.float64]:
    result: NDArray[np.float64] = np.sqrt(np.mean(np.diff(values, axis=1) ** 2, axis=1))
    return result


def features_of(signals: NDArray[Any], sheet: Sheet) -> NDArray[np.float32]:
    """:data:`FEATURES` of windows, (N, F).

    Args:
        signals: SIGNALS (N, 5, T) in SI units; NaN where a sample is lost or a sensor absent.
        sheet: data sheet of the axis.
    """
    whole = repaired(signals, sheet)
    x, p_a, p_b, spool, command = whole.signals.transpose(1, 0, 2)
    fitted = fit_balance(whole.signals, sheet)
    estimate, deviation, error = fitted.estimate, fitted.deviation, fitted.spool_error
    c = Coefficients(*sheet.coefficients.tolist())
    stroke, pressure = 2.0 * c.end_stop_position, sheet.mean[Unknowns._fields.index("supply_pressure")]
    leaks = [Unknowns._fields.index(f"{name}_leak") for name in ("internal", "external")]
    told, direction = spool - error, np.sign(np.diff(command, axis=1, prepend=command[:, :1]))
    still = np.abs(np.diff(command, axis=1, prepend=command[:, :1])) < STILL_COMMAND
    part_weight = fitted.part_deviation**-2.0
    mean_leak = np.sum(part_weight * fitted.part_leak, axis=1) / part_weight.sum(axis=1)
    part_change = (fitted.part_leak - mean_leak[:, None]) / fitted.part_deviation
    load = _load_fit(x, p_a * c.area_a - p_b * c.area_b, sheet.period, stroke, pressure * c.area_a)
    columns = [
        *np.arcsinh(10.0 * (estimate - sheet.mean) / sheet.spread).T,
        *np.log10(deviation / sheet.spread + 1e-6).T,
        *_logarithm(fitted.misfit, 1e-2).T,
        *np.arcsinh(estimate[:, leaks] / 0.02).T,
        *np.arcsinh(estimate[:, leaks] / deviation[:, leaks]).T,
        np.arcsinh(error.mean(axis=1) / 2e-3),
        _logarithm(_spread(error), 1e-4),
        np.arcsinh(
            20.0 * np.mean(error * (told - told.mean(axis=1, keepdims=True)), axis=1) / (told.var(axis=1) + 1e-6)
        ),
        np.arcsinh(np.mean(error * direction, axis=1) / 1e-3),
        _logarithm(np.sum(np.abs(error) * still, axis=1) / (still.sum(axis=1) + 1), 1e-4),
        p_a.mean(axis=1) / pressure,
        p_b.mean(axis=1) / pressure,
        (p_a - p_b).mean(axis=1) / pressure,
        np.abs(p_a - p_b).mean(axis=1) / pressure,
        _logarithm(_spread(p_a) / pressure, 1e-4),
        _logarithm(_spread(p_b) / pressure, 1e-4),
        _logarithm(_change(p_a) / pressure, 1e-5),
        _logarithm(_change(p_b) / pressure, 1e-5),
        np.arcsinh(20.0 * spool.mean(axis=1)),
        _logarithm(np.abs(spool).mean(axis=1), 1e-4),
        _logarithm(_spread(spool), 1e-4),
        _logarithm(_change(spool), 1e-5),
        _logarithm(_change(command), 1e-5),
        (np.abs(command) > 0.999).mean(axis=1),
        x.mean(axis=1) / stroke,
        _logarithm(_spread(x) / stroke, 1e-5),
        _logarithm(_change(x) / stroke, 1e-6),
        *load.T,
        *np.log10(whole.lost + 1e-3).T,
        *np.arcsinh(part_change).T,
        *np.arcsinh(fitted.part_leak[:, -LAST_PARTS:] / 0.1).T,
        _logarithm(fitted.part_deviation[:, -1], 1e-4),
        _logarithm(np.mean(part_change**2, axis=1), 1e-2),
        np.full(len(x), np.log10(x.shape[1] * sheet.period)),
    ]
    values: NDArray[np.float32] = np.nan_to_num(np.stack(columns, axis=1), posinf=0.0, neginf=0.0).astype(np.float32)
    return values


def _load_fit(
    x: NDArray[np.float64], force: NDArray[np.float64], period: float, stroke: float, scale: float
) -> NDArray[np.float64]:
    """Spring, offset, friction and misfit (N, 4) of the oil's force over position and speed, in ``scale``."""
    place = x / (0.5 * stroke)
    speed = np.zeros_like(x)
    speed[:, 2:-2] = (x[:, 4:] - x[:, :-4]) / (4.0 * period)
    rows = np.stack([np.ones_like(x), place, speed / stroke, np.tanh(speed / (5e-3 * stroke))], axis=1)
    normal = rows @ rows.transpose(0, 2, 1) + 1e-3 * x.shape[1] * np.eye(4)
    solution = np.linalg.solve(normal, rows @ (force / scale)[:, :, None])
    left = force / scale - (solution.transpose(0, 2, 1) @ rows)[:, 0]
    values: NDArray[np.float64] = np.column_stack(
        [solution[:, 1, 0], solution[:, 0, 0], 10.0 * solution[:, 3, 0], _logarithm(_spread(left), 1e-4)]
    )
    return values
