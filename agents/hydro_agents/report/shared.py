"""Sections and blocks of several pages: who took part, what did not run, facts of the run."""

from __future__ import annotations

from hydro_agents.evaluation.metrics import COMPARED
from hydro_agents.report.content import Content, interval, shown, verdict
from hydro_agents.report.sections import Block, Code, Fold, Points, Text, section, words_table
from hydro_agents.running.limit_cycles import comes_to_rest
from hydro_agents.running.text import Table, duration, number

NOT_RUN = "not applicable"

COSTS = {column: metric for column, metric in COMPARED.items() if metric.cost}
"""Columns of a comparison with what a small error may cost."""


@section("")
def introduction(content: Content) -> list[Block]:
    """Controllers and baseline."""
    detects = ", and detection of the leak" if content.has("detection_summary") else ""
    text = (
        f"Positioning of a hydraulic servo axis while its piston seal leaks{detects}. Controllers: "
        f"{', '.join(content.controllers)}; baseline: {content.baseline}. All ran on the same plants, references and "
        "noise. Everything here is simulated; no real rig was measured."
    )
    return [Text(text, "soft")]


def problems(content: Content) -> list[Block]:
    """What failed or did not apply: one line for each failure, and for each participant that did not run everywhere."""
    errors: dict[str, str] = content.other("errors", {})
    status = content.table("status")
    lines = [f"Left out: {message}" for message in errors.values()]
    if len(status):
        who = "controller" if "controller" in status else "detector"
        for row in status[status["status"] == "failed"].to_dict("records"):
            lines.append(f"{row[who]} failed under {content.label(row['condition'])}: {row['message']}")
        for name, frame in status[status["status"] == NOT_RUN].groupby(who, sort=False):
            where = ", ".join(map(content.label, frame["condition"]))
            lines.append(f"{name} did not run under {where}: {frame['message'].iloc[0]}.")
    return [Fold("Some parts did not run", [Points(lines)], bool(errors), "caution")] if lines else []


# Findings -----------------------------------------------------------------------------------------------------------


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
    rows = {name: content.against(name) for name in content.controllers[1:]}
    ratios = {name: interval(row, "equal_weight") for name, row in rows.items() if row}
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
    compared = content.table("comparison")
    others = compared[compared["against"] != content.baseline] if len(compared) else compared
    for row in others.to_dict("records"):
        ratios = (shown(row, column) for column in ("ratio", "equal_weight", "ratio_sensor"))
        better, costs = number(100.0 * row["share_better"], 0), (number(row[column], 2) for column in COSTS)
        rows.append((str(row["controller"]), str(row["against"]), *ratios, better, *costs))
    errors, costs = ("mean error", "equal weights", "repeatability"), (each.word.lower() for each in COSTS.values())
    header = ("Policy", "corrects", *errors, "better in, %", *costs)
    return [Table("A policy ÷ what it corrects, on the same runs", header, rows, style="dense")] if rows else []


# Method -------------------------------------------------------------------------------------------------------------


@section("This run", needs=("protocol",))
def run(content: Content) -> list[Block]:
    """Facts, durations, conditions and settings of the run."""
    blocks: list[Block] = [Table("Facts of this run", ("Fact", "Value"), list(content.facts.items()), style="words")]
    timings: dict[str, float] = content.other("timings", {})
    if timings:
        rows = [(phase, duration(seconds)) for phase, seconds in timings.items()]
        blocks.append(Table("Time taken", ("Phase", "Time"), rows))
    if content.has("conditions"):
        blocks.append(Fold("All conditions", [words_table(content.table("conditions"))]))
    if content.has("configuration"):
        blocks.append(Fold("Configuration", [Code(content.other("configuration", ""))]))
    return blocks
