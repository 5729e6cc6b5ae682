"""The page of a study: errors of its controllers by leak, single runs, detection of the leak, training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from hydro_agents.evaluation.metrics import FRAMES, FRAMES_TEXT, METRICS
from hydro_agents.report.kit import INK, Page, draw, drawn, height_of, leak_axis, panel, panels, signal, with_interval
from hydro_agents.report.parts import best, corrections, learning, problems, run_facts
from hydro_agents.running.limit_cycles import JUDGED, LEAST_CYCLES, amplitude_text
from hydro_agents.running.seeds import TEST_SEEDS
from hydro_agents.running.statistics import RESAMPLES
from hydro_agents.running.text import capitalised, family_name, number, setting, span
from hydro_env.types import Floats

ALL = "all"  # group of the rows over all runs

FEW_PLANTS = 12
"""With fewer plants the intervals are rough; the page says so."""

OVERVIEW = tuple(metric for metric in METRICS.values() if metric.cost)
"""Metrics beside the errors: an error is no result without its cost."""

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
def study_page(
    title: str,
    tables: Mapping[str, pd.DataFrame],
    *,
    examples: Sequence[Example] = (),
    timings: Mapping[str, float] | None = None,
    configuration: str = "",
) -> Page:
    """The page.

    Args:
        title: of the page.
        tables: of the run, by the names of their CSV files; a part whose table is missing is left out.
        examples: the same episodes at every leak.
        timings: s, by phase.
        configuration: YAML text.
    """
    facts = facts_of(tables)
    names, page = names_of(tables), Page(title)
    compared = compared_with(tables, names[0])
    at_rest = tables.get("limit_cycle_summary", pd.DataFrame())
    best(page, names[0], compared[compared["group"] == ALL], "ratio", at_rest)
    problems(page, tables.get("status", pd.DataFrame()), "controller", {})
    warnings(page, tables)
    page.text(
        f"Simulated: a servo axis whose piston seal leaks. {names[0]} is the baseline; every controller runs on the "
        "same plants, references and sensor noise. In brackets: 95 % intervals.",
        "soft",
    )
    page.table(overview(tables), "Errors and costs, mean over all runs")
    corrections(page, compared_with(tables, names[0], corrections=True))
    page.heading("Positioning by leak and by kind of reference")
    positioning(page, tables)
    if examples:
        page.heading("Single runs")
        page.text("The same plant, reference and noise at every leak. A controller that sees the reference ahead may "
                  "start before a step.", "soft")  # fmt: skip
    for leak in sorted({example.leak for example in examples}):
        with page.fold(f"Leak of {setting(leak)} l/min at 100 bar"):
            for example in examples:
                if example.leak == leak:
                    single_run(page, example)
    if "detection_summary" in tables:
        page.heading("Detecting the leak")
        detection(page, tables)
    if "training_curve" in tables:
        curve = tables["training_curve"]
        learning(page, curve, names[0], float(curve["first_mean_error_mm"].iloc[0]), names)
    page.heading("How it was measured")
    method(page, tables)
    run_facts(page, facts, timings or {}, configuration)
    return page


def names_of(tables: Mapping[str, pd.DataFrame]) -> list[str]:
    """Names of the controllers, the baseline first."""
    return [str(name) for name in tables["cases"]["controller"].unique()]


def compared_with(tables: Mapping[str, pd.DataFrame], baseline: str, corrections: bool = False) -> pd.DataFrame:
    """The rows of the comparison with the baseline, or those of policies with what they correct."""
    table = tables.get("comparison", pd.DataFrame(columns=["controller", "against", "group", "value"]))
    return table[(table["against"] != baseline) == corrections]


def facts_of(tables: Mapping[str, pd.DataFrame]) -> dict[str, str]:
    """Keys and values of a run, from its table ``protocol``."""
    table = tables.get("protocol", pd.DataFrame(columns=["key", "value"]))
    return dict(zip(table["key"].astype(str), table["value"].astype(str), strict=True))


def warnings(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """Few plants, and runs with seeds that may have trained a controller."""
    plants = tables["cases"]["plant"].nunique()
    if plants < FEW_PLANTS:
        few = f"A small run: {plants} plants per leak and kind of reference are too few for a decision."
        page.text(few, "caution")
    seeds = pd.concat([tables[name]["seed"] for name in ("cases", "detection") if name in tables])
    if not seeds.isin(TEST_SEEDS).all():
        text = "Some runs used seeds outside the test seeds: a controller may have been trained on them."
        page.text(text, "caution")


def overview(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """One row per controller over all runs: errors, ratios to the first one, worst runs, costs, limit cycles."""
    runs, names = tables["cases"].groupby("controller", sort=False), names_of(tables)
    means, frame = runs.mean(numeric_only=True), {}
    compared = compared_with(tables, names[0])
    ratios = compared[compared["group"] == ALL].set_index("controller")
    for (error, word), ratio in zip(FRAMES.items(), ("ratio", "ratio_sensor"), strict=True):
        frame[word, "mean error, mm"] = means[error]
        if len(ratios):
            frame[word, f"÷ {names[0]}'s"] = with_interval(ratios, ratio).reindex(means.index).fillna("1")
    frame["worst", "error, mm"] = runs["mean_error_mm"].max()
    for metric in OVERVIEW:
        frame["cost", f"{metric.word.lower()}, {metric.shown_unit or metric.unit}"] = metric.factor * means[metric.name]
    for row in tables.get("limit_cycle_summary", pd.DataFrame()).to_dict("records"):
        size = f" (to {amplitude_text(row['largest_amplitude_um'])})" if row["limit_cycles"] else ""
        failed = f", {row['failures']} failed" if row["failures"] else ""
        cycles = frame.setdefault(("at rest", "limit cycles"), pd.Series("–", index=means.index, dtype=object))
        cycles[row["controller"]] = f"{row['limit_cycles']} of {row['standstills']}{size}{failed}"
    return pd.DataFrame(frame)


def positioning(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """Errors and costs over the leak, and by kind of reference."""
    names, summary = names_of(tables), tables["summary"]
    levels = summary[summary["group"] == "level"]
    levels = levels.assign(leakage_flow_lpm=levels["value"].astype(float))
    for metric in (METRICS["mean_error_mm"], *OVERVIEW):
        rows = levels[levels["metric"] == metric.name]
        if metric.name == "failed":
            continue
        axes = panel(ylabel=metric.label[0].lower() + metric.label[1:])
        draw(axes, rows, "leakage_flow_lpm", "mean", names, factor=metric.factor)
        leak_axis(axes, rows["leakage_flow_lpm"])
        axes.set_ylim(bottom=0.0)
        page.figure(axes, f"{metric.word} by leak")
    of_kinds = (summary["group"] == "family") & (summary["metric"] == "mean_error_mm")
    rows = summary[of_kinds].rename(columns={"value": "family"})
    by_kind = {"mean": (rows, "mean error, mm", "Mean error by kind of reference")}
    compared = compared_with(tables, names[0])
    rows = compared[compared["group"] == "family"].rename(columns={"value": "family"})
    by_kind["ratio"] = (rows, f"error ÷ error of {names[0]}", "Ratio of errors by kind of reference")
    for column, (rows, label, heading) in by_kind.items():
        if rows.empty:
            continue
        rows = rows.assign(family=rows["family"].map(family_name))
        axes = panel(height=height_of(rows["family"].nunique(), len(names)), xlabel=label)
        draw(axes, rows, "family", column, names, kind="rows")
        axes.set_xlim(left=0.0)
        if column == "ratio":
            axes.axvline(1.0, color=INK, linewidth=1.0, marker="", linestyle="-")
        page.figure(axes, heading)
    if "growth" in tables:
        found = tables["growth"]
        least, most = (setting(end) for end in tables["cases"]["leakage_flow_lpm"].agg(["min", "max"]))
        texts = found.assign(text=with_interval(found, "ratio"), family=found["family"].map(family_name))
        growth = texts.pivot(index="controller", columns="family", values="text").loc[names, texts["family"].unique()]
        page.table(growth, f"Mean error with {most} l/min ÷ mean error with {least} l/min, same plants")


def single_run(page: Page, example: Example) -> None:
    """Position and reference, error in mm, command in V of one episode under every controller."""
    axes = panels(3, height=4.6)
    for panel_, label in zip(axes, ("position, mm", "error, mm", "command, V"), strict=True):
        panel_.set_ylabel(label)
    for name, position in example.position.items():
        error = 1e3 * (example.reference - position)
        label = f"{name}, mean error {number(float(np.abs(error).mean()))} mm"
        signal(axes[0], example.time, 1e3 * position, label=label)
        signal(axes[1], example.time, error)
        signal(axes[2], example.time, 10.0 * example.command[name])
    signal(axes[0], example.time, 1e3 * example.reference, color=INK, linestyle="-", linewidth=0.8, label="reference")
    axes[-1].set_xlabel("time, s")
    page.figure(axes, capitalised(example.title))


def detection(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """The leakage head under every controller: shares flagged by size, and the summary."""
    rates, names = tables["detection_rates"], names_of(tables)
    ranges = (rates["group"] == "range") & ~rates["value"].str.startswith("≥")
    axes = panel(xlabel="leak, l/min at 100 bar", ylabel="flagged, % of episodes", ylim=(-2.0, 102.0))
    draw(
        axes,
        rates[ranges | (rates["value"] == "healthy")],
        "value",
        "flagged_share",
        names,
        factor=100.0,
        kind="points",
    )
    page.figure(axes, "Flagged episodes by leak", "Bars: 95 % interval. Flags on healthy seals are false alarms.")
    page.table(detection_table(tables["detection_summary"]), "Detection by the leakage head, from whole episodes")
    with page.fold("Share of episodes flagged, %"):
        texts = rates.assign(text=with_interval(rates, "flagged_share", 1, 100.0))
        shares = texts.pivot(index=["group", "value"], columns="controller", values="text")
        shares = shares.loc[pd.MultiIndex.from_frame(rates[["group", "value"]].drop_duplicates()), names]
        page.table(shares)


def detection_table(summary: pd.DataFrame) -> pd.DataFrame:
    """Areas under the curves, rates and errors of the size, one column per controller."""
    rows = {name: factor * summary[key] for key, (name, factor) in DETECTION.items() if key in summary}
    return pd.DataFrame(rows).set_axis(summary["controller"].to_list()).T.astype(object)


def method(page: Page, tables: Mapping[str, pd.DataFrame]) -> None:
    """What was run, on which seeds, and what the terms mean."""
    cases = tables["cases"]
    page.points(
        [
            f"Intervals of means and ratios: 95 %, bootstrap over plants ({RESAMPLES} resamplings) and training seeds; "
            "of shares: 95 %, Wilson.",
            "A seed fixes plant, reference and noise. Ratio: mean error over that of the baseline on the same runs.",
            FRAMES_TEXT,
            f"At rest: without sensor noise, after a small step and back. A limit cycle has at least {LEAST_CYCLES} "
            f"periods within {JUDGED:g} s, is larger than one step of the position sensor, and does not decay.",
        ]
    )
    rows = {
        "Runs of each controller": len(cases.drop_duplicates(["leakage_flow_lpm", "family", "plant"])),
        "Kinds of reference": ", ".join(map(family_name, cases["family"].unique())),
        "Plants for each kind": cases["plant"].nunique(),
        "Leaks of each plant, l/min at 100 bar": ", ".join(map(setting, sorted(cases["leakage_flow_lpm"].unique()))),
        "Seeds": span(cases["seed"].min(), cases["seed"].max()),
    }
    runs = cases.groupby("controller", sort=False)
    counts = {"Training seeds": runs["training_seed"].nunique(), "Failed runs": runs["failed"].sum().astype(int)}
    for what, by_controller in counts.items():
        rows[what] = ", ".join(f"{name} {count}" for name, count in by_controller.items())
    page.table(pd.DataFrame({"number": pd.Series(rows, dtype=object)}), "What was run", words=True)
    with page.fold("Metrics of a run"):
        about = {metric.name: (metric.word, metric.meaning, metric.unit) for metric in METRICS.values()}
        columns = ["metric", "meaning", "unit"]
        page.table(
            pd.DataFrame.from_dict(about, orient="index", columns=columns), "By columns of the files", words=True
        )
