"""The page of the robustness protocol: controllers under every condition, relative to the baseline."""

from __future__ import annotations

import numpy as np

from hydro_agents.evaluation.metrics import FRAMES_TEXT, METRICS
from hydro_agents.report.content import ALL, Content, interval, interval_text, shown, verdict
from hydro_agents.report.palette import STRONGEST
from hydro_agents.report.sections import Block, Fold, Points, Text, section
from hydro_agents.report.shared import COSTS, findings_of, problems
from hydro_agents.running.text import Cell, Table, number

PAGE_FILE = "robustness.html"

ROBUSTNESS = (
    "introduction",
    "findings",
    "comparison",
    "costs",
    "method",
    "run",
)
"""Sections of the page, in order."""


FULL_COLOUR = 2.0
"""A ratio of 2 or 1/2 has the strongest colour."""

GROUPS = {
    "leak": "Leak past the piston",
    "leak_law": "Law of the leak",
    "schedule": "Leak that changes during the run",
    "supply_and_load": "Supply and load",
    "timing": "Timing",
    "sensors": "Sensors",
    "force": "External force",
    "day": "Through a day: moves after a pause, slow runs, small steps",
    "rig": "Other rigs",
    "parameter": "Assumed parameters, one at a time",
}
"""Titles of the groups of conditions, in the order of the map."""

FOLDED = ("parameter",)
"""Groups that the page folds because they have many conditions."""

Row = tuple[str | Cell, ...]


@section("Findings", heading=False)
def findings(content: Content) -> list[Block]:
    """The findings as cards, and what did not run."""
    note = f"In brackets: 95 % intervals. Ratios are error ÷ error of {content.baseline} on the same cases."
    return [*findings_of(content), Text(f"{note} Below 1 is better.", "soft"), *problems(content)]


@section("Comparison by condition", needs=("comparison", "conditions"))
def comparison(content: Content) -> list[Block]:
    """The heat map of all conditions."""
    base = content.baseline
    note = (
        f"Error ÷ error of {base} under the same condition; every kind of reference has the same weight. A cell has a "
        "colour only if its whole 95 % interval is on one side of 1: blue is better, orange "
        "is worse. Bold: the best of its row. The first column is "
        f"the mean error of {base}."
    )
    sensed = heat_map(content, "Ratio of errors in the frame of the sensor, equal weights", "equal_weight_sensor")
    return [
        Text(note),
        *heat_map(content, "Ratio of errors, equal weights", "equal_weight"),
        Fold("The same in the frame of the sensor (repeatability)", sensed),
        Fold("The same with mean errors, which steps dominate", heat_map(content, "Ratio of mean errors", "ratio")),
    ]


@section("Errors and costs", needs=("summary",))
def costs(content: Content) -> list[Block]:
    """Ranking, errors and costs of every controller."""
    return [*ranking_table(content), absolute_table(content), *cycles_by_condition(content)]


@section("How it was measured", needs=("summary",))
def method(content: Content) -> list[Block]:
    """Pairing, intervals and measures."""
    return [
        Points(
            [
                "Paired cases: a seed fixes plant, reference and noise, and every controller runs on the same seeds. "
                "They are test seeds; no controller was tuned or trained on them.",
                "Intervals: 95 %, bootstrap over plants and training seeds.",
                "Equal weights: geometric mean of the ratios of all kinds of reference.",
                FRAMES_TEXT,
            ]
        )
    ]


# Heat map -----------------------------------------------------------------------------------------------------------


def heat_map(content: Content, caption: str, column: str) -> list[Block]:
    """The map of a column of the table ``comparison``: label, error of the baseline, and a cell per controller."""
    header = ("Condition", f"{content.baseline}, mm", *content.controllers[1:])
    rows = [_row(content, ALL, column)]
    breaks: dict[int, str] = {}
    folded: list[Block] = []
    for group in dict.fromkeys([*GROUPS, *content.table("conditions")["group"]]):
        title = GROUPS.get(group, group)
        own = [_row(content, name, column) for name in content.in_groups(group)]
        if own and group in FOLDED:
            folded.append(Table(title, header, own, style="heat", folded=True))
        elif own:
            breaks[len(rows)] = title
            rows += own
    return [Table(caption, header, rows, style="heat", folded=False, breaks=breaks), *folded]


def _row(content: Content, condition: str, column: str) -> Row:
    """Label, error of the baseline, and a cell per controller: coloured if its interval is on one side of 1."""
    values = [interval(content.against(name, condition), column) for name in content.controllers[1:]]
    least = min((value.value for value in values if np.isfinite(value.value)), default=np.nan)
    place = {"controller": content.baseline, "group": ALL}
    if condition != ALL:
        place = {"controller": content.baseline, "group": "condition", "value": condition}
    error = content.row("summary", **place, metric="mean_error_mm")
    cells = []
    for value in values:
        meaning = verdict(value).replace("same", "")
        share, best = colour_share(value.value) if meaning else 0, value.value == least < 1.0
        cells.append(Cell(number(value.value, 2), meaning, share, interval_text(value, decimals=2), best))
    label = "all conditions" if condition == ALL else content.label(condition)
    return label, number(error.get("mean", np.nan)), *cells


def colour_share(ratio: float) -> int:
    """Percentage of the colour of a ratio: 0 at 1, and symmetric in the logarithm of the ratio."""
    share = abs(float(np.log(max(ratio, 1e-9)))) / float(np.log(FULL_COLOUR))
    return round(STRONGEST * min(share, 1.0))


# Tables -------------------------------------------------------------------------------------------------------------

RATIOS = {
    "equal_weight": "equal weights",
    "equal_weight_sensor": "the same, repeatability",
    "ratio": "mean",
}
"""Ratios of errors in the ranking."""


def ranking_table(content: Content) -> list[Table]:
    """Every controller relative to the baseline: errors, certainty, costs."""
    if not content.has("ranking") or len(content.controllers) < 2:
        return []
    rows = []
    for row in content.table("ranking").to_dict("records"):
        own = content.against(row["controller"])
        rows.append(
            (
                row["controller"],
                *(shown(own, column, 2) if own else "1.00" for column in RATIOS),
                number(own.get("worst_ratio", 1.0), 2),
                number(100.0 * own.get("share_better", np.nan), 0),
                *(number(own.get(column, 1.0), 2) for column in COSTS),
                *(str(int(row[key])) if key in row else "–" for key in ("best_in", "failures", "limit_cycles")),
            )
        )
    prices = (metric.ratio for metric in COSTS.values())
    counts = ("best in", "failed", "limit cycles")
    header = ("Controller", *RATIOS.values(), "worst case", "better in, %", *prices, *counts)
    errors, costs = (f"error ÷ error of {content.baseline}", 4), ("cost ÷ baseline’s", len(COSTS))
    return [Table("All conditions", header, rows, (errors, ("", 1), costs, ("count", 3)), "dense")]


def absolute_table(content: Content) -> Table:
    """Mean and worst error in mm with costs, over all conditions."""
    metrics = [metric for metric in METRICS.values() if metric.cost or metric.ratio]
    rows = []
    for name in content.controllers:
        own = content.rows("summary", controller=name, group=ALL).set_index("metric").to_dict("index")
        error = own.get("mean_error_mm", {})
        means = (metric.factor * own.get(metric.name, {}).get("mean", np.nan) for metric in metrics)
        errors = (shown(error, "mean"), number(error.get("worst", np.nan)))
        rows.append((name, *errors, *map(number, means)))
    errors = ("mean error, mm", "worst run, mm")
    header = ("Controller", *errors, *(metric.label for metric in metrics))
    return Table("Errors and costs, mean over all runs", header, rows, style="dense")


def cycles_by_condition(content: Content) -> list[Table]:
    """Limit cycles at mid-stroke under every condition in which any controller has one."""
    table = content.table("limit_cycles")
    if table.empty:
        return []
    some = table[table.groupby("condition")["limit_cycle"].transform("sum") > 0]
    rows = []
    for condition, own in some.groupby("condition", sort=False):
        counts = own.groupby("controller")["limit_cycle"].agg(["sum", "count"]).astype(int)
        texts = counts["sum"].astype(str) + " of " + counts["count"].astype(str)
        rows.append((content.label(str(condition)), *texts.reindex(content.controllers, fill_value="–")))
    caption = "Limit cycles by condition; none under the others"
    return [Table(caption, ("Condition", *content.controllers), rows)] if rows else []
