"""The page of every protocol of controllers (study, evaluation, robustness): errors and costs, relative to the first.

A part whose table is missing is left out: single runs, detection and training stand on the page of a study, the map of
conditions on that of a protocol with several.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.evaluation.comparison import ALL
from hydro_agents.evaluation.metrics import COMPARED, ERROR, FRAMES_TEXT, METRICS
from hydro_agents.report.kit import INK, Page, draw, drawn, height_of, leak_axis, panel, panels, signal, with_interval
from hydro_agents.report.parts import facts_of, learning_axes, problems, run_facts
from hydro_agents.running.limit_cycles import JUDGED, LEAST_CYCLES, amplitude_text, comes_to_rest
from hydro_agents.running.seeds import TEST_SEEDS
from hydro_agents.running.statistics import RESAMPLES
from hydro_agents.running.text import capitalised, family_name, number, setting, span
from hydro_env.types import Floats

FEW_PLANTS = 12
"""With fewer plants the intervals are rough; the page says so."""

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

FOLDED = GROUPS["parameter"]  # because it has many conditions

DETECTION = {
    "auroc": ("Area under the ROC curve", 1.0),
    "threshold": ("Threshold of the leak probability", 1.0),
    "false_alarm_rate": ("False alarms at this threshold, %", 100.0),
    "detection_rate_moderate": ("Moderate and severe leaks flagged at this threshold, %", 100.0),
    "detection_rate_moderate_at_1_percent": ("The same at a threshold with 1 % false alarms here, %", 100.0),
    "median_size_error_factor": ("Size: factor of error, half of the leaks within", 1.0),
    "p90_size_error_factor": ("Size: factor of error, nine in ten within", 1.0),
    "healthy_episodes": ("Healthy episodes", 1),
    "leaking_episodes": ("Leaking episodes", 1),
}
"""Rows of the summary of the detection: name, and factor."""


@dataclass(frozen=True)
class Example:
    """One test episode under every controller. Arrays (T,)."""

    title: str
    time: Floats  # s
    reference: Floats  # m
    position: dict[str, Floats]  # controller → m
    command: dict[str, Floats]  # controller → fraction of 10 V
    leak: float = 0.0  # l/min at 100 bar


@drawn
def controllers_page(
    title: str,
    tables: Mapping[str, pd.DataFrame],
    *,
    examples: Sequence[Example] = (),
    timings: Mapping[str, float] | None = None,
    configuration: str = "",
) -> Page:
    """The page.

    Args:
        title: of the protocol.
        tables: of the run, by the names of their CSV files.
        examples: the same episodes at every leak.
        timings: s, by phase.
        configuration: YAML text.
    """
    facts = facts_of(tables)
    page, names = Page(title), names_of(tables)
    verdict(page, tables)
    page.text(
        f"Simulated: a servo axis whose piston seal leaks. {names[0]} is the baseline; every controller runs on the "
        "same plants, references and sensor noise. In brackets: 95 % intervals.",
        "soft",
    )
    page.table(overview(tables), "Errors and costs over all runs")
    corrections(page, tables)
    conditions = tables.get("conditions", pd.DataFrame(columns=["condition", "label"]))
    problems(page, tables.get("status", pd.DataFrame()), "controller", conditions)
    if len(conditions) > 1 and "comparison" in tables:
        comparison(page, tables)
    by_leak(page, tables)
    by_kind(page, tables)
    single_runs(page, examples)
    if "detection_summary" in tables:
        detection(page, tables)
    if "training_curve" in tables:
        curve = tables["training_curve"]
        page.heading("Training")
        axes = learning_axes(curve, names[0], float(curve["first_mean_error_mm"].iloc[0]), names)
        note = "Plants of the validation. Line: median of the training seeds; bars: from the lowest to the highest."
        page.figure(axes, f"Error while learning, over that of {names[0]}", note)
    method(page, tables)
    run_facts(page, facts, timings, configuration, tables.get("conditions"))
    return page


def names_of(tables: Mapping[str, pd.DataFrame]) -> list[str]:
    """Names of the controllers, the baseline first."""
    return [str(name) for name in tables["summary"]["controller"].unique()]


def rows_of(tables: Mapping[str, pd.DataFrame], table: str, group: str) -> pd.DataFrame:
    """Rows of a group of ``summary`` or ``comparison`` (there: with the baseline)."""
    rows = tables.get(table, pd.DataFrame(columns=["controller", "against", "group", "value"]))
    rows = rows[rows["group"] == group]
    return rows[rows["against"] == names_of(tables)[0]] if "against" in rows else rows


# Verdict and overview -------------------------------------------------------------------------------------------------


def verdict(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
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


def overview(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """One row per controller over all runs: errors, ratios to the first one, worst runs, costs, limit cycles."""
    names, rows = names_of(tables), rows_of(tables, "summary", ALL)
    means = rows.pivot(index="controller", columns="metric", values="mean").reindex(names)
    worst = rows[rows["metric"] == ERROR].set_index("controller")["worst"].reindex(names)
    ratios = rows_of(tables, "comparison", ALL).set_index("controller").reindex(names)
    frame = {("error", "mean, mm"): means[ERROR], ("error", "worst run, mm"): worst}
    if len(names) > 1:
        above = f"error ÷ {names[0]}'s"
        frame[above, "equal weights"] = with_interval(ratios, "equal_weight", 2)
        frame[above, "of repeatability"] = with_interval(ratios, "equal_weight_sensor", 2)
        frame[above, "worst case"] = ratios["worst_ratio"]
        frame[above, "better in, %"] = 100.0 * ratios["share_better"]
    for metric in COSTS:
        if metric.name in means and means[metric.name].any():
            label = f"{metric.word.lower()}, {metric.shown_unit or metric.unit}"
            frame["cost", label] = metric.factor * means[metric.name]
    cycles = tables.get("limit_cycle_summary", pd.DataFrame()).to_dict("records")
    if cycles:
        texts = {row["controller"]: _at_rest(row) for row in cycles}
        frame["at rest", "limit cycles"] = pd.Series(texts).reindex(names)
    return pd.DataFrame(frame)


def _at_rest(row: Mapping[str, float]) -> str:
    size = f" (to {amplitude_text(row['largest_amplitude_um'])})" if row["limit_cycles"] else ""
    failed = f", {row['failures']} failed" if row["failures"] else ""
    return f"{row['limit_cycles']} of {row['standstills']}{size}{failed}"


def corrections(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """Each policy that corrects another controller than the baseline, against this controller."""
    compared = tables.get("comparison", pd.DataFrame(columns=["against"]))
    table = compared[compared["against"] != names_of(tables)[0]]
    if table.empty:
        return
    frame = pd.DataFrame({"policy": table["controller"], "corrects": table["against"]})
    columns = {"ratio": "mean error", "equal_weight": "equal weights", "ratio_sensor": "repeatability"}
    for column, name in columns.items():
        frame[name] = with_interval(table, column)
    frame["better in, %"] = 100.0 * table["share_better"]
    for column, metric in COMPARED.items():
        if metric.cost:
            frame[metric.word.lower()] = table[column]
    page.table(frame.set_index("policy"), "A policy ÷ what it corrects, on the same runs", {"better in, %": 0})


# Conditions -----------------------------------------------------------------------------------------------------------


def comparison(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """The maps of all conditions, and limit cycles under them."""
    page.heading("Comparison by condition")
    page.text(
        "A cell has a colour where the whole 95 % interval is below 1 (blue, better) or above it (orange). "
        "Bold: the best of its row.",
        "soft",
    )
    put_map(page, tables, "equal_weight", "Ratio of errors, every kind of reference with the same weight")
    with page.fold("The same in the frame of the sensor (repeatability)"):
        put_map(page, tables, "equal_weight_sensor", "Ratio of errors in the frame of the sensor, equal weights")
    with page.fold("The same with mean errors, which steps dominate"):
        put_map(page, tables, "ratio", "Ratio of mean errors")
    cycles = tables.get("limit_cycles", pd.DataFrame())
    counts = cycles_by_condition(cycles, names_of(tables)) if len(cycles) else cycles
    if len(counts):
        with page.fold("Limit cycles by condition; none under the others"):
            page.table(counts.rename(index=tables["conditions"].set_index("condition")["label"]))


def put_map(page: Page, tables: Mapping[str, pd.DataFrame], column: str, caption: str) -> None:
    """The map of a column of the table ``comparison``; the group with many conditions is folded."""
    frame, kinds = heat_map(tables, column)
    many, decimals = frame.index.get_level_values(0) == FOLDED, dict.fromkeys(frame.columns[1:], 2)
    page.table(frame[~many], caption, decimals, kinds[~many])
    if many.any():
        with page.fold(FOLDED):
            page.table(frame[many].droplevel(0), "", decimals, kinds[many].droplevel(0))


def heat_map(tables: Mapping[str, pd.DataFrame], column: str) -> tuple[pd.DataFrame, pd.DataFrame]:
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
    wide = [compared[f"{column}{end}"].unstack().reindex(index=order, columns=names) for end in ("", "_low", "_high")]
    ratios, low, high = wide
    strength = np.ceil(3.0 * np.minimum(np.abs(np.log2(ratios)), 1.0)).fillna(0.0).astype(int).astype(str)
    kinds = ("better-" + strength).where(high < 1.0, ("worse-" + strength).where(low > 1.0, ""))
    winners = ratios.eq(ratios.min(axis=1), axis=0) & (ratios < 1.0)
    kinds = kinds.where(~winners, kinds + " best")
    ratios.insert(0, f"{base}, mm", own.reindex(order))
    index = [("", "all conditions")]
    for group, label in zip(conditions["group"], conditions["label"], strict=True):
        index.append((GROUPS.get(group, group), label))
    for frame in (ratios, kinds):
        frame.index = pd.MultiIndex.from_tuples(index)
    return ratios, kinds


def cycles_by_condition(cycles: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Limit cycles of standstills under every condition in which any controller has one."""
    some = cycles[cycles.groupby("condition")["limit_cycle"].transform("sum") > 0]
    counts = some.groupby(["condition", "controller"], sort=False)["limit_cycle"].agg(["sum", "count"]).astype(int)
    texts = counts["sum"].astype(str) + " of " + counts["count"].astype(str)
    return texts.unstack().reindex(index=some["condition"].unique(), columns=names).fillna("–")


# Positioning ----------------------------------------------------------------------------------------------------------


def by_leak(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
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
    if "growth" in tables:
        found = tables["growth"]
        least, most = (setting(leak) for leak in levels["value"].agg(["min", "max"]))
        texts = found.assign(text=with_interval(found, "ratio"), family=found["family"].map(family_name))
        growth = texts.pivot(index="controller", columns="family", values="text").loc[names, texts["family"].unique()]
        page.table(growth, f"Mean error with {most} l/min ÷ mean error with {least} l/min, same plants")


def by_kind(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """Errors, and their ratios to those of the baseline, by kind of reference."""
    names, errors = names_of(tables), rows_of(tables, "summary", "family")
    errors, ratios = errors[errors["metric"] == ERROR], rows_of(tables, "comparison", "family")
    if errors.empty:
        return
    page.heading("By kind of reference")
    figures = (
        (errors, "mean", "mean error, mm", "Mean error by kind of reference"),
        (ratios, "ratio", f"error ÷ error of {names[0]}", "Ratio of errors by kind of reference"),
    )
    for rows, column, label, heading in figures:
        if len(rows):
            rows = rows.assign(value=rows["value"].map(family_name))
            axes = panel(height=height_of(rows["value"].nunique(), len(names)), xlabel=label)
            draw(axes, rows, "value", column, names, kind="rows")
            axes.set_xlim(left=0.0)
            if column == "ratio":
                axes.axvline(1.0, color=INK, linewidth=1.0)
            page.figure(axes, heading)


def single_runs(page: Page, examples: Sequence[Example]) -> None:
    """Position, error and command of each example, folded by leak."""
    if examples:
        page.heading("Single runs")
        note = (
            "The same plant, reference and noise at every leak. A controller that sees the reference ahead may start "
        )
        page.text(f"{note}before a step.", "soft")
    for leak in sorted({example.leak for example in examples}):
        with page.fold(f"Leak of {setting(leak)} l/min at 100 bar"):
            for example in examples:
                if example.leak == leak:
                    page.figure(example_axes(example), capitalised(example.title))


def example_axes(example: Example) -> list[Axes]:
    """Position and reference, error in mm, command in V of one episode under every controller."""
    axes = panels(3, height=4.6)
    for one, label in zip(axes, ("position, mm", "error, mm", "command, V"), strict=True):
        one.set_ylabel(label)
    axes[-1].set_xlabel("time, s")
    for name, position in example.position.items():
        error = 1e3 * (example.reference - position)
        label = f"{name}, mean error {number(float(np.abs(error).mean()))} mm"
        signal(axes[0], example.time, 1e3 * position, label=label)
        signal(axes[1], example.time, error)
        signal(axes[2], example.time, 10.0 * example.command[name])
    line = {"color": INK, "linestyle": "-", "linewidth": 0.8, "label": "reference"}
    signal(axes[0], example.time, 1e3 * example.reference, **line)
    return axes


# Detection and method -------------------------------------------------------------------------------------------------


def detection(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """The leakage head under every controller: shares flagged by size, and the summary."""
    page.heading("Detecting the leak")
    rates, names = tables["detection_rates"], names_of(tables)
    ranges = (rates["group"] == "range") & ~rates["value"].str.startswith("≥")
    axes = panel(xlabel="leak, l/min at 100 bar", ylabel="flagged, % of episodes", ylim=(-2.0, 102.0))
    shown = rates[ranges | (rates["value"] == "healthy")]
    draw(axes, shown, "value", "flagged_share", names, factor=100.0, kind="points")
    page.figure(axes, "Flagged episodes by leak", "Bars: 95 % interval. Flags on healthy seals are false alarms.")
    page.table(detection_table(tables["detection_summary"]), "Detection by the leakage head, from whole episodes")
    with page.fold("Share of episodes flagged, %"):
        texts = rates.assign(text=with_interval(rates, "flagged_share", 1, 100.0))
        shares = texts.pivot(index=["group", "value"], columns="controller", values="text")
        page.table(shares.loc[pd.MultiIndex.from_frame(rates[["group", "value"]].drop_duplicates()), names])


def detection_table(summary: pd.DataFrame) -> pd.DataFrame:
    """Areas under the curves, rates and errors of the size, one column per controller."""
    rows = {name: factor * summary[key] for key, (name, factor) in DETECTION.items() if key in summary}
    return pd.DataFrame(rows).set_axis(summary["controller"].to_list()).T.astype(object)


def method(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """What was run, on which seeds, and what the terms mean."""
    page.heading("How it was measured")
    page.points(
        [
            f"Intervals of means and ratios: 95 %, bootstrap over plants ({RESAMPLES} resamplings) and training seeds; "
            "of shares: 95 %, Wilson.",
            "A seed fixes plant, reference and noise. Ratio: mean error over that of the baseline on the same runs; "
            "with equal weights: geometric mean of the ratios of all kinds of reference.",
            FRAMES_TEXT,
            f"At rest: without sensor noise, after a small step and back. A limit cycle has at least {LEAST_CYCLES} "
            f"periods within {JUDGED:g} s, is larger than one step of the position sensor, and does not decay.",
        ]
    )
    if "cases" in tables:
        cases = tables["cases"]
        runs = cases.groupby("controller", sort=False)
        rows = {
            "Kinds of reference": ", ".join(map(family_name, cases["family"].unique())),
            "Plants for each kind": cases["plant"].nunique(),
            "Leaks, l/min at 100 bar": ", ".join(map(setting, sorted(cases["leakage_flow_lpm"].unique()))),
            "Seeds": span(cases["seed"].min(), cases["seed"].max()),
        }
        counts = {
            "Runs": runs.size(),
            "Training seeds": runs["training_seed"].nunique(),
            "Failed runs": runs["failed"].sum().astype(int),
        }
        for what, by_controller in counts.items():
            rows[what] = ", ".join(f"{name} {count}" for name, count in by_controller.items())
        page.table(pd.DataFrame({"number": pd.Series(rows, dtype=object)}), "What was run", words=True)
    with page.fold("Metrics of a run"):
        about = {metric.name: (metric.word, metric.meaning, metric.unit) for metric in METRICS.values()}
        columns = ["metric", "meaning", "unit"]
        frame = pd.DataFrame.from_dict(about, orient="index", columns=columns)
        page.table(frame, "By columns of the files", words=True)
