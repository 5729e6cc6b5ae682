"""Tables and figures of the bounds: the best found, and the bound of a leak."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from hydro_agents.report.canvas import WIDE, render, row_axis, ticks
from hydro_agents.report.palette import COLOURS, looks_of
from hydro_agents.running.text import frame_markdown, number, setting
from hydro_rig.estimation.information import TASK
from hydro_rig.estimation.known_windows import MOTIONS
from hydro_rig.estimation.leak_bound import ALL_SENSORS

ORDINARY = next(iter(MOTIONS))


def middle(values: Iterable[float], wanted: float) -> float:
    """The value with the ratio to ``wanted`` closest to 1."""
    return min(values, key=lambda value: abs(np.log(max(value, 1e-9) / wanted)))


def shown(table: pd.DataFrame) -> tuple[float, float]:
    """Fixed window (s) and leak (l/min) of the tables: the values nearest to 2 s and 0.3 l/min."""
    return middle(table["window_s"].unique(), 2.0), middle(table["leakage_flow_lpm"].unique(), 0.3)


def tables(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Tables of medians over the plants by title; cells are text, the bound in l/min at 100 bar."""
    length, leak = shown(table)
    ordinary, whole = table["motion"] == ORDINARY, table["sensors"] == ALL_SENSORS
    window, level, drawn = table["window_s"] == length, table["leakage_flow_lpm"] == leak, table["unknowns"] == TASK
    seconds, litres = f"window of {length:g} s", f"leak of {leak:g} l/min"
    by_leak = _medians(table[ordinary & whole & window], "leakage_flow_lpm", "unknowns", "leak, l/min")
    by_length = _medians(table[ordinary & whole & level], "window_s", "unknowns", "window, s")
    by_sensor = _medians(table[ordinary & drawn & window], "sensors", "leakage_flow_lpm", "sensors")
    by_motion = table[whole & drawn & window].pivot_table(
        "sigma_lpm", "leakage_flow_lpm", "motion", aggfunc=_spread, sort=False
    )
    by_motion.index = pd.Index([setting(leak) for leak in by_motion.index], name="leak, l/min")
    return {
        f"By leak and unknowns ({ORDINARY}, {seconds})": by_leak,
        f"By length of the window and unknowns ({ORDINARY}, {litres})": by_length,
        f"By sensors and leak ({ORDINARY}, {seconds}; unknown: {TASK})": by_sensor,
        f"By motion and leak: median, and 10 to 90 % of the plants ({seconds}; unknown: {TASK})": by_motion,
    }


def _medians(rows: pd.DataFrame, index: str, columns: str, name: str) -> pd.DataFrame:
    table = rows.pivot_table("sigma_lpm", index, columns, aggfunc="median", sort=False).map(_digits)
    table.index = pd.Index([setting(v) if isinstance(v, float) else str(v) for v in table.index], name=name)
    table.columns = pd.Index([setting(v) if isinstance(v, float) else str(v) for v in table.columns])
    return table


def _digits(value: float) -> str:
    return number(value, digits=2)


def _spread(values: pd.Series[float]) -> str:
    low, median, high = np.quantile(values, [0.1, 0.5, 0.9])
    return f"{_digits(median)} ({_digits(low)} to {_digits(high)})"


def bound_markdown(table: pd.DataFrame) -> str:
    """All tables of :func:`tables` as Markdown."""
    return "\n\n".join(f"{title}:\n\n{frame_markdown(part)}" for title, part in tables(table).items())


# Figures ------------------------------------------------------------------------------------------------------------


def bound_picture(table: pd.DataFrame) -> bytes:
    """A PNG: the bound over the length of the window for each set of unknowns, by sensors, and over the leak."""
    length, leak = shown(table)
    ordinary, whole = table["motion"] == ORDINARY, table["sensors"] == ALL_SENSORS
    window, level, drawn = table["window_s"] == length, table["leakage_flow_lpm"] == leak, table["unknowns"] == TASK

    def paint(figure: Figure) -> None:
        left, centre, right = figure.subplots(1, 3, width_ratios=(1.0, 0.9, 1.0))
        _lines(left, table[ordinary & whole & level], "window_s", "unknowns")
        left.set(xscale="log", xlabel="window, s", title=f"Sets of unknowns (leak of {leak:g} l/min)")
        ticks(left.xaxis, sorted(table["window_s"].unique()))
        _rows_of_sensors(centre, table[ordinary & drawn & window & level])
        centre.set_title(f"Sensors, {length:g} s")
        positive = table["leakage_flow_lpm"] > 0.0  # the axis is logarithmic
        _lines(right, table[whole & drawn & window & positive], "leakage_flow_lpm", "motion")
        right.set(xscale="log", xlabel="leak, l/min at 100 bar", title=f"Motion, {length:g} s")
        ticks(right.xaxis, sorted(table.loc[positive, "leakage_flow_lpm"].unique()))

    return render(paint, (1.5 * WIDE, 4.2), "png")[0]


def _lines(axes: Axes, rows: pd.DataFrame, across: str, by: str) -> None:
    medians = rows.pivot_table("sigma_lpm", across, by, aggfunc="median", sort=False).sort_index()
    for name, look in looks_of(medians.columns).items():
        axes.plot(medians.index, medians[name], marker=look.marker, label=name, **look.stroke)
    axes.set(yscale="log", ylabel="smallest standard deviation, l/min")
    decades(axes.yaxis, medians.min(axis=None), medians.max(axis=None))
    axes.legend(fontsize=7.5)


def _rows_of_sensors(axes: Axes, rows: pd.DataFrame) -> None:
    names = [str(name) for name in rows["sensors"].unique()]
    groups = [rows.loc[rows["sensors"] == name, "sigma_lpm"] for name in names]
    low, median, high = np.array([np.quantile(group, [0.1, 0.5, 0.9]) for group in groups]).T
    axes.errorbar(median, range(len(names)), xerr=[median - low, high - median], fmt="o", color=COLOURS["blue"])
    row_axis(axes, names)
    axes.set(xscale="log", xlabel="smallest standard deviation, l/min; 10 to 90 % of the plants")
    decades(axes.xaxis, low.min(), high.max())


def decades(axis: Axis, low: float, high: float) -> None:
    """Ticks of a logarithmic axis as plain numbers: 1, 2 and 5 of each decade, or 1 alone where there are many."""
    exponents = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    steps = (1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)
    values = np.outer(10.0**exponents, steps).ravel()
    ticks(axis, [float(value) for value in values if 0.8 * low <= value <= 1.25 * high])
