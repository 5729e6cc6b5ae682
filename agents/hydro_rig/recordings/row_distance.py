"""The distance of the rows of a recording: what their time stamps say, and whether it fits the control period."""

from __future__ import annotations

import numpy as np

from hydro_env.types import Floats
from hydro_rig.recordings.columns import UNITS
from hydro_rig.recordings.findings import Finding, Weight

LARGEST_DEVIATION = 0.02
"""Largest relative deviation of the row distance from a whole fraction of the control period; clocks differ less."""

ROWS_TOGETHER = 20
SHORTEST_DISTANCE = 1e-7  # s between two rows; no rig logs faster, so the unit of the stamps is wrong
PARTS = 8  # of a recording, over each of which the stamps are compared: one jump of the clock touches few of them
COMMON = (0.2, 0.8)  # quantiles of these comparisons that count

Spacing = tuple[float, float]  # least and largest distance of rows that lie at equal distances, s


def spacing_of(stamps: Floats) -> Spacing | None:
    """The distances of equidistant rows that their stamps (n,) allow, s; NaN is a missing stamp.

    Stamps may be rounded, come late, jump, or run backward. A rounded stamp tells its time in the row in which it is
    new, and there to one row. ``None``: they tell nothing.
    """
    row = np.flatnonzero(np.isfinite(stamps))
    known = stamps[row]
    steps = np.diff(known)
    new = np.flatnonzero(steps) + 1
    if len(new) < 2:
        return None
    rounded = len(new) < len(steps)
    lag = max(len(new) // PARTS, 1)
    span, rows = (values[new[lag:]] - values[new[:-lag]] for values in (known, row))
    low = float(np.quantile(span / (rows + rounded), COMMON[0]))
    high = float(np.quantile(span / np.maximum(rows - rounded, 1), COMMON[1]))
    if not rounded:  # lost rows make the way of many rows longer, but not their usual step
        usual = float(np.median(steps / np.diff(row)))
        low, high = min(low, usual), max(high, usual)
    return (low, high) if low > SHORTEST_DISTANCE else None


def equidistant(spacing: Spacing, period: float) -> tuple[float, Finding]:
    """The distance of equidistant rows in s, and a finding about it; severe where the stamps leave it open.

    It is the only whole fraction of the control period that ``spacing`` allows, or what a narrow one says by itself.
    """
    low, high = spacing
    fractions = np.arange(np.ceil(period / high * (1.0 - 1e-9)), np.floor(period / low * (1.0 + 1e-9)) + 1.0)
    distance = 0.5 * (low + high)
    if len(fractions) == 1 and fractions[0] >= 1.0:
        distance = period / float(fractions[0])
    elif len(fractions) > 1 or high > (1.0 + 2.0 * LARGEST_DEVIATION) * low:
        what = f"has stamps that leave {1e3 * low:.3g} to {1e3 * high:.3g} ms for the distance of equidistant rows; "
        what += f"give it in the map, as in 'equidistant: {1e3 * period:g} ms'"
        return distance, Finding("time", what, Weight.SEVERE)
    what = f"is taken as equidistant, one row every {1e3 * distance:.4g} ms, as the map says"
    return distance, Finding("time", what, Weight.NOTE)


def row_distance(time: Floats, period: float) -> float:
    """Usual distance of two rows in s: the median, or that over many rows if only this fits the period."""
    distance = float(np.median(np.diff(time)))
    many = min(ROWS_TOGETHER, len(time) - 1)
    together = float(np.median(time[many:] - time[:-many])) / many
    return distance if whole_fraction(distance, period) or not whole_fraction(together, period) else together


def whole_fraction(distance: float, period: float) -> int:
    """Rows per control period; 0 if the row distance is not a whole fraction of it."""
    rows = round(period / max(distance, SHORTEST_DISTANCE))
    return rows if rows >= 1 and abs(distance * rows / period - 1.0) <= LARGEST_DEVIATION else 0


def other_sampling(distance: float, period: float, unit: str) -> Finding:
    """The finding that the row distance does not fit the control period, with a unit of time that would fit."""
    units = UNITS["time"]
    rows = {name: whole_fraction(distance * units[name] / units[unit], period) for name in units}
    fitting = [name for name in units if 1 <= rows[name] <= 100]
    what = f"has one row every {1e3 * distance:.4g} ms, but the rig's control period is {1e3 * period:g} ms"
    if fitting:
        what += f"; stamps in {min(fitting, key=rows.__getitem__)} instead of {unit} would fit"
    else:
        what += ": the commands between the rows are unknown; record faster, or give the --task of this rig"
    return Finding("time", what, Weight.SEVERE)
