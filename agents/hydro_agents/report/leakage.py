"""The page of the leakage protocol: detectors of leaks under every condition."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from hydro_agents.evaluation.leak_protocol import HEALTHY
from hydro_agents.report.content import Content, shown
from hydro_agents.report.leak_plots import (
    coverage_plots,
    detection_plot,
    fault_plots,
    motion_plots,
    reliability_plot,
    size_plot,
)
from hydro_agents.report.sections import Block, Points, Text, section
from hydro_agents.report.shared import problems
from hydro_agents.running.text import Table, number, setting

PAGE_FILE = "leakage.html"

LEAKAGE = (
    "leak_introduction",
    "leak_findings",
    "smallest_leak",
    "motions",
    "faults",
    "reliability",
    "leak_method",
    "run",
)
"""Sections of the page, in order."""

SURE, TOO_OFTEN = 95.0, 10.0
"""Percentages of windows: a leak counts as found; a condition is named for its false alarms."""

MOST_NAMED = 5  # conditions in a cell


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
    """The smallest leak that is found, the findings on each detector, their limits, and what did not run."""
    limits = Markup(
        "These sizes are those of faults in service, not of acceptance tests. Makers accept 0.06&nbsp;ml/min for a new "
        "seal of a 40&nbsp;mm bore; a seal counts as healthy here up to 0.03&nbsp;l/min, 500 times as much. A seal "
        "that passes here may fail an acceptance test."
    )
    smallest = np.nanmin([*(smallest_found(content, name) for name in content.detectors), np.inf])
    duration = setting(content.conditions["duration_s"][content.base])
    sentence = f"A leak of {setting(smallest)} l/min is found within {duration} s of ordinary motion."
    if not np.isfinite(smallest):
        sentence = "No size of leak is found reliably."
    return [Text(sentence, "verdict"), findings_table(content), Text(limits, "caution"), *problems(content)]


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
    """Faults that are mistaken for a leak."""
    plots = fault_plots(content)
    note = "A detector is worth little if a worn valve sends the mechanic to the seal. verdicts.csv holds all verdicts."
    return [Text(note), *plots] if plots else []


@section("Reliability of probabilities and intervals", needs=("detection",))
def reliability(content: Content) -> list[Block]:
    """Calibration of the probability, and coverage of the intervals."""
    return [*reliability_plot(content), *coverage_plots(content)]


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


def smallest_found(content: Content, detector: str) -> float:
    """The smallest leak such that it and every larger one is found in 95 % of the windows; NaN if there is none."""
    table = content.rows("detection", detector=detector, condition=content.base)
    shares = table[table["level"] > HEALTHY].set_index("level")["at_1_percent"].sort_index()
    missed = shares.index[100.0 * shares < SURE].max() if len(shares) else np.nan
    return float(shares.index[~(shares.index <= missed)].min())


def findings_table(content: Content) -> Table:
    """Each detector: smallest leak, false alarms, worst condition, confusions, and where it stays silent."""
    rows = []
    for name in content.detectors:
        smallest = smallest_found(content, name)
        healthy = content.row("detection", detector=name, condition=content.base, level=HEALTHY)
        own = content.rows("detection", detector=name)
        changed = own[own["condition"].isin(content.in_groups("fault", "plant", "rig")) & (own["level"] == HEALTHY)]
        shares = 100.0 * changed.set_index("condition")["flagged"].sort_values(ascending=False, kind="stable")
        silent = own[own["cannot_tell"] > 0.5]["condition"].unique()
        rows.append(
            (
                name,
                setting(smallest) if np.isfinite(smallest) else "none",
                shown(healthy, "flagged", 1, 100.0),
                number(healthy.get("per_hour", np.nan), 0),
                _named(
                    [
                        f"{content.label(where)} {number(share, 0)} %"
                        for where, share in shares.items()
                        if share > TOO_OFTEN
                    ]
                ),
                _named([content.label(where) for where in silent]),
            )
        )
    header = (
        "Detector", f"leak found in {SURE:.0f} % of the windows, at 1 % false alarms, l/min",
        "false alarms, % of healthy windows", "per hour",
        f"mistaken for a leak in over {TOO_OFTEN:.0f} % of the windows", "“cannot tell” in over half of the windows",
    )  # fmt: skip
    return Table("What each detector finds, and where it is wrong or silent", header, rows, style="words")


def _named(labels: list[str]) -> str:
    """The first of some conditions, and the number of the others."""
    more = f" and {len(labels) - MOST_NAMED} more" if len(labels) > MOST_NAMED else ""
    return f"{', '.join(labels[:MOST_NAMED])}{more}" or "none"


def level_text(level: float) -> str:
    """A leak level as text."""
    return "healthy" if level == HEALTHY else f"{setting(level)} l/min" if level > 0.0 else "drawn"
