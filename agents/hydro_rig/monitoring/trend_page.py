"""The page of ``hydro trend``: what a planner needs in one sentence per axis, then the sizes over weeks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hydro_agents.report.canvas import GREY, INK, PALE, WIDE, Plot, make_plot
from hydro_agents.report.content import Content
from hydro_agents.report.page import Page
from hydro_agents.report.palette import MEANINGS, SERIES
from hydro_agents.report.sections import Block, Fold, Points, Text, render_page, section
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Cell, Table, number
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.monitoring.trend_summary import DAY, AxisTrend, date_text

TREND = ("axes_and_dates", "sizes_over_time", "axes_in_numbers", "all_readings", "how_trends_are_read")
SOURCES = Markup("Numbers: <code>{}</code> beside this page.")

COLOURS = {
    Kind.HEALTHY: MEANINGS["good"].light,
    Kind.LEAK: MEANINGS["worse"].light,
    Kind.OTHER: MEANINGS["doubtful"].light,
    Kind.UNKNOWN: GREY,
}
MARKERS = {Kind.HEALTHY: "o", Kind.LEAK: "s", Kind.OTHER: "D", Kind.UNKNOWN: "x"}
# matplotlib's dates have no types
_date_locator: Any = AutoDateLocator
_date_formatter: Any = ConciseDateFormatter

CLASSES = {Kind.HEALTHY: "", Kind.LEAK: "worse", Kind.OTHER: "worse", Kind.UNKNOWN: ""}

MOST_PANELS, MOST_ROWS = 40, 300  # axes with a panel; rows in the table of the page
LOWEST = 1e-3  # l/min; lower end of the scale
AHEAD = 0.6  # of the time so far, that a panel shows ahead at most

JUDGED = (
    "A reading is the median of the liveliest windows; each is estimated by simulating the rig with its commands.",
    Markup(
        "The size is referred to <strong>100 bar and 40 °C</strong>: a gap passes flow in proportion to 1/viscosity. "
        "Without a recorded oil temperature the interval covers the range that was assumed."
    ),
    "The state of an axis is the verdict on which three of its last five readings agree.",
    "A date is told if the axis leaks and the leak grows with a probability of 99.9 %. It supposes that the growth "
    "goes on as before, as a straight line on this scale. “Not before”: with 99 % the limit is not reached earlier.",
    "Only readings since the last repair count for the trend.",
)


def render_trend(
    trends: Sequence[AxisTrend], table: pd.DataFrame, name: str, left_out: Sequence[str], origin: Origin
) -> Page:
    """The page.

    Args:
        trends: of all axes.
        table: the rows behind them.
        name: of the file of the table.
        left_out: one line per file that was not read.
        origin: command, date and version.
    """
    others = {"trends": list(trends), "left_out": list(left_out)}
    return render_page("Leaks over time", TREND, Content({"rows": table}, others=others), origin, SOURCES.format(name))


def by_urgency(trends: Sequence[AxisTrend]) -> list[AxisTrend]:
    """Axes at their limit first, then by date, then those with a fault, then the others."""

    def place(one: AxisTrend) -> tuple[int, float]:
        if one.growth.ahead.value == 0.0:
            return 0, -one.growth.level.value
        if one.dated:
            return 1, one.growth.ahead.value
        return [Kind.LEAK, Kind.OTHER, Kind.UNKNOWN, Kind.HEALTHY].index(one.state) + 2, 0.0

    return sorted(trends, key=place)


def lines_of(trends: Sequence[AxisTrend]) -> list[str]:
    """A line per axis with its state and the sentence, the most urgent first."""
    lines = []
    for one in by_urgency(trends):
        why = f" ({one.reason})" if one.reason and one.state is not Kind.HEALTHY else ""
        lines.append(f"{one.sentence()} Now: {one.state.value}{why}.")
    return lines


@section("", needs=("trends",))
def axes_and_dates(content: Content) -> list[Block]:
    """The sentences, the urgent ones in front."""
    ordered = by_urgency(content.part("trends", list))
    urgent = [one for one in ordered if one.dated or one.growth.ahead.value == 0.0 or one.state is Kind.LEAK]
    others = [one for one in ordered if one not in urgent]
    blocks: list[Block] = [Text(line, "verdict worse") for line in lines_of(urgent)[:10]]
    if not urgent:
        blocks.append(Text("No axis leaks or will reach its limit in sight.", "verdict good"))
    odd = [one for one in others if one.state is not Kind.HEALTHY]
    blocks += [Text(line) for line in lines_of(odd)[:10]]
    quiet = len(others) - len(odd)
    if quiet:
        blocks.append(Text(f"{quiet} of {len(ordered)} axes: healthy, no date in sight.", "soft"))
    blocks.append(Text(f"Last reading: {date_text(max(float(one.time[-1]) for one in ordered))}.", "soft"))
    left = content.part("left_out", list)
    title = "One file was not read" if len(left) == 1 else f"{len(left)} files were not read"
    return [*blocks, *([Fold(title, [Points(left)], style="caution")] if left else [])]


@section("Sizes over time", needs=("trends",))
def sizes_over_time(content: Content) -> list[Block]:
    """A panel per axis."""
    ordered = by_urgency(content.part("trends", list))
    more = len(ordered) - MOST_PANELS
    rest = [Text(f"{more} more axes are in the table below.", "soft")] if more > 0 else []
    return [_plot(ordered[:MOST_PANELS]), *rest]


@section("The axes in numbers", needs=("trends",))
def axes_in_numbers(content: Content) -> list[Block]:
    """One row per axis."""
    rows: list[tuple[str | Cell, ...]] = []
    for one in by_urgency(content.part("trends", list)):
        level, rate = one.growth.level, one.growth.rate
        dates = [one.date(days) if np.isfinite(days) else "–" for days in (*one.growth.ahead, one.growth.not_before)]
        state = Cell(one.state.value, CLASSES[one.state], 20 if CLASSES[one.state] else 0)
        rows.append(
            (
                one.axis,
                state,
                f"{number(level.value, digits=2)} ({number(level.low, digits=2)} to {number(level.high, digits=2)})",
                f"{number(30.0 * rate.value, 2, signed=True)}" if one.growth.grows >= 0.95 else "–",
                f"{dates[0]} ({dates[1]} to {dates[2]})" if one.dated else "–",
                dates[3] if one.growth.not_before < 365.0 else "–",
                f"{len(one.time)}",
            )
        )
    header = ("Axis", "Now", "l/min (90 %)", "Decades a month", "At the limit (90 %)", "Not before", "Readings")
    return [Table("Leaks at 100 bar and 40 °C", header, rows, folded=False)]


@section("All readings", needs=("rows",))
def all_readings(content: Content) -> list[Block]:
    """The latest rows of the table."""
    rows = content.table("rows").sort_values("time", ascending=False, kind="stable").head(MOST_ROWS)
    cells = [
        (
            row["time"].replace("T", " ")[:16],
            row["axis"],
            row["verdict"],
            f"{number(row['size_40'], 3)} ({number(row['low_40'], 3)} to {number(row['high_40'], 3)})",
            f"{number(row['temperature'], 0)}",
            f"{number(100.0 * row['moving'], 0)}",
            row["file"],
            row["reason"],
        )
        for row in rows.to_dict("records")
    ]
    header = ("Time", "Axis", "Verdict", "l/min at 40 °C", "Oil, °C", "Moving, %", "File", "Reason")
    caption = f"The latest {len(cells)} readings" if len(content.table("rows")) > len(cells) else "All readings"
    return [Table(caption, header, cells, style="words", folded=True)]


@section("How it was read", needs=("trends",))
def how_trends_are_read(content: Content) -> list[Block]:
    """Sizes, states and dates."""
    del content
    return [Points(JUDGED)]


# The figure ---------------------------------------------------------------------------------------------------------


def _plot(trends: Sequence[AxisTrend]) -> Plot:
    note = (
        "Leak at 100 bar and 40 °C with its 90 % interval. Circles: healthy; squares: leak; diamonds: another fault; "
        "crosses: undecided. Dashed: the limit. Vertical lines: repairs. Wedge: where the trend goes (90 %); triangle: "
        "“not before”."
    )
    columns = 2 if len(trends) > 1 else 1
    rows = -(-len(trends) // columns)
    alt = " ".join(one.sentence() for one in trends[:6])

    def paint(figure: Figure) -> None:
        panels = np.atleast_1d(figure.subplots(rows, columns, sharey=True, squeeze=False)).ravel()
        for axes, one in zip(panels, trends, strict=False):
            _panel(axes, one)
        for axes in panels[len(trends) :]:
            axes.set_visible(False)
        for axes in panels[::columns]:
            axes.set_ylabel("l/min")

    return make_plot("trend", "Leak of each axis", note, alt, paint, 0.6 + (2.0 if columns == 2 else 3.2) * rows, WIDE)


def _days(time: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Days since 1970, as figures count them."""
    return np.asarray(time, dtype=np.float64) / DAY


def _panel(axes: Axes, one: AxisTrend) -> None:
    axes.set_yscale("log")
    when = _days(one.time)
    first, last = float(when[0]), float(when[-1])
    known = np.isfinite(one.size)
    shown = [np.maximum(values, LOWEST) for values in (one.size, one.low, one.high)]
    for kind in Kind:
        chosen = known & np.array([verdict is kind for verdict in one.verdicts])
        if chosen.any():
            value, low, high = (part[chosen] for part in shown)
            axes.errorbar(
                when[chosen], value, yerr=[np.maximum(value - low, 0.0), np.maximum(high - value, 0.0)],
                fmt=MARKERS[kind], color=COLOURS[kind], markersize=3.5, capsize=0, linewidth=0.9,
            )  # fmt: skip
    axes.axhline(one.limit, color=INK, linestyle="--", linewidth=1.0)
    for repair in one.repairs:
        axes.axvline(float(_days(repair)), color=GREY, linewidth=1.2)
        axes.annotate(
            "repaired", (float(_days(repair)), 1.0), xycoords=("data", "axes fraction"), xytext=(2, -2),
            textcoords="offset points", va="top", fontsize=7.5, color=GREY,
        )  # fmt: skip
    end = last + 0.02 * max(last - first, 1.0)
    if one.dated and one.growth.ahead.value > 0.0:
        end = _wedge(axes, one, first, last)
    top = 3.0 * max(one.limit, float(np.nanmax(shown[0], initial=one.limit)))
    axes.set_ylim(LOWEST, top)
    axes.set_xlim(first - 0.02 * max(last - first, 1.0), end)
    ticks = [0.001, 0.01, 0.1, 1.0, 10.0]
    axes.set_yticks(ticks, ["≤ 0.001", "0.01", "0.1", "1", "10"])
    axes.set_ylim(LOWEST, top)
    locator: Any = _date_locator(minticks=3, maxticks=6)
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(_date_formatter(locator))
    axes.set_title(f"{one.axis}: {one.state.value}", fontsize=9)


def _wedge(axes: Axes, one: AxisTrend, first: float, last: float) -> float:
    """Where the trend goes until it reaches the limit; returns the end of the panel."""
    level, ahead = one.growth.level, one.growth.ahead
    farthest = last + AHEAD * max(last - first, 10.0)
    end = min(last + ahead.high, farthest)
    far = (
        one.limit
        if last + ahead.high <= farthest
        else level.low * (one.limit / level.low) ** ((end - last) / ahead.high)
    )
    corners = [(last, level.low), (last, level.high), (last + ahead.low, one.limit), (end, one.limit), (end, far)]
    axes.fill(*zip(*corners, strict=True), color=SERIES["blue"].light, alpha=0.25, linewidth=0)
    axes.plot([last, last + ahead.value], [level.value, one.limit], color=SERIES["blue"].light, linewidth=1.2)
    axes.plot([last + one.growth.not_before], [one.limit], marker="v", color=INK, markersize=6, linestyle="none")
    axes.axvspan(last, end + 1.0, color=PALE, alpha=0.5, linewidth=0, zorder=-1)
    return end + 1.0
