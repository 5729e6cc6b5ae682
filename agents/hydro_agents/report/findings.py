"""Findings on the pages that compare controllers: who positions best, and policies against what they correct."""

from __future__ import annotations

from hydro_agents.evaluation.limit_cycles import comes_to_rest
from hydro_agents.evaluation.metrics import COMPARED
from hydro_agents.report.content import Content, interval, shown, verdict
from hydro_agents.report.sections import Block, Text
from hydro_agents.running.text import Table, number

COSTS = {column: metric for column, metric in COMPARED.items() if metric.cost}
"""Columns of a comparison with what a small error may cost."""


def findings_of(content: Content) -> list[Block]:
    """Who is best, with a warning if the baseline does not come to rest; policies against what they correct."""
    base = content.row("limit_cycle_summary", controller=content.baseline)
    restless = f"{content.baseline} does not come to rest: ratios to it compare with a controller in this state."
    return [
        *([Text(restless, "caution")] if base and not comes_to_rest(base) else []),
        *_best(content),
        *corrected_table(content),
    ]


def _best(content: Content) -> list[Text]:
    """The controller that is clearly better than the baseline, by its share of the baseline's error."""
    leading = "equal_weight" if content.has("comparison") else "ratio"
    rows = {name: content.against(name) or content.row("ratios", controller=name) for name in content.controllers[1:]}
    ratios = {name: interval(row, leading) for name, row in rows.items() if row}
    if not ratios:
        return []
    best = min(ratios, key=lambda name: ratios[name].value)
    if verdict(ratios[best]) == "better":
        share = number(100.0 * ratios[best].value, 0)
        return [Text(f"{best} positions best: {share} % of the error of {content.baseline}.", "verdict")]
    return [Text(f"No controller is clearly better than {content.baseline}.", "verdict")]


def corrected_table(content: Content) -> list[Table]:
    """Each policy that corrects another controller than the baseline, against this controller."""
    rows = []
    for row in content.table("corrected").to_dict("records"):
        ratios = (shown(row, column) for column in ("ratio", "equal_weight", "ratio_sensor"))
        better, costs = number(100.0 * row["share_better"], 0), (number(row[column], 2) for column in COSTS)
        rows.append((str(row["controller"]), str(row["against"]), *ratios, better, *costs))
    errors, costs = ("mean error", "equal weights", "repeatability"), (each.word.lower() for each in COSTS.values())
    header = ("Policy", "corrects", *errors, "better in, %", *costs)
    return [Table("A policy ÷ what it corrects, on the same runs", header, rows, style="dense")] if rows else []
