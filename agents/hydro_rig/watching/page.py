"""The page of ``hydro trend``: a row per axis, the most urgent first, and the sizes over weeks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

from hydro_agents.report.kit import BLUE, GOLD, GREEN, GREY, INK, ORANGE, Page, drawn, panels
from hydro_agents.running.text import number
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.watching.trend import DAY, AxisTrend, State

COLOURS = {Kind.HEALTHY: GREEN, Kind.LEAK: ORANGE, Kind.OTHER: GOLD, Kind.UNKNOWN: GREY}
STYLES = {State.HEALTHY: "good", State.LEAK: "worse"}
MOST_PANELS = 20  # axes with a panel
LOWEST = 1e-3  # l/min; lower end of the scale


@drawn
def trend_page(trends: Sequence[AxisTrend], table: str, left_out: Sequence[str]) -> Page:
    """The page of axes, the most urgent first; ``table`` names the file with the readings."""
    page = Page("Leaks over time", f"All readings: {table} beside this page.")
    page.verdict(trends[0].line(), STYLES.get(trends[0].states[0], "doubtful"))
    rows = {}
    for one in trends:
        facts = one.facts()
        date = "" if facts["limit_reached"] is None else facts["limit_reached"]["value"]
        rows[one.axis] = {
            "state": ", ".join(one.states),
            "leak, l/min": "–" if np.isnan(one.leak.value) else " to ".join(number(v, digits=2) for v in one.leak[1:]),
            "limit reached": date,
            "last reading": facts["last"] or "none",
            "age, d": facts["age_days"],
            "readings": len(one.rows),
        }
    page.table(pd.DataFrame.from_dict(rows, orient="index"), "Axes; leaks at 100 bar and 40 °C, 90 %", words=True)
    shown = [one for one in trends if len(one.rows)][:MOST_PANELS]
    if shown:
        all_axes = panels(len(shown), height=0.6 + 1.6 * len(shown), sharey=True)
        for axes, one in zip(all_axes, shown, strict=True):
            draw_axis(axes, one)
        page.figure(all_axes, "Leak of each axis", "Dashed: the limit. Vertical: repairs. Blue: the trend.")
    if left_out:
        with page.fold("Files that were not read", opened=True):
            page.points(left_out)
    return page


def draw_axis(axes: Axes, one: AxisTrend) -> None:
    """Readings with 90 % intervals by verdict, limit, repairs and trend; days since 1970, as figures count them."""
    days = one.rows["begin"] / DAY
    sizes = one.rows[["size_40", "low_40", "high_40"]].clip(lower=LOWEST).to_numpy(dtype=np.float64)
    for kind, colour in COLOURS.items():
        chosen = (one.rows["verdict"] == kind).to_numpy() & np.isfinite(sizes[:, 0])
        if chosen.any():
            value, low, high = sizes[chosen].T
            ends = np.maximum([value - low, high - value], 0.0)
            axes.errorbar(days[chosen], value, yerr=ends, fmt="o", color=colour, markersize=3.5, label=kind.value)
    axes.axhline(one.limit, color=INK, linestyle="--")
    for repair in days[one.rows["repaired"] != ""]:
        axes.axvline(repair, color=GREY)
    if one.dated:
        ends = one.now / DAY + np.array([0.0, one.growth.ahead.value])
        axes.plot(ends, [one.growth.level.value, one.limit], color=BLUE, marker="")
    axes.set(yscale="log", ylabel=f"{one.axis}, l/min")
    locator = AutoDateLocator(minticks=3, maxticks=6)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
