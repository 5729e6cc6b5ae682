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
from hydro_agents.running.text import Table
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.monitoring.trend_summary import DAY, AxisTrend, State

TREND = ("axes_and_dates", "sizes_over_time")
SOURCES = Markup("All readings: <code>{}</code> beside this page.")

MARKS = {
    Kind.HEALTHY: ("o", MEANINGS["good"].light),
    Kind.LEAK: ("s", MEANINGS["worse"].light),
    Kind.OTHER: ("D", MEANINGS["doubtful"].light),
    Kind.UNKNOWN: ("x", GREY),
}

MOST_PANELS = 40  # axes with a panel
LOWEST = 1e-3  # l/min; lower end of the scale
AHEAD = 0.6  # of the time so far, that a panel shows ahead at most


def render_trend(trends: Sequence[AxisTrend], name: str, left_out: Sequence[str], origin: Origin) -> Page:
    """The page.

    Args:
        trends: of all axes, the most urgent first.
        name: of the file with the readings.
        left_out: one line per file that was not read.
        origin: command, date and version.
    """
    content = Content({}, others={"trends": list(trends), "left_out": list(left_out)})
    return render_page("Leaks over time", TREND, content, origin, SOURCES.format(name))


@section("", needs=("trends",))
def axes_and_dates(content: Content) -> list[Block]:
    """The sentences, the urgent ones in front, and all axes in a table."""
    trends: list[AxisTrend] = content.part("trends", list)
    urgent = [one for one in trends if one.urgency < (3, 0.0)]
    odd = [one for one in trends if one not in urgent and one.state is not State.HEALTHY]
    blocks: list[Block] = [Text(one.line(), "verdict worse") for one in urgent[:10]]
    if not urgent:
        quiet = "No axis is known to leak" if odd else "No axis leaks or will reach its limit in sight"
        unsure = f", but {len(odd)} of {len(trends)} are not known to be healthy" if odd else ""
        blocks.append(Text(f"{quiet}{unsure}.", f"verdict {'doubtful' if odd else 'good'}"))
    blocks += [Text(one.line()) for one in odd[:10]]
    header = ("Axis", "State", "Leak, l/min (90 %)", "Last reading", "Age", "Readings")
    rows = [
        (one.axis, ", ".join(one.states), one.leak_text(), *one.last_reading(), str(len(one.time))) for one in trends
    ]
    blocks.append(Table("", header, rows, folded=False))
    left_out = content.part("left_out", list)
    return [*blocks, *([Fold("Files that were not read", [Points(left_out)], style="caution")] if left_out else [])]


@section("Sizes over time", needs=("trends",))
def sizes_over_time(content: Content) -> list[Block]:
    """A panel per axis."""
    read = [one for one in content.part("trends", list) if len(one.time)]
    more = len(read) - MOST_PANELS
    rest = [Text(f"{more} more axes have no panel.", "soft")] if more > 0 else []
    return [_plot(read[:MOST_PANELS]), *rest]


# The figure ---------------------------------------------------------------------------------------------------------


def _plot(trends: Sequence[AxisTrend]) -> Plot:
    note = (
        "Leak at 100 bar and 40 °C with its 90 % interval. Circles: healthy; squares: leak; diamonds: another fault; "
        "crosses: undecided. Dashed: the limit. Vertical lines: repairs. Blue: the trend, and when it reaches the "
        "limit (90 %); triangle: “not before”."
    )
    columns = 2 if len(trends) > 1 else 1
    rows = -(-len(trends) // columns)
    alt = " ".join(one.sentence() for one in trends[:6])

    def paint(figure: Figure) -> None:
        panels = np.atleast_1d(figure.subplots(rows, columns, sharey=True, squeeze=False)).ravel()
        panels[0].set_yscale("log")  # all panels share the scale
        panels[0].set_ylim(LOWEST, 3.0 * max(float(np.nanmax([*one.size, one.limit])) for one in trends))
        for axes, one in zip(panels, trends, strict=False):
            _panel(axes, one)
        for axes in panels[len(trends) :]:
            axes.set_visible(False)
        for axes in panels[::columns]:
            axes.set_ylabel("l/min")

    return make_plot("trend", "Leak of each axis", note, alt, paint, 0.6 + (2.0 if columns == 2 else 3.2) * rows, WIDE)


def _panel(axes: Axes, one: AxisTrend) -> None:
    """Readings, limit, repairs and trend of an axis; days since 1970, as figures count them."""
    when = one.time / DAY
    first, now = float(when[0]), one.now / DAY
    length = max(now - first, 1.0)
    sizes, lows, highs = (np.maximum(values, LOWEST) for values in (one.size, one.low, one.high))
    for kind, (marker, colour) in MARKS.items():
        chosen = np.isfinite(one.size) & np.array([verdict is kind for verdict in one.verdicts])
        if chosen.any():
            value, low, high = sizes[chosen], lows[chosen], highs[chosen]
            axes.errorbar(
                when[chosen], value, yerr=[np.maximum(value - low, 0.0), np.maximum(high - value, 0.0)],
                fmt=marker, color=colour, markersize=3.5, capsize=0, linewidth=0.9,
            )  # fmt: skip
    axes.axhline(one.limit, color=INK, linestyle="--", linewidth=1.0)
    for repair in one.repairs:
        axes.axvline(repair / DAY, color=GREY, linewidth=1.2)
    end, ahead, level = now + 0.02 * length, one.growth.ahead, one.growth.level
    if one.dated and ahead.value > 0.0:
        end = now + 1.0 + min(ahead.high, AHEAD * max(length, 10.0))
        blue = SERIES["blue"].light
        axes.plot([now, now + ahead.value], [level.value, one.limit], color=blue, linewidth=1.2)
        axes.plot([now + ahead.low, min(now + ahead.high, end)], [one.limit, one.limit], color=blue, linewidth=3.0)
        axes.plot([now + one.growth.not_before], [one.limit], marker="v", color=INK, markersize=6, linestyle="none")
        axes.axvspan(now, end, color=PALE, alpha=0.5, linewidth=0, zorder=-1)
    axes.set_xlim(first - 0.02 * length, end)
    ticks = LOWEST * 10.0 ** np.arange(np.ceil(np.log10(axes.get_ylim()[1] / LOWEST)))
    axes.set_yticks(ticks, [f"≤ {LOWEST:g}", *(f"{tick:g}" for tick in ticks[1:])])
    locator = AutoDateLocator(minticks=3, maxticks=6)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.set_title(f"{one.axis}: {', '.join(one.states)}", fontsize=9)
