"""The page of the leakage protocol: detectors of leaks under every condition."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from hydro_agents.evaluation.leak_protocol import HEALTHY
from hydro_agents.report.kit import (
    INK,
    Page,
    Tables,
    draw,
    drawn,
    height_of,
    leak_axis,
    panel,
    problems,
    run_facts,
    with_interval,
)
from hydro_agents.running.text import listed, number, setting

SURE, TOO_OFTEN = 95.0, 10.0
"""Percentages of windows: a leak counts as found; a condition is named for its false alarms."""

SMALL = 0.3  # l/min at 100 bar; the leak at which conditions are compared
MOST_NAMED = 5  # conditions in a cell
CHANGED = ("fault", "plant", "rig")  # groups of conditions with another fault or another plant


@drawn
def leakage_page(title: str, tables: Tables, base: str) -> Page:
    """The page.

    ``base`` is the condition with all leaks.
    """
    page, conditions = Page(title), tables["conditions"].set_index("condition")
    found = tables["detection"].assign(label=tables["detection"]["condition"].map(conditions["label"]))
    names = found["detector"].unique().tolist()
    smallest = pd.Series({name: smallest_found(found, name, base) for name in names}).min()
    if np.isfinite(smallest):
        duration = setting(conditions["duration_s"][base])
        page.verdict(f"A leak of {setting(smallest)} l/min is found within {duration} s of ordinary motion.", "good")
    else:
        page.verdict("No size of leak is found reliably.", "doubtful")
    page.text(
        f"Simulated; {listed(names)} read position, both chamber pressures, spool position and command, and know the "
        "data sheet of the axis, not the axis. Leaks are in l/min at 100 bar across the piston.",
        "soft",
    )
    page.table(findings(tables, names, base), "What each detector finds, and where it is wrong or silent", words=True)
    page.text(
        "These are sizes of faults in service, not of acceptance tests: makers accept 0.06 ml/min for a new seal of a "
        "40 mm bore.",
        "caution",
    )
    problems(page, tables, "detector")
    page.heading("Smallest detectable leak, and accuracy of its size")
    by_size(page, tables, names, base)
    page.heading("Other motions, controllers and faults")
    motions, faults = in_groups(conditions, "motion", "controller"), in_groups(conditions, *CHANGED)
    groups = {"other motions and controllers": [base, *motions], "other faults and plants": faults}
    for words, chosen in groups.items():
        of = found[found["condition"].isin(chosen)]
        for seal, level in {f"Leak of {SMALL} l/min": SMALL, "Healthy seal": HEALTHY}.items():
            rows = of[of["level"] == level]
            by_condition(page, f"{seal} under {words}", "windows reported as leaking, %", rows, "flagged", names)
    if "sizes" in tables:
        page.heading("Reliability of the intervals")
        sizes = tables["sizes"].assign(label=tables["sizes"]["condition"].map(conditions["label"]))
        label = f"intervals that contain the leak of {SMALL} l/min, %"
        by_condition(page, "Coverage of the 90 % intervals", label, sizes[sizes["level"] == SMALL], "coverage", names)
    page.heading("How it was measured")
    page.points(
        [
            "A seed fixes plant, reference and noise; every condition and leak uses the same seeds, and no training, "
            "tuning or threshold used them.",
            "Threshold at 1 % false alarms: from healthy windows of validation seeds. Threshold in use: the detector's "
            "own, if it has one. False alarms per hour: for consecutive windows without gaps.",
            "Size error: root mean square of log10(estimate ÷ truth) over windows with an estimate; 0.05: 12 %.",
            "Bound: Cramér–Rao, median over axes, with all drawn quantities of the task unknown.",
            "Shares: 95 % Wilson intervals.",
        ]
    )
    run_facts(page, tables)
    return page


def in_groups(conditions: pd.DataFrame, *groups: str) -> list[str]:
    """Names of the conditions of some groups, in order of the protocol."""
    return conditions.index[conditions["group"].isin(groups)].tolist()


def smallest_found(found: pd.DataFrame, detector: str, base: str) -> float:
    """The smallest leak such that it and every larger one is found in 95 % of the windows; NaN if there is none."""
    rows = found[(found["detector"] == detector) & (found["condition"] == base) & (found["level"] > HEALTHY)]
    shares = rows.set_index("level")["at_1_percent"].sort_index()
    missed = shares.index[100.0 * shares < SURE].max() if len(shares) else np.nan
    return shares.index[~(shares.index <= missed)].min()


def findings(tables: Tables, names: Sequence[str], base: str) -> pd.DataFrame:
    """Each detector: smallest leak, false alarms, conditions that it takes for a leak, and where it stays silent."""
    found, conditions = tables["detection"], tables["conditions"].set_index("condition")
    labels, changed = conditions["label"], in_groups(conditions, *CHANGED)
    rows = {}
    for name in names:
        own = found[found["detector"] == name]
        healthy = own[own["level"] == HEALTHY].set_index("condition")
        shares = 100.0 * healthy["flagged"].reindex(changed).dropna().sort_values(ascending=False, kind="stable")
        mistaken = [f"{labels[where]} {number(share, 0)} %" for where, share in shares.items() if share > TOO_OFTEN]
        silent = [labels[where] for where in own[own["cannot_tell"] > 0.5]["condition"].unique()]
        smallest, quiet = smallest_found(found, name, base), healthy.reindex([base])
        rows[name] = {
            f"leak found in {SURE:.0f} % of the windows, at 1 % false alarms, l/min": setting(smallest)
            if np.isfinite(smallest)
            else "none",
            "false alarms, % of healthy windows": with_interval(quiet, "flagged", 1, 100.0).iloc[0],
            "false alarms per hour": number(quiet["per_hour"].iloc[0], 0),
            f"mistaken for a leak in over {TOO_OFTEN:.0f} % of the windows": named(mistaken),
            "“cannot tell” in over half of the windows": named(silent),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def named(labels: Sequence[str]) -> str:
    """The first of some conditions, and the number of the others."""
    more = f" and {len(labels) - MOST_NAMED} more" if len(labels) > MOST_NAMED else ""
    return f"{', '.join(labels[:MOST_NAMED])}{more}" or "none"


def by_size(page: Page, tables: Tables, names: Sequence[str], base: str) -> None:
    """Share found at 1 % false alarms, and error of the size beside its bound, over the leak."""
    rows = tables["detection"].query("condition == @base and level > @HEALTHY").sort_values("level")
    axes = panel(ylabel="windows in which it is found, %", ylim=(0.0, 103.0))
    draw(axes, rows, "level", "at_1_percent", names, "detector", 100.0)
    leak_axis(axes, rows["level"])
    page.figure(axes, "Leaks found at 1 % false alarms, by size", "Bars: 95 % interval.")
    if "sizes" not in tables:
        return
    sizes = tables["sizes"].query("condition == @base and level > @HEALTHY").sort_values("level")
    if not sizes["rms_log10"].notna().any():  # no detector gives a size
        return
    axes = panel(ylabel="error of the size, RMS of log10", ylim=(0.0, 1.1 * sizes["rms_log10"].max()))
    draw(axes, sizes, "level", "rms_log10", names, "detector")
    bound = sizes.dropna(subset=["bound_rms_log10"]).drop_duplicates("level")
    axes.plot(bound["level"], bound["bound_rms_log10"], ":", color=INK, label="Cramér–Rao bound")
    leak_axis(axes, sizes["level"])
    page.figure(axes, "Error of the estimated size, by leak")


def by_condition(page: Page, title: str, unit: str, rows: pd.DataFrame, column: str, names: Sequence[str]) -> None:
    """A share of the windows by condition (``label``), from top to bottom."""
    rows = rows.dropna(subset=[column])
    if len(rows):
        axes = panel(height=height_of(rows["label"].nunique(), len(names)), xlabel=unit)
        draw(axes, rows, "label", column, names, "detector", 100.0)
        page.figure(axes, title)
