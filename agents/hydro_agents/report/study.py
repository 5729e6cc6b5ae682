"""The page of a study: errors of its controllers by leak, single runs, detection of the leak, training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import pandas as pd

from hydro_agents.evaluation.evaluate import Evaluation
from hydro_agents.evaluation.limit_cycles import JUDGED, LEAST_CYCLES, amplitude_text
from hydro_agents.evaluation.metrics import FRAMES, FRAMES_TEXT, METRICS
from hydro_agents.report.content import Content, interval, interval_text, verdict
from hydro_agents.report.sections import Block, Choice, Fold, Points, Text, cards, section
from hydro_agents.report.shared import price_sentence, problems, score_plot, score_text
from hydro_agents.report.study_findings import caution, failed_runs, findings_of, scores
from hydro_agents.report.study_plots import tracking_plots
from hydro_agents.report.traces import Example, example_limits, example_plot
from hydro_agents.running.seeds import TEST_SEEDS, TRAINING_SEEDS, VALIDATION_SEEDS
from hydro_agents.running.statistics import RESAMPLES, conditional_value_at_risk
from hydro_agents.running.text import Table, decimals_for, family_name, listed, number, setting, span

STUDY = (
    "introduction",
    "study_findings",
    "positioning",
    "one_leak",
    "leak_price",
    "detection",
    "training",
    "study_method",
    "run",
)
"""Sections of the page, in order."""


OVERVIEW = tuple(metric for metric in METRICS.values() if metric.cost or metric.name in FRAMES)
"""Metrics side by side: an error is no result without its cost."""

BY = {
    "levels": ("leakage_flow_lpm", "Leak, l/min", "leak size"),
    "families": ("family", "Reference", "kind of reference"),
}
"""Tables of all metrics: the column of their rows, and its words."""

VERDICTS = {"better": "wins", "worse": "loses", "same": "no clear difference"}


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
        tables: further ones: ``leak_price``, ``training_curve`` (see :mod:`hydro_agents.report.training_plots`).
        others: ``examples`` (the same episodes at every leak), ``timings`` (s, by phase), ``configuration`` (YAML
            text), ``corrects`` (controller → the one that it corrects) and ``validation_error_mm`` (of the first
            controller, on the plants of the training curve).
    """
    run = pd.DataFrame((facts or {}).items(), columns=["key", "value"])
    found = {**tables_of(evaluation), **(tables or {}), "protocol": run}
    return Content(found, others={"bounds": evaluation.bounds, "errors": evaluation.errors, **others})


# Sections -----------------------------------------------------------------------------------------------------------


@section("Findings", needs=("levels",), heading=False)
def study_findings(content: Content) -> list[Block]:
    """What failed, a warning about few plants, and the findings as cards."""
    few = caution(content)
    return [
        *problems(content),
        *([Text(few, "caution")] if few else []),
        cards(findings_of(content)),
        Text(f"In brackets: 95 % intervals. {failed_runs(content)}", "soft"),
    ]


@section("Positioning", needs=("levels", "families"))
def positioning(content: Content) -> list[Block]:
    """Errors and costs by leak and kind of reference."""
    blocks: list[Block] = [
        Text(
            f"{FRAMES_TEXT} Each run lasts one episode; a plant is one draw of the uncertain parameters. "
            "Leaks are in l/min at 100 bar across the piston; up to "
            f"{setting(content.bounds.healthy_up_to)} l/min a seal counts as healthy."
        ),
        overview(content),
        *score_plot(content, scores(content)),
        *tracking_plots(content),
        Text(
            "“Worst 5 %” is the mean over the worst twentieth of the runs (conditional value at risk, CVaR); “worst "
            "run” is the largest value of all.",
            "soft",
        ),
        Fold("Mean errors with intervals", [metric_table(content, by, "mean_error_mm") for by in BY]),
    ]
    ratios = ratio_tables(content)
    if ratios:
        note = "A controller “wins” or “loses” only if the whole interval is on one side of 1."
        blocks.append(Fold("Ratios of errors, with verdicts", [Text(note), *ratios]))
    note = (
        "The settling time includes only standstills in which the axis settled: read it together with the share of the "
        "others."
    )
    blocks.append(Fold("All other metrics by leak size", [Text(note), *metric_tables(content, "levels")]))
    blocks.append(Fold("All other metrics by kind of reference", metric_tables(content, "families")))
    return blocks


@section("One leak at a time", needs=("cases",))
def one_leak(content: Content) -> list[Block]:
    """Errors, costs and single runs at each leak; an episode has the same scale at every leak."""
    examples: list[Example] = content.other("examples", [])
    limits = {
        title: example_limits([example for example in examples if example.title == title])
        for title in {example.title for example in examples}
    }
    blocks: dict[str, Sequence[Block]] = {}
    for level, table in level_tables(content).items():
        sentence = price_sentence(content.table("leak_price"), level)
        blocks[setting(level)] = [
            table,
            *([Text(sentence)] if sentence else []),
            *(
                example_plot(example, f"run-{number}", content.looks, limits[example.title])
                for number, example in enumerate(examples)
                if example.leak == level
            ),
        ]
    return [
        Text("Means over all runs with this leak. Single runs: the same plant, reference and noise at every leak."),
        Choice("Leak", "l/min at 100 bar", blocks),
    ]


@section("How it was measured", needs=("cases",))
def study_method(content: Content) -> list[Block]:
    """The method as sentences, with numbers from the tables, and what the terms mean."""
    cases = content.table("cases")
    levels = [setting(level) for level in sorted(cases["leakage_flow_lpm"].unique())]
    families = [family_name(str(name)) for name in cases["family"].unique()]
    runs = len(cases.drop_duplicates(["leakage_flow_lpm", "family", "plant"]))
    seeds = cases.groupby("controller", sort=False)["training_seed"].nunique()
    several = [f"{count} of {name}" for name, count in seeds.items() if count > 1]
    shared = f" Training seeds, each with all runs: {listed(several)}; intervals include them." if several else ""
    sentences = [
        f"Tracking: {runs} runs per controller.{shared} For each kind of reference ({listed(families)}) there are "
        f"{cases['plant'].nunique()} plants, each run at every leak size ({listed(levels)} l/min at 100 bar across the "
        "piston).",
        "Every controller runs on the same plants, references and sensor noise: all comparisons are paired.",
        _seeds_sentence(content),
        *([score_text(content.baseline)] if content.has("score") else []),
        f"Intervals of means and ratios: 95 %, bootstrap over plants ({RESAMPLES} resamplings); of shares: 95 %, "
        "Wilson. About one in twenty of many such intervals misses its true value.",
    ]
    if content.has("limit_cycles"):
        still = content.table("limit_cycles")
        leaks = listed([setting(level) for level in sorted(still["leakage_flow_lpm"].unique())])
        sentences.append(
            f"Standstills: {still['plant'].nunique()} plants, each at {leaks} l/min, without sensor noise. The "
            "reference makes a small step and returns; then the axis must come to rest. A limit cycle has at least "
            f"{LEAST_CYCLES} periods within {JUDGED:g} s, is larger than one step of the position sensor, and does "
            "not decay."
        )
    if content.has("detection_summary"):
        row = content.table("detection_summary").iloc[0]
        sentences.append(
            f"Detection: {int(row['healthy_episodes'])} healthy and {int(row['leaking_episodes'])} leaking episodes "
            f"per controller, on other plants (seeds {_span(content.table('detection')['seed'])}); leak sizes are "
            "log-uniform, kinds of reference are drawn at random. The network reads the signals of one whole episode."
        )
    return [Points(sentences), definitions(), terms(content)]


def _span(seeds: pd.Series | range) -> str:
    return span(min(seeds), max(seeds))


def _seeds_sentence(content: Content) -> str:
    """Sentence about the seeds used, and whether all of them are test seeds."""
    tables = [content.table(name)["seed"] for name in ("cases", "detection") if content.has(name)]
    inside = all(min(seeds) >= TEST_SEEDS.start and max(seeds) < TEST_SEEDS.stop for seeds in tables)
    kept = "so no plant used here took part in training or in setting thresholds"
    broken = "but some runs here used seeds outside the test seeds; a controller may have been trained on them"
    return (
        f"A seed fixes plant, reference and noise. Tracking uses seeds {_span(content.table('cases')['seed'])}; "
        f"training uses {_span(TRAINING_SEEDS)}, validation {_span(VALIDATION_SEEDS)}, {kept if inside else broken}."
    )


# Tables -------------------------------------------------------------------------------------------------------------


def overview(content: Content) -> Table:
    """One row per controller over all runs: score, errors, ratios to the first one, worst cases, and costs."""
    rows, scored = [], content.has("score")
    for name in content.controllers:
        own, ratio = content.rows("cases", controller=name), content.row("ratios", controller=name, group="all")
        accuracy, repeatability, *costs = _means(own)
        tail = number(conditional_value_at_risk(own["mean_error_mm"].to_numpy()))
        still = [_limit_cycles(content, name)] if content.has("limit_cycle_summary") else []
        score = [interval_text(interval(content.row("score", controller=name), "score"), decimals=0)] * scored
        true, sensed = (interval_text(interval(ratio, column), decimals=3) for column in ("ratio", "ratio_sensor"))
        rows.append((name, *score, accuracy, true, tail, repeatability, sensed, *costs, *still))
    accuracy, repeatability, *others = _overview_header()
    others += ["limit cycles at rest"] if content.has("limit_cycle_summary") else []
    divided, score = f"÷ {content.baseline}'s", ["score"] * scored
    header = ("Controller", *score, accuracy, divided, "worst 5 %, mm", repeatability, divided, *others)
    return Table("Errors and costs, mean over all runs", header, rows, style="dense")


def _limit_cycles(content: Content, name: str) -> str:
    row = content.row("limit_cycle_summary", controller=name)
    size = f" (to {amplitude_text(row['largest_amplitude_um'])})" if row["limit_cycles"] else ""
    return f"{row['limit_cycles']} of {row['standstills']}{size}"


def level_tables(content: Content) -> dict[float, Table]:
    """The same for each leak level, without the ratio."""
    tables = {}
    for leak, cases in content.table("cases").groupby("leakage_flow_lpm"):
        rows = [(name, *_means(cases[cases["controller"] == name])) for name in content.controllers]
        caption = f"Leak of {setting(float(leak))} l/min"
        tables[float(leak)] = Table(caption, ("Controller", *_overview_header()), rows, style="dense")
    return tables


def _overview_header() -> tuple[str, ...]:
    labels = (f"{FRAMES[metric.name]}, mm" if metric.name in FRAMES else metric.label for metric in OVERVIEW)
    return tuple(label[0].lower() + label[1:] for label in labels)


def _means(cases: pd.DataFrame) -> tuple[str, ...]:
    return tuple(number(metric.factor * float(cases[metric.name].mean())) for metric in OVERVIEW)


def metric_table(content: Content, by: str, metric: str) -> Table:
    """Mean with interval, worst 5 % and worst run of every controller, by the rows of a table of BY."""
    column, first, words = BY[by]
    table, shown, names = content.rows(by, metric=metric), METRICS[metric], content.controllers
    means = shown.factor * table["mean"].abs()
    decimals = decimals_for(float(means[means > 0.0].median()))
    rows = []
    for value in table[table["mean"].notna()][column].unique():
        cells = [setting(value) if by == "levels" else family_name(str(value))]
        for name in names:
            row = content.row(by, metric=metric, controller=name, **{column: value})
            cells.append(interval_text(interval(row, "mean", shown.factor), decimals=decimals))
            cells += [number(shown.factor * float(row[key]), decimals) for key in ("cvar_5_percent", "worst")]
        rows.append(tuple(cells))
    header = (first, *("mean (95 % interval)", "worst 5 %", "worst run") * len(names))
    return Table(f"{shown.label}, by {words}", header, rows, tuple((name, 3) for name in names))


def metric_tables(content: Content, by: str) -> list[Table]:
    """All other metrics that have a value, and the failures if there are any."""
    table = content.table(by)
    shown = table["mean"].notna() & ((table["metric"] != "failed") | (table["mean"] > 0.0))
    valued = set(table[shown]["metric"]) - {"mean_error_mm"}
    return [metric_table(content, by, metric) for metric in METRICS if metric in valued]


def ratio_tables(content: Content) -> list[Table]:
    """Ratios of errors to the first controller, with verdicts; none with one controller."""
    tables = []
    for name in content.controllers[1:]:
        rows, against = [], content.row("ratios", controller=name)["against"]
        for row in content.rows("ratios", controller=name).to_dict("records"):
            value, ratio = str(row["value"]), interval(row, "ratio")
            label = family_name(value) or "all runs"
            label = f"leak of {setting(float(value))} l/min" if row["group"] == "level" else label
            better = number(100.0 * float(row["share_of_cases_better"]), 0)
            text = interval_text(ratio, decimals=3)
            rows.append((label, text, VERDICTS[verdict(ratio)], better if better == "–" else f"{better} %"))
        header = ("Runs", "ratio (95 % interval)", f"{name} …", "better in")
        tables.append(Table(f"Mean error of {name} over mean error of {against}", header, rows))
    return tables


def definitions() -> Table:
    """Definitions of the metrics."""
    rows = []
    for metric in METRICS.values():
        meaning = metric.meaning if metric.unit == "1" else f"{metric.meaning}; {metric.unit}"
        rows.append((metric.word, meaning, metric.name))
    return Table("Metrics of a run", ("Name", "meaning", "in the CSV files"), rows, style="words")


def terms(content: Content) -> Table:
    """What the words of the page mean."""
    rows = [
        ("Ratio", "mean error of one controller divided by that of another, on the same runs; below 1 is better"),
        ("Worst 5 %", "conditional value at risk (CVaR): mean over the worst 5 % of the runs"),
    ]
    if content.has("detection_summary"):
        healthy = setting(content.bounds.healthy_up_to)
        rows += [
            ("False alarm", f"an episode with a healthy seal (up to {healthy} l/min) that is flagged"),
            ("Detection rate", "share of leaking episodes that are flagged; also called recall"),
            ("Precision", "share of flagged episodes that leak; depends on how common leaks are"),
            (
                "ROC, area under it",
                "detection rate over false-alarm rate for all thresholds; the area (AUROC) is the probability that a "
                "leaking episode gets a higher score than a healthy one: 1 is perfect, 0.5 is chance",
            ),
            ("Average precision", "precision averaged over recall; chance gives the share of leaking episodes"),
        ]
    return Table("Terms", ("Term", "Meaning"), rows, style="words")
