"""The page of every protocol of controllers (study, evaluation, robustness): errors and costs, relative to the first.

A part whose table is missing is left out: single runs stand on the page of a study, the map of
conditions on that of a protocol with several.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.evaluation.comparison import ALL
from hydro_agents.evaluation.metrics import ERROR, FRAMES_TEXT, METRICS, RETURN
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
    signal,
    time_panels,
    with_interval,
)
from hydro_agents.running.cases import Rollout
from hydro_agents.running.limit_cycles import JUDGED, LEAST_CYCLES, comes_to_rest
from hydro_agents.running.seeds import TEST_SEEDS
from hydro_agents.running.statistics import RESAMPLES
from hydro_agents.running.text import FAMILY_NAMES, capitalised, number, setting

FEW_PLANTS = 12  # with fewer plants the intervals are rough; the page says so

COSTS = tuple(metric for metric in METRICS.values() if metric.cost)
"""Metrics beside the errors: an error is no result without its cost."""

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

MANY = GROUPS["parameter"]  # it has a table of its own, because it has many conditions


class Example(NamedTuple):
    """One test episode under every controller."""

    title: str
    leak: float  # l/min at 100 bar
    runs: Mapping[str, Rollout]  # by controller
    case: int  # row of the runs


@drawn
def controllers_page(title: str, tables: Tables, examples: Sequence[Example] = (), configuration: str = "") -> Page:
    """The page.

    ``examples`` are the same episodes at every leak, ``configuration`` is YAML.
    """
    page, names = Page(title), names_of(tables)
    verdict(page, tables)
    page.text(
        f"Simulated: a servo axis whose piston seal leaks. {names[0]} is the baseline; every controller runs on the "
        "same plants, references and sensor noise. In brackets: 95 % intervals.",
        "soft",
    )
    errors(page, tables)
    problems(page, tables, "controller")
    if len(tables.get("conditions", ())) > 1 and "comparison" in tables:
        comparison(page, tables)
    by_leak(page, tables)
    by_kind(page, tables)
    single_runs(page, examples)
    method(page, tables)
    run_facts(page, tables, configuration)
    return page


def names_of(tables: Tables) -> list[str]:
    """Names of the controllers, the baseline first."""
    return tables["summary"]["controller"].unique().tolist()


def rows_of(tables: Tables, table: str, group: str) -> pd.DataFrame:
    """Rows of a group of ``summary`` or ``comparison`` (there: with the baseline)."""
    rows = tables.get(table, pd.DataFrame(columns=["controller", "against", "group", "value"]))
    rows = rows[rows["group"] == group]
    return rows[rows["against"] == names_of(tables)[0]] if "against" in rows else rows


# Verdict and overview -------------------------------------------------------------------------------------------------


def verdict(page: Page, tables: Tables) -> None:
    """The controller that is clearly better than the baseline, if there is one, and what makes this doubtful."""
    baseline, ratios = names_of(tables)[0], rows_of(tables, "comparison", ALL)
    if len(ratios):
        first = ratios.sort_values("equal_weight").iloc[0]
        if first["equal_weight_high"] < 1.0:
            share = number(100.0 * first["equal_weight"], 0)
            error = f"{share} % of the error of {baseline}, every kind of reference with the same weight"
            page.verdict(f"{first['controller']} positions best: {error}.", "good")
        else:
            page.verdict(f"No controller is clearly better than {baseline}.", "doubtful")
    for row in tables.get("limit_cycle_summary", pd.DataFrame()).to_dict("records"):
        if row["controller"] == baseline and not comes_to_rest(row):
            restless = f"{baseline} does not come to rest: ratios to it compare with a controller in this state."
            page.text(restless, "caution")
    cases = tables.get("cases", pd.DataFrame({"plant": [], "seed": []}))
    if 0 < cases["plant"].nunique() < FEW_PLANTS:
        few = f"{cases['plant'].nunique()} plants per leak and kind of reference are too few for a decision."
        page.text(f"A small run: {few}", "caution")
    if not cases["seed"].isin(TEST_SEEDS).all():
        page.text("Some seeds are no test seeds: a controller may have been trained on them.", "caution")


def errors(page: Page, tables: Tables) -> None:
    """Errors and costs of every controller, and ratios of policies to what they correct."""
    page.table(overview(tables), "Errors and costs over all runs")
    compared = tables.get("comparison", pd.DataFrame({"against": []}))
    corrected = compared[compared["against"] != names_of(tables)[0]]
    if len(corrected):
        index = corrected["controller"] + " ÷ " + corrected["against"]
        page.table(ratios_of(corrected).set_axis(index), "A policy over what it corrects, on the same runs")


def overview(tables: Tables) -> pd.DataFrame:
    """One row per controller over all runs: errors, ratios to the first one, costs, limit cycles."""
    names, rows = names_of(tables), rows_of(tables, "summary", ALL)
    means = rows.pivot(index="controller", columns="metric", values="mean").reindex(names)
    ratios = rows_of(tables, "comparison", ALL).set_index("controller").reindex(names)
    frame = {("error", "mean, mm"): means[ERROR]}
    if len(names) > 1:
        for name, column in ratios_of(ratios).items():
            frame[f"error ÷ {names[0]}'s", name] = column
    for metric in COSTS:
        if metric.name in means and means[metric.name].any():
            label = f"{metric.word.lower()}, {metric.shown_unit or metric.unit}"
            frame["cost", label] = metric.factor * means[metric.name]
    if RETURN in means:
        frame["reward", "return"] = means[RETURN]
    if "limit_cycle_summary" in tables:
        cycles = tables["limit_cycle_summary"].set_index("controller").reindex(names)
        for column, name in {"limit_cycles": "limit cycles", "standstills": "of", "failures": "failed"}.items():
            frame["at rest", name] = cycles[column]
        frame["at rest", "largest, µm"] = cycles["largest_amplitude_um"]
    return pd.DataFrame(frame)


def ratios_of(rows: pd.DataFrame) -> pd.DataFrame:
    """Ratios of errors in rows of the comparison; every kind of reference weighs the same."""
    return pd.DataFrame(
        {
            "equal weights": with_interval(rows, "equal_weight", 2),
            "of repeatability": with_interval(rows, "equal_weight_sensor", 2),
            "worst case": rows["worst_ratio"],
            "better in, %": 100.0 * rows["share_better"],
        }
    )


# Conditions -----------------------------------------------------------------------------------------------------------


def comparison(page: Page, tables: Tables) -> None:
    """The map of all conditions; those in the group with many follow in their own table."""
    page.heading("Comparison by condition")
    page.text(
        "A cell has a colour where the whole 95 % interval is below 1 (blue, better) or above it (orange). "
        "Bold: the best of its row.",
        "soft",
    )
    frame, kinds = heat_map(tables)
    many = frame.index.get_level_values(0) == MANY
    for rows, title in ((~many, "Ratio of errors, every kind of reference with the same weight"), (many, MANY)):
        if rows.any():
            page.table(frame[rows], title, dict.fromkeys(frame.columns[1:], 2), kinds[rows])


def heat_map(tables: Tables) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A row per condition: error of the baseline, ratio of each other controller; and the classes of the cells.

    A cell has a colour if its whole interval is on one side of 1; the strongest stands for a ratio of 2 or 1/2.
    """
    base, *names = names_of(tables)
    conditions = tables["conditions"]
    titles = list(dict.fromkeys([*GROUPS, *conditions["group"]]))
    conditions = conditions.sort_values("group", key=lambda groups: groups.map(titles.index), kind="stable")
    order = ["", *conditions["condition"]]
    summary = pd.concat([rows_of(tables, "summary", group) for group in (ALL, "condition")])
    compared = pd.concat([rows_of(tables, "comparison", group) for group in (ALL, "condition")])
    own = summary[(summary["controller"] == base) & (summary["metric"] == ERROR)].set_index("value")["mean"]
    compared = compared.set_index(["value", "controller"])
    ratios, low, high = (
        compared[f"equal_weight{end}"].unstack().reindex(index=order, columns=names) for end in ("", "_low", "_high")
    )
    strength = np.ceil(3.0 * np.minimum(np.abs(np.log2(ratios)), 1.0)).fillna(0.0).astype(int).astype(str)
    kinds = ("better-" + strength).where(high < 1.0, ("worse-" + strength).where(low > 1.0, ""))
    winners = ratios.eq(ratios.min(axis=1), axis=0) & (ratios < 1.0)
    kinds = kinds.where(~winners, kinds + " best")
    ratios.insert(0, f"{base}, mm", own.reindex(order))
    groups, labels = conditions["group"].replace(GROUPS), conditions["label"]
    ratios.index = kinds.index = pd.MultiIndex.from_arrays([["", *groups], ["all conditions", *labels]])
    return ratios, kinds


# Positioning ----------------------------------------------------------------------------------------------------------


def by_leak(page: Page, tables: Tables) -> None:
    """Errors and costs over the leak."""
    names, levels = names_of(tables), rows_of(tables, "summary", "level")
    if levels.empty:
        return
    page.heading("Errors and costs by leak")
    levels = levels.assign(value=levels["value"].astype(float))
    for metric in (METRICS[ERROR], *COSTS):
        rows = levels[levels["metric"] == metric.name]
        if metric.name == "failed" and not rows["mean"].any():
            continue
        axes = panel(ylabel=metric.label[0].lower() + metric.label[1:])
        draw(axes, rows, "value", "mean", names, factor=metric.factor)
        leak_axis(axes, rows["value"])
        axes.set_ylim(bottom=0.0)
        page.figure(axes, f"{metric.word} by leak")


def by_kind(page: Page, tables: Tables) -> None:
    """Ratios of errors to those of the baseline by kind of reference."""
    names, rows = names_of(tables), rows_of(tables, "comparison", "family")
    if len(rows):
        page.heading("By kind of reference")
        rows = rows.assign(value=rows["value"].replace(FAMILY_NAMES))
        axes = panel(height=height_of(rows["value"].nunique(), len(names)), xlabel=f"error ÷ error of {names[0]}")
        draw(axes, rows, "value", "ratio", names)
        axes.axvline(1.0, color=INK, linewidth=1.0)
        axes.set_xlim(left=0.0)
        page.figure(axes, "Ratio of errors by kind of reference")


def single_runs(page: Page, examples: Sequence[Example]) -> None:
    """Position and reference, error in mm, command in V of each example, folded by leak."""
    if examples:
        page.heading("Single runs")
        page.text("A controller that sees the reference ahead may start before a step.", "soft")
    for leak in sorted({example.leak for example in examples}):
        with page.fold(f"Leak of {setting(leak)} l/min at 100 bar"):
            for example in examples:
                if example.leak == leak:
                    page.figure(example_axes(example), capitalised(example.title))


def example_axes(example: Example) -> list[Axes]:
    """The panels of an example."""
    axes = time_panels(("position, mm", "error, mm", "command, V"), 4.6)
    for name, run in example.runs.items():
        reference, position = 1e3 * run.reference[example.case], 1e3 * run.position[example.case]
        size = number(np.abs(reference - position).mean())
        signal(axes[0], run.time, position, label=f"{name}, mean error {size} mm")
        signal(axes[1], run.time, reference - position)
        signal(axes[2], run.time, 10.0 * run.command[example.case])
    signal(axes[0], run.time, reference, color=INK, linestyle="-", linewidth=0.8, label="reference")
    return axes


# Method --------------------------------------------------------------------------------------------------------------


def method(page: Page, tables: Tables) -> None:
    """What was run, on which seeds, and what the terms mean."""
    page.heading("How it was measured")
    page.points(
        [
            f"Intervals of means and ratios: 95 %, bootstrap over plants ({RESAMPLES} resamplings) and training seeds.",
            "A seed fixes plant, reference and noise. Ratio: mean error over that of the baseline on the same runs; "
            "with equal weights: geometric mean of the ratios of all kinds of reference.",
            FRAMES_TEXT,
            f"At rest: without sensor noise, after a small step and back. A limit cycle has at least {LEAST_CYCLES} "
            f"periods within {JUDGED:g} s, is larger than one step of the position sensor, and does not decay.",
        ]
    )
    if "cases" in tables:
        columns = {
            "runs": ("seed", "size"),
            "kinds of reference": ("family", "nunique"),
            "plants for each kind": ("plant", "nunique"),
            "training seeds": ("training_seed", "nunique"),
            "failed runs": ("failed", "sum"),
        }
        page.table(tables["cases"].groupby("controller", sort=False).agg(**columns).astype(int), "What was run")
    with page.fold("Metrics of a run"):
        about = {metric.name: (metric.word, metric.meaning, metric.unit) for metric in METRICS.values()}
        frame = pd.DataFrame.from_dict(about, orient="index", columns=["metric", "meaning", "unit"])
        page.table(frame, "By columns of the files", words=True)
