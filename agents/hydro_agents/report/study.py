"""The page of a study: errors of its controllers by leak, single runs, detection of the leak, training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.evaluation.evaluate import Evaluation
from hydro_agents.evaluation.metrics import FRAMES, FRAMES_TEXT, METRICS
from hydro_agents.report.canvas import INK, Plot
from hydro_agents.report.content import Content, shown
from hydro_agents.report.palette import Look
from hydro_agents.report.recorded import Line, Signal, course_plot
from hydro_agents.report.sections import Block, Fold, Points, Text, section
from hydro_agents.report.shared import findings_of, problems
from hydro_agents.report.study_plots import tracking_plots
from hydro_agents.running.limit_cycles import JUDGED, LEAST_CYCLES, amplitude_text
from hydro_agents.running.seeds import TEST_SEEDS
from hydro_agents.running.statistics import RESAMPLES
from hydro_agents.running.text import Table, capitalised, family_name, number, setting, span
from hydro_env.types import Floats

STUDY = (
    "introduction",
    "study_findings",
    "positioning",
    "one_leak",
    "detection",
    "training",
    "study_method",
    "run",
)
"""Sections of the page, in order."""

FEW_PLANTS = 12
"""With fewer plants the intervals are rough; the page says so."""

OVERVIEW = tuple(metric for metric in METRICS.values() if metric.cost or metric.name in FRAMES)
"""Metrics side by side: an error is no result without its cost."""


@dataclass(frozen=True)
class Example:
    """One test episode under every controller. Arrays (T,)."""

    title: str
    time: Floats  # s
    reference: Floats  # m
    position: dict[str, Floats]  # controller → m
    command: dict[str, Floats]  # controller → fraction of 10 V
    leak: float = 0.0  # l/min at 100 bar


def tables_of(evaluation: Evaluation) -> dict[str, pd.DataFrame]:
    """Every table of an evaluation by the name of its CSV file."""
    values = {part.name: getattr(evaluation, part.name) for part in fields(evaluation)}
    return {name: table for name, table in values.items() if isinstance(table, pd.DataFrame)}


def content_of(
    evaluation: Evaluation,
    facts: Mapping[str, Any] | None = None,
    tables: Mapping[str, pd.DataFrame] | None = None,
    **others: Any,
) -> Content:
    """The content of the page of an evaluation.

    Args:
        evaluation: its results.
        facts: keys and values of the run, such as command, date, seed and versions.
        tables: further ones: ``corrected``, ``training_curve`` (see :mod:`hydro_agents.report.training_plots`).
        others: ``examples`` (the same episodes at every leak), ``timings`` (s, by phase), ``configuration`` (YAML
            text) and ``validation_error_mm`` (of the first controller, on the plants of the training curve).
    """
    run = pd.DataFrame((facts or {}).items(), columns=["key", "value"])
    everything = {**tables_of(evaluation), **(tables or {}), "protocol": run}
    return Content(everything, others={"bounds": evaluation.bounds, "errors": evaluation.errors, **others})


# Sections -----------------------------------------------------------------------------------------------------------


@section("Findings", needs=("levels",), heading=False)
def study_findings(content: Content) -> list[Block]:
    """What failed, warnings, and the findings as cards."""
    failed = content.table("cases").groupby("controller", sort=False)["failed"].agg(["sum", "count"]).astype(int)
    counts = ", ".join(f"{name} {row['sum']} of {row['count']}" for name, row in failed.iterrows())
    return [
        *problems(content),
        *(Text(warning, "caution") for warning in warnings_of(content)),
        *findings_of(content),
        Text(f"In brackets: 95 % intervals. Failed runs (end stop or pressure limit): {counts}.", "soft"),
    ]


def warnings_of(content: Content) -> list[str]:
    """Few plants, and runs with seeds that may have trained a controller."""
    warnings = []
    plants = content.table("cases")["plant"].nunique()
    if plants < FEW_PLANTS:
        few = f"{plants} plants per leak size and kind of reference are too few for a decision"
        warnings.append(f"A small run, whose intervals are missing or rough: {few}.")
    seeds = pd.concat([content.table(name)["seed"] for name in ("cases", "detection") if content.has(name)])
    if not seeds.isin(TEST_SEEDS).all():
        warnings.append("Some runs used seeds outside the test seeds: a controller may have been trained on them.")
    return warnings


@section("Positioning", needs=("levels", "families"))
def positioning(content: Content) -> list[Block]:
    """Errors and costs by leak and kind of reference."""
    healthy = setting(content.bounds.healthy_up_to)
    terms = (
        f"{FRAMES_TEXT} Each run lasts one episode; a plant is one draw of the uncertain parameters. Leaks are in "
        f"l/min at 100 bar across the piston; up to {healthy} l/min a seal counts as healthy."
    )
    return [
        Text(terms),
        overview(content),
        *growth_table(content),
        *tracking_plots(content),
    ]


@section("One leak at a time", needs=("examples",))
def one_leak(content: Content) -> list[Block]:
    """Single runs at each leak."""
    examples: list[Example] = content.other("examples", [])
    plots: dict[float, list[Block]] = {}
    for count, example in enumerate(examples):
        plots.setdefault(example.leak, []).append(example_plot(example, f"run-{count}", content.looks))
    note = "Single runs: the same plant, reference and noise at every leak."
    return [Text(note), *(Fold(f"Leak of {setting(leak)} l/min", plots[leak]) for leak in sorted(plots))]


def example_plot(example: Example, key: str, looks: Mapping[str, Look]) -> Plot:
    """Position and reference, error in mm, command in V of one episode under every controller.

    Args:
        example: the episode.
        key: name of the figure.
        looks: of the controllers.
    """
    time, reference = example.time, example.reference
    error = {name: 1e3 * (reference - position) for name, position in example.position.items()}
    positions = {"reference": reference, **example.position}
    signals = [
        Signal("position, mm", {name: Line(time, 1e3 * values) for name, values in positions.items()}),
        Signal("error, mm", {name: Line(time, values) for name, values in error.items()}),
        Signal("command, V", {name: Line(time, 10.0 * values) for name, values in example.command.items()}),
    ]
    means = (f"{name} {number(float(np.mean(np.abs(values))))} mm" for name, values in error.items())
    note = (
        f"Mean error of this run: {', '.join(means)}. A controller that sees the reference ahead may start before a "
        "step."
    )
    alt = f"Position, error and valve command over time: {example.title}. {note}"
    with_reference = {**looks, "reference": Look(INK, "", "-")}
    return course_plot(key, capitalised(example.title), note, alt, signals, 4.6, with_reference)


@section("How it was measured", needs=("cases",))
def study_method(content: Content) -> list[Block]:
    """What was run, on which seeds, and what the terms mean."""
    sentences = [
        "Every controller runs on the same plants, references and sensor noise: all comparisons are paired. A seed "
        "fixes plant, reference and noise.",
        f"Intervals of means and ratios: 95 %, bootstrap over plants ({RESAMPLES} resamplings) and training seeds; of "
        "shares: 95 %, Wilson. About one in twenty of many such intervals misses its true value.",
    ]
    if content.has("limit_cycles"):
        sentences.append(
            "Standstills, without sensor noise: the reference makes a small step and returns; then the axis must come "
            f"to rest. A limit cycle has at least {LEAST_CYCLES} periods within {JUDGED:g} s, is larger than one step "
            "of the position sensor, and does not decay."
        )
    if content.has("detection_summary"):
        sentences.append(
            "Detection, on other plants: leak sizes are log-uniform, kinds of reference are drawn at random. The "
            "network reads the signals of one whole episode."
        )
    return [Points(sentences), extent_table(content), terms(content)]


# Tables -------------------------------------------------------------------------------------------------------------


def extent_table(content: Content) -> Table:
    """What was run: numbers of runs, plants, leaks, seeds."""
    cases = content.table("cases")
    trainings = cases.groupby("controller", sort=False)["training_seed"].nunique()
    rows = {
        "Runs of each controller": len(cases.drop_duplicates(["leakage_flow_lpm", "family", "plant"])),
        "Kinds of reference": ", ".join(map(family_name, cases["family"].unique())),
        "Plants for each kind": cases["plant"].nunique(),
        "Leaks of each plant, l/min at 100 bar": _leaks(cases),
        "Training seeds of each controller": ", ".join(f"{name} {count}" for name, count in trainings.items()),
        "Seeds": span(cases["seed"].min(), cases["seed"].max()),
    }
    return Table(
        "What was run", ("", "Number"), [(what, str(n)) for what, n in rows.items()], style="words", folded=False
    )


def _leaks(table: pd.DataFrame) -> str:
    return ", ".join(map(setting, sorted(table["leakage_flow_lpm"].unique())))


def overview(content: Content) -> Table:
    """One row per controller over all runs: errors, ratios to the first one, worst cases, and costs."""
    rows, still = [], content.has("limit_cycle_summary")
    for name in content.controllers:
        own, ratio = content.rows("cases", controller=name), content.row("ratios", controller=name, group="all")
        accuracy, repeatability, *costs = _means(own)
        errors = (
            accuracy,
            shown(ratio, "ratio", 3),
            number(own["mean_error_mm"].max()),
            repeatability,
            shown(ratio, "ratio_sensor", 3),
        )
        rows.append((name, *errors, *costs, *([_limit_cycles(content, name)] * still)))
    accuracy, repeatability, *others = _overview_header()
    divided = f"÷ {content.baseline}'s"
    errors = (accuracy, divided, "worst run, mm", repeatability, divided)
    header = ("Controller", *errors, *others, *["limit cycles at rest"] * still)
    return Table("Errors and costs, mean over all runs", header, rows, style="dense")


def _limit_cycles(content: Content, name: str) -> str:
    row = content.row("limit_cycle_summary", controller=name)
    size = f" (to {amplitude_text(row['largest_amplitude_um'])})" if row["limit_cycles"] else ""
    failed = f", {row['failures']} failed" if row["failures"] else ""
    return f"{row['limit_cycles']} of {row['standstills']}{size}{failed}"


def _overview_header() -> list[str]:
    labels = (f"{FRAMES[metric.name]}, mm" if metric.name in FRAMES else metric.label for metric in OVERVIEW)
    return [label[0].lower() + label[1:] for label in labels]


def _means(cases: pd.DataFrame) -> list[str]:
    return [number(metric.factor * cases[metric.name].mean()) for metric in OVERVIEW]


def growth_table(content: Content) -> list[Table]:
    """Mean error at the largest leak over that at the smallest, on the same plants; none with one leak."""
    table, leaks = content.table("growth"), content.table("cases")["leakage_flow_lpm"]
    if table.empty:
        return []
    rows = []
    for name in content.controllers:
        own = content.rows("growth", controller=name).to_dict("records")
        rows.append((name, *(shown(row, "ratio") for row in own)))
    header = ("Controller", "all runs", *map(family_name, table["family"].unique()[1:]))
    least, most = setting(leaks.min()), setting(leaks.max())
    return [Table(f"Mean error with {most} l/min ÷ mean error with {least} l/min, same plants", header, rows)]


def terms(content: Content) -> Table:
    """What the words of the page mean: metrics of a run, and others."""
    rows = []
    for metric in METRICS.values():
        unit = "" if metric.unit == "1" else f"; {metric.unit}"
        rows.append((metric.word, f"{metric.meaning}{unit}", metric.name))
    meanings = {
        "Ratio": "mean error of one controller divided by that of another, on the same runs; below 1 is better",
    }
    if content.has("detection_summary"):
        healthy = setting(content.bounds.healthy_up_to)
        meanings |= {
            "False alarm": f"an episode with a healthy seal (up to {healthy} l/min) that is flagged",
            "Detection rate": "share of leaking episodes that are flagged; also called recall",
            "ROC, area under it": "detection rate over false-alarm rate for all thresholds; the area (AUROC) is the "
            "probability that a leaking episode gets a higher score than a healthy one: 1 is perfect, 0.5 is chance",
        }
    rows += [(term, meaning, "") for term, meaning in meanings.items()]
    return Table("Metrics of a run, and terms", ("Name", "meaning", "in the CSV files"), rows, style="words")
