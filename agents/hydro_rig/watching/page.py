"""The page of all axes: a line for each, the most urgent first, and below it the sizes over weeks."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

from hydro_agents.report.kit import BLUE, GOLD, GREEN, GREY, INK, ORANGE, Page, drawn, panel, sparkline
from hydro_agents.running.text import number
from hydro_env.types import Floats
from hydro_rig.diagnosis.diagnosis_page import HIGHEST, LOWEST, scale_of_leaks
from hydro_rig.diagnosis.verdict import Kind
from hydro_rig.watching.table import SIZES
from hydro_rig.watching.trend import DAY, AxisTrend, Condition

COLOURS = {Kind.HEALTHY: GREEN, Kind.LEAK: ORANGE, Kind.OTHER: GOLD, Kind.UNKNOWN: GREY}
STYLES = {Condition.GOOD: "good", Condition.OUT: "worse", Condition.FAILURE: "worse", Condition.MAINTENANCE: "worse"}
MOST_PANELS = 20  # axes with a figure; the others have a line
MARGIN = 0.1  # days of the figure before the first reading and after the last
SPARKS = 60  # readings in the small line of an axis


@drawn
def trend_page(trends: Sequence[AxisTrend], table: str, left_out: Sequence[str]) -> Page:
    """The page of axes, the most urgent first; ``table`` names the file with the readings."""
    page = Page("Axes and their leaks", f"All readings: {table} beside this page.")
    counts = Counter(one.condition for one in trends)
    page.verdict(", ".join(f"{counts[one]} {one}" for one in Condition if counts[one]), _style(trends[0]))
    with page.links():
        for one in trends:
            page.link(one.axis, _style(one), _cells(one), sparkline(_sizes(one)[-SPARKS:, 0], one.limit))
    page.text(
        "Leaks in l/min at 100 bar and 40 °C with 90 % intervals, of their limits (dashed); last reading and its age.",
        "soft",
    )
    if left_out:
        with page.fold("Files that were not read", opened=True):
            page.points(left_out)
    for place, one in enumerate(trends):
        page.heading(one.axis)
        page.text(one.line())
        if place < MOST_PANELS and len(one.rows):
            axes = panel(height=2.6)
            draw_axis(axes, one)
            page.figure(axes, f"Leak of {one.axis}", "Dashed: the limit. Vertical: repairs. Blue: the trend.")
    return page


def _style(one: AxisTrend) -> str:
    return STYLES.get(one.condition, "doubtful")


def _cells(one: AxisTrend) -> list[str]:
    """Condition, leak, date or state, and last reading of an axis, for one line of the list."""
    facts = one.facts()
    leak, note, age = "no size", ", ".join(one.states), "no reading"
    if np.isfinite(one.leak.value):
        leak = "{} ({} to {}) of {}".format(*(number(size, digits=2) for size in (*one.leak, one.limit)))
    if facts["limit_reached"]:
        note = f"limit {facts['limit_reached']['value']}"
    if facts["last"]:
        age = f"{facts['last'][:16].replace('T', ' ')}, {facts['age_days']:.1f} d"
    return [one.condition, leak, note, age]


def _sizes(one: AxisTrend) -> Floats:
    """Sizes with the ends of their intervals on the scale of the figure, (readings, 3)."""
    return one.rows[SIZES].clip(LOWEST, HIGHEST).to_numpy(float)


def draw_axis(axes: Axes, one: AxisTrend) -> None:
    """Readings with 90 % intervals by verdict, limit, repairs and trend; days since 1970, as figures count them."""
    days, sizes = one.rows["begin"] / DAY, _sizes(one)
    for kind, colour in COLOURS.items():
        chosen = (one.rows["verdict"] == kind) & np.isfinite(sizes[:, 0])
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
    axes.update_datalim([(days.min() - MARGIN, one.limit), (days.max() + MARGIN, one.limit)])
    axes.autoscale(axis="x")
    axes.set_ylabel("leak, l/min")
    scale_of_leaks(axes)
    locator = AutoDateLocator(minticks=3, maxticks=6)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
