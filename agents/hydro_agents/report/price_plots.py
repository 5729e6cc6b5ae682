"""The cost of a leak even if the axis holds its position: power from the supply, reserve of speed and force."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.canvas import COLOURS, Plot, description, log_leak_axis, looks_of, one_panel
from hydro_agents.report.text import listed, number, setting

RESERVES = {
    "speed out": "speed_out_mm_s",
    "speed back": "speed_back_mm_s",
    "force out": "force_out_n",
    "force back": "force_back_n",
}
"""Reserves at full command, and their columns."""


def price_plots(table: pd.DataFrame) -> list[Plot]:
    """Holding power, and reserve of speed and force, over the leak.

    Args:
        table: of :func:`~hydro_agents.evaluation.leak_price.leak_price`; empty without it.
    """
    if table.empty:
        return []
    leaks = [float(leak) for leak in table["leakage_flow_lpm"]]
    looks = looks_of(RESERVES)
    shares = {name: 100.0 * table[column] / float(table[column].iloc[0]) for name, column in RESERVES.items()}
    marks = [leak for leak in leaks if leak in (0.01, 0.1, 0.3, 1.0, 2.0, 4.0, 8.0)]

    def paint_power(axes: Axes) -> None:
        axes.plot(leaks, table["holding_power_w"], color=COLOURS[0], marker="o")
        axes.set(ylabel="power from the supply, W", ylim=(0.0, 1.07 * float(table["holding_power_w"].max())))
        log_leak_axis(axes, marks)

    def paint_left(axes: Axes) -> None:
        for name, look in looks.items():
            axes.plot(leaks, shares[name], label=name, marker=look.marker, **look.stroke)
        axes.set(ylabel="reserve, % of the tight seal", ylim=(0.0, 105.0))
        log_leak_axis(axes, marks)

    where = number(float(table["place_mm"].iloc[0]), 0)
    title = f"Power to hold {where} mm"
    rows = {"power": [(f"{setting(leak)} l/min", w) for leak, w in zip(leaks, table["holding_power_w"], strict=True)]}
    kept = {
        name: [(f"{setting(leak)} l/min", v) for leak, v in zip(leaks, share, strict=True)]
        for name, share in shares.items()
    }
    return [
        one_panel(
            "price-power",
            title,
            "Flow through the valve times supply pressure.",
            description(title, rows, " W"),
            paint_power,
        ),
        one_panel(
            "price-left",
            "Reserve of speed and force",
            "At full command: steady speed at this place, and the largest load that the axis can hold.",
            description("Reserve of speed and force", kept, " %"),
            paint_left,
        ),
    ]


def price_sentence(table: pd.DataFrame, leak: float) -> str:
    """The cost of one leak, as a sentence; empty if the table does not contain the leak."""
    rows = table[table["leakage_flow_lpm"] == leak] if len(table) else table
    if rows.empty:
        return ""
    row, tight = rows.iloc[0], table.iloc[0]
    left = {name: number(100.0 * row[column] / tight[column], 0) for name, column in RESERVES.items()}
    held = float(row["holding_power_w"])
    power = f"takes {number(held)} W" if held == held else "is impossible"
    where = number(float(row["place_mm"]), 0)
    return (
        f"With any controller, holding {where} mm {power} from the supply. Reserve at full "
        f"command, relative to the tightest seal: {listed([f'{name} {share} %' for name, share in left.items()])}."
    )
