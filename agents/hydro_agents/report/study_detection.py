"""The section of a study about the leakage head: detection rates, errors of the size."""

from __future__ import annotations

from matplotlib.axes import Axes

from hydro_agents.report.canvas import Plot, curve_plot
from hydro_agents.report.content import Content, intervals, shown
from hydro_agents.report.sections import Block, Fold, Text, section
from hydro_agents.running.text import Table, number

SUMMARY: dict[str, tuple[str, float, int, str]] = {
    "auroc": ("Area under the ROC curve", 1.0, 3, ""),
    "threshold": ("Threshold of the leak probability", 1.0, 3, ""),
    "false_alarm_rate": ("False alarms at this threshold", 100.0, 1, " %"),
    "detection_rate_moderate": ("Moderate and severe leaks flagged at this threshold", 100.0, 1, " %"),
    "detection_rate_moderate_at_1_percent": (
        "Moderate and severe leaks flagged at a threshold with 1 % false alarms on these episodes",
        100.0,
        1,
        " %",
    ),
    "median_size_error_factor": ("Size: factor of error, half of the leaks within", 1.0, 2, ""),
    "p90_size_error_factor": ("Size: factor of error, nine in ten within", 1.0, 2, ""),
    "healthy_episodes": ("Healthy episodes", 1.0, 0, ""),
    "leaking_episodes": ("Leaking episodes", 1.0, 0, ""),
}
"""Name, factor, decimals and unit of the rows of the summary."""


@section("Detecting the leak", needs=("detection", "detection_summary"))
def detection(content: Content) -> list[Block]:
    """The leakage head under every controller."""
    tables = [
        _rate_table(content, "class", "Share of episodes flagged, by class of leak", "Class"),
        _rate_table(content, "range", "Share of leaks flagged, by size", "Leak, l/min"),
        summary_table(content),
    ]
    return [
        Text(
            "A neural network, the leakage head, reads the measured signals of one episode (position, both pressures, "
            "spool position, command) and estimates the probability of a leak and its size. A leak is flagged if the "
            "probability reaches the threshold. The head never reads the leak itself."
        ),
        _rates(content),
        Fold("Detection in numbers", tables),
    ]


# Tables -------------------------------------------------------------------------------------------------------------


def _rate_table(content: Content, group: str, caption: str, first: str) -> Table:
    rows = []
    for value, part in content.rows("detection_rates", group=group).groupby("value", sort=False):
        own = part.set_index("controller").loc[content.controllers].to_dict("records")
        cells = (shown(row, "flagged_share", 1, 100.0, "%") for row in own)
        rows.append((value, *cells, str(int(own[0]["episodes"]))))
    return Table(caption, (first, *content.controllers, "episodes"), rows)


def summary_table(content: Content) -> Table:
    """Areas under the curves, rates and errors of the size, one column per controller."""
    summary = content.table("detection_summary")
    rows = [
        (label, *(number(factor * value, decimals) + unit for value in summary[key]))
        for key, (label, factor, decimals, unit) in SUMMARY.items()
        if key in summary
    ]
    return Table("Detection, summary", ("Quantity", *summary["controller"]), rows)


# Figures ------------------------------------------------------------------------------------------------------------


def _rates(content: Content) -> Plot:
    rates = content.table("detection_rates")
    by_size = (rates["group"] == "range") & ~rates["value"].str.startswith("≥")
    rates = rates[(rates["value"] == "healthy") | by_size]
    parts = {
        name: intervals(rates[rates["controller"] == name], "flagged_share", "value", 100.0) for name in content.looks
    }

    def finish(axes: Axes) -> None:
        axes.set(xlabel="leak, l/min at 100 bar", ylabel="flagged, % of episodes", ylim=(-2.0, 102.0))

    note = "Bars: 95 % interval. Flags on healthy seals (left) are false alarms."
    named = ("rates", "Flagged episodes by leak size", note)
    return curve_plot(*named, parts, content.looks, " %", finish, apart=0.16, drawn="points")
