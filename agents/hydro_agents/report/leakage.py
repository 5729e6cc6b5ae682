"""The page of the leakage protocol: detectors of leaks under every condition."""

from __future__ import annotations

import json

import numpy as np
from markupsafe import Markup

from hydro_agents.detection.detector import CAUSE_OF_FAULT, Cause
from hydro_agents.evaluation.leak_protocol import DRAWN, HEALTHY
from hydro_agents.report.content import Content, interval, interval_text
from hydro_agents.report.leak_findings import findings_of
from hydro_agents.report.leak_plots import (
    coverage_plots,
    detection_plot,
    fault_plots,
    masking_plot,
    masking_rows,
    motion_plots,
    reliability_plot,
    size_plot,
)
from hydro_agents.report.palette import STRONGEST
from hydro_agents.report.sections import Block, Fold, Points, Text, cards, section
from hydro_agents.report.shared import problems
from hydro_agents.running.text import Cell, Table, number, setting

PAGE_FILE = "leakage.html"

LEAKAGE = (
    "leak_introduction",
    "leak_findings",
    "smallest_leak",
    "motions",
    "faults",
    "reliability",
    "masking",
    "shares_and_sizes",
    "leak_method",
    "run",
)
"""Sections of the page, in order."""

SHOWN_LEAK = 0.3
"""l/min at 100 bar, of the table of verdicts with a leak."""


@section("")
def leak_introduction(content: Content) -> list[Block]:
    """What the detectors read and know."""
    return [
        Text(
            "Leakage past the piston of a hydraulic servo axis, read from position, both chamber pressures, spool "
            f"position and command. Detectors: {', '.join(content.detectors)}. A head is a small neural network that "
            "was trained on simulated axes; an estimator fits a simulation of the axis to the readings. The detectors "
            "know the data sheet of the axis, not the axis itself. Leaks are in l/min at 100 bar. Everything here is "
            "simulated; no real axis was measured.",
            "soft",
        )
    ]


@section("Findings", needs=("detection",), heading=False)
def leak_findings(content: Content) -> list[Block]:
    """The findings as cards, their limits, and what did not run."""
    return [
        cards(findings_of(content)),
        Text(
            Markup(
                "These sizes are those of faults in service, not of acceptance tests. Makers accept 0.06&nbsp;ml/min "
                "for a new seal of a 40&nbsp;mm bore; a seal counts as healthy here up to 0.03&nbsp;l/min, 500 times "
                "as much. A seal that passes here may fail an acceptance test."
            ),
            "caution",
        ),
        *problems(content),
    ]


@section("Smallest detectable leak, and accuracy of its size", needs=("detection", "sizes"))
def smallest_leak(content: Content) -> list[Block]:
    """Shares and sizes over the leak."""
    return [*detection_plot(content), *size_plot(content)]


@section("Other motions and controllers", needs=("detection",))
def motions(content: Content) -> list[Block]:
    """Detection and false alarms under other motions and controllers."""
    plots = motion_plots(content)
    note = (
        "Windows begin anywhere in a longer run, except under the controllers. The table of conditions below shows "
        "the training of the head."
    )
    return [Text(note), *plots] if plots else []


@section("Other faults", needs=("detection",))
def faults(content: Content) -> list[Block]:
    """Faults that are mistaken for a leak, and the verdicts for each."""
    plots = fault_plots(content)
    tables = confusion_tables(content)
    if not plots:
        return []
    note = Text("Blue: correct; orange: wrong; grey: cannot tell. With a leak, “internal leak” is correct.", "soft")
    return [
        Text("A detector is worth little if a worn valve sends the mechanic to the seal."),
        *plots,
        *(Fold(caption, [table, note], table is next(iter(tables.values()))) for caption, table in tables.items()),
    ]


@section("Reliability of probabilities and intervals", needs=("detection",))
def reliability(content: Content) -> list[Block]:
    """Calibration of the probability, and coverage of the intervals."""
    return [*reliability_plot(content), *coverage_plots(content)]


@section("Does better control hide the leak?", needs=("masking",))
def masking(content: Content) -> list[Block]:
    """Detection beside position error, by controller."""
    plots = masking_plot(content)
    note = "Feedback hides the leak from the position error, not from the pressures and the valve."
    return [Text(note), *plots, masking_table(content)] if plots else []


@section("All figures", needs=("detection", "sizes"))
def shares_and_sizes(content: Content) -> list[Block]:
    """Every share and every size."""
    return [
        Fold("Detection and false alarms", detection_tables(content)),
        Fold("Sizes and intervals", size_tables(content)),
    ]


@section("How it was measured", needs=("detection",))
def leak_method(content: Content) -> list[Block]:
    """Seeds, thresholds, measures."""
    return [
        Points(
            [
                "A seed fixes plant, reference and noise; every condition and leak uses the same seeds. They are test "
                "seeds: no training, tuning or threshold used them.",
                "Threshold at 1 % false alarms: from healthy windows of validation seeds. Threshold in use: the "
                "detector's own, if it has one.",
                "False alarms per hour: for consecutive windows without gaps.",
                "Size error: root mean square of log10(estimate ÷ truth), over windows in which the detector gives a "
                "size.",
                "Bound: Cramér–Rao, median over axes, with all drawn quantities of the task unknown; no unbiased "
                "method has a smaller error.",
                "Shares: 95 % Wilson intervals.",
            ]
        )
    ]


# Tables -------------------------------------------------------------------------------------------------------------


def level_text(level: float) -> str:
    """A leak level as text."""
    return "healthy" if level == HEALTHY else f"{setting(level)} l/min" if level > 0.0 else "drawn"


def confusion_tables(content: Content) -> dict[str, Table]:
    """Verdicts of each detector for each fault, with a healthy and with a leaking seal, by caption."""
    table = content.table("verdicts")
    verdicts = tuple(name for name in table if name not in ("detector", "condition", "level"))
    conditions = [content.base, *content.in_groups("fault", "plant", "rig")]
    found = {}
    for detector in content.detectors:
        for level in sorted(level for level in table["level"].unique() if level in (HEALTHY, SHOWN_LEAK)):
            rows: list[tuple[str | Cell, ...]] = []
            for condition in conditions:
                shares = content.cell("verdicts", detector, condition, level)
                right = right_verdicts(content, condition, level)
                if shares:
                    cells = (_share_cell(verdict, right, float(shares[verdict])) for verdict in verdicts)
                    rows.append((content.label(condition), *cells))
            beside = "healthy seal" if level == HEALTHY else f"with a leak of {setting(level)} l/min"
            if len(rows) > 1:
                caption = f"{detector}: {beside}; share of windows, %"
                found[caption] = Table("", ("True state", *verdicts), rows, style="heat")
    return found


def _share_cell(verdict: str, right: tuple[str, ...], share: float) -> Cell:
    meaning = "better" if verdict in right else "silent" if verdict == Cause.UNKNOWN.word else "worse"
    return Cell(number(100.0 * share, 0) if share > 0.0 else "", meaning, round(STRONGEST * share))


def right_verdicts(content: Content, condition: str, level: float) -> tuple[str, ...]:
    """Correct verdicts: the leak if there is one, else the fault, else none."""
    if level > HEALTHY:
        return (Cause.INTERNAL_LEAK.word,)
    changes = content.conditions["changes"].get(condition)
    faults = json.loads(changes).get("faults", {}) if isinstance(changes, str) and changes else {}
    return tuple(CAUSE_OF_FAULT[name].word for name in faults) or (Cause.NONE.word,)


def detection_tables(content: Content) -> list[Table]:
    """Share of windows reported as a leak, by condition and level; one table per detector."""
    tables = []
    for detector in content.detectors:
        mine = content.rows("detection", detector=detector)
        levels = sorted(level for level in mine["level"].unique() if level != DRAWN)
        rows = []
        for condition in mine["condition"].unique():
            cells = {level: content.cell("detection", detector, condition, level) for level in levels}
            if any(cells.values()):
                shares = [number(interval(cell, "flagged", 100.0).value, 1) for cell in cells.values()]
                healthy = content.cell("detection", detector, condition, HEALTHY)
                hourly, silent = (float(healthy.get(key, np.nan)) for key in ("per_hour", "cannot_tell"))
                rows.append((content.label(str(condition)), *shares, number(hourly, 0), number(100.0 * silent, 1)))
        header = ("Condition", *map(level_text, levels), "false alarms per hour", "cannot tell, healthy")
        caption = f"{detector}: share of windows reported as a leak past the piston, %"
        tables.append(Table(caption, header, rows, style="dense"))
    return tables


def size_tables(content: Content) -> list[Table]:
    """Size error, its ratio to the bound, and coverage of the intervals; one table per detector."""
    tables = []
    for detector in content.detectors:
        mine = content.rows("sizes", detector=detector)
        mine = mine[mine["level"] != HEALTHY]
        rows = [
            (
                f"{content.label(str(row['condition']))}, {level_text(row['level'])}",
                number(row["rms_log10"], 3),
                number(row["median_error_lpm"], 4),
                number(row["bound_lpm"], 4),
                number(row["ratio_to_bound"], 1),
                interval_text(interval(row, "coverage", 100.0), decimals=0),
                number(100.0 * row["told"] / row["windows"], 0),
            )
            for row in mine.to_dict("records")
        ]
        header = (
            "Condition, leak", "error, RMS log10", "median error, l/min", "bound, l/min", "error ÷ bound",
            "interval contains the true size, %", "answered, %",
        )  # fmt: skip
        tables.append(Table(f"{detector}: size of the leak", header, rows, style="dense"))
    return tables


def masking_table(content: Content) -> Table:
    """Detection of small leaks, position error and bound, one row per controller."""
    table = masking_rows(content)
    shares = table[table["level"] <= 0.3].pivot_table(
        index="condition", columns=["detector", "level"], values="at_1_percent", sort=False
    )
    # A single controller allows no comparison.
    shares = shares.loc[:, shares.notna().sum() >= min(2, len(shares))]
    columns = [(name, level) for name in content.detectors for level in sorted(table["level"].unique())]
    columns = [column for column in columns if column in shares.columns]
    rows = []
    for condition, frame in table.groupby("condition", sort=False):
        bounds = {row["level"]: row["bound_lpm"] for row in frame.to_dict("records")}
        rows.append(
            (
                str(frame["acting"].iloc[0]),
                number(float(frame["error_mm"].mean()), 3),
                number(bounds.get(0.3, np.nan), 4),
                *(number(100.0 * float(shares.loc[condition, column]), 0) for column in columns),
            )
        )
    sizes = (f"{name}: {setting(level)}" for name, level in columns)
    header = ("Controller", "error, mm", "bound at 0.3, l/min", *sizes)
    caption = "Found at 1 % false alarms, %, by size of the leak in l/min"
    return Table(caption, header, rows, style="dense")
