"""The page of ``hydro trend``: what a planner needs in one sentence per axis, then the sizes over weeks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from hydro_agents.report.canvas import GREY, INK, PALE, WIDE, Plot, make_plot
from hydro_agents.report.content import Content
from hydro_agents.report.page import Page
from hydro_agents.report.palette import MEANINGS, SERIES
from hydro_agents.report.sections import Block, Fold, Points, Text, render_page, section
from hydro_agents.running.machine import Origin
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.monitoring.trend_summary import DAY, AxisTrend, date_text

TREND = ("axes_and_dates", "sizes_over_time", "how_trends_are_read")
SOURCES = Markup("All readings: <code>{}</code> beside this page.")

COLOURS = {
    Kind.HEALTHY: MEANINGS["good"].light,
    Kind.LEAK: MEANINGS["worse"].light,
    Kind.OTHER: MEANINGS["doubtful"].light,
    Kind.UNKNOWN: GREY,
}
MARKERS = {Kind.HEALTHY: "o", Kind.LEAK: "s", Kind.OTHER: "D", Kind.UNKNOWN: "x"}

MOST_PANELS = 40  # axes with a panel
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


def render_trend(trends: Sequence[AxisTrend], name: str, left_out: Sequence[str], origin: Origin) -> Page:
    """The page.

    Args:
        trends: of all axes.
        name: of the file with the readings.
        left_out: one line per file that was not read.
        origin: command, date and version.
    """
    content = Content({}, others={"trends": list(trends), "left_out": list(left_out)})
    return render_page("Leaks over time", TREND, content, origin, SOURCES.format(name))


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
    odd = [one for one in others if one.state is not Kind.HEALTHY]
    blocks: list[Block] = [Text(line, "verdict worse") for line in lines_of(urgent)[:10]]
    if not urgent:
        blocks.append(Text("No axis leaks or will reach its limit in sight.", "verdict good"))
    blocks += [Text(line) for line in lines_of(odd)[:10]]
    if len(others) > len(odd):
        blocks.append(Text(f"{len(others) - len(odd)} of {len(ordered)} axes: healthy, no date in sight.", "soft"))
    blocks.append(Text(f"Last reading: {date_text(max(float(one.time[-1]) for one in ordered))}.", "soft"))
    left_out = content.part("left_out", list)
    return [*blocks, *([Fold("Files that were not read", [Points(left_out)], style="caution")] if left_out else [])]


@section("Sizes over time", needs=("trends",))
def sizes_over_time(content: Content) -> list[Block]:
    """A panel per axis."""
    ordered = by_urgency(content.part("trends", list))
    more = len(ordered) - MOST_PANELS
    rest = [Text(f"{more} more axes have no panel; --json has the numbers of all.", "soft")] if more > 0 else []
    return [_plot(ordered[:MOST_PANELS]), *rest]


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


def _panel(axes: Axes, one: AxisTrend) -> None:
    """Readings, limit, repairs and trend of an axis; days since 1970, as figures count them."""
    axes.set_yscale("log")
    when = one.time / DAY
    first, last = float(when[0]), float(when[-1])
    length = max(last - first, 1.0)
    sizes, lows, highs = (np.maximum(values, LOWEST) for values in (one.size, one.low, one.high))
    for kind in Kind:
        chosen = np.isfinite(one.size) & np.array([verdict is kind for verdict in one.verdicts])
        if chosen.any():
            value, low, high = sizes[chosen], lows[chosen], highs[chosen]
            axes.errorbar(
                when[chosen], value, yerr=[np.maximum(value - low, 0.0), np.maximum(high - value, 0.0)],
                fmt=MARKERS[kind], color=COLOURS[kind], markersize=3.5, capsize=0, linewidth=0.9,
            )  # fmt: skip
    axes.axhline(one.limit, color=INK, linestyle="--", linewidth=1.0)
    for repair in one.repairs:
        axes.axvline(repair / DAY, color=GREY, linewidth=1.2)
        axes.annotate(
            "repaired", (repair / DAY, 1.0), xycoords=("data", "axes fraction"), xytext=(2, -2),
            textcoords="offset points", va="top", fontsize=7.5, color=GREY,
        )  # fmt: skip
    end = last + 0.02 * length
    if one.dated and one.growth.ahead.value > 0.0:
        end = _wedge(axes, one, first, last)
    axes.set_xlim(first - 0.02 * length, end)
    axes.set_yticks([0.001, 0.01, 0.1, 1.0, 10.0], ["≤ 0.001", "0.01", "0.1", "1", "10"])
    axes.set_ylim(LOWEST, 3.0 * max(one.limit, float(np.nanmax(sizes, initial=one.limit))))
    locator = AutoDateLocator(minticks=3, maxticks=6)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
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
