"""The page of a study: errors of its controllers by leak, single runs, detection of the leak, training."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from hydro_agents.report.content import Content
from hydro_agents.report.detection_plots import detection_plots
from hydro_agents.report.sections import Block, Cards, Choice, Fold, Points, Text, section
from hydro_agents.report.shared import price_sentence, problems
from hydro_agents.report.study_findings import caution, failed_runs, findings_of, plants_of
from hydro_agents.report.study_plots import tracking_plots
from hydro_agents.report.study_tables import (
    definitions,
    detection_tables,
    level_tables,
    metric_table,
    metric_tables,
    overview,
    ratio_tables,
    terms,
)
from hydro_agents.report.traces import Example, example_limits, example_plot
from hydro_agents.report.training_plots import learning_plots, training_plots
from hydro_agents.running.resampling import RESAMPLES
from hydro_agents.running.seeds import TEST_SEEDS, TRAINING_SEEDS, VALIDATION_SEEDS
from hydro_agents.running.text import family_name, listed, setting, span

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


@section("Findings", needs=("levels",), heading=False)
def study_findings(content: Content) -> list[Block]:
    """What failed, a warning about few plants, and the findings as cards."""
    few = caution(content)
    return [
        *problems(content),
        *([Text(few, "caution")] if few else []),
        Cards(findings_of(content)),
        Text(f"In brackets: 95 % intervals. {failed_runs(content)}", "soft"),
    ]


@section("Positioning", needs=("levels", "families"))
def positioning(content: Content) -> list[Block]:
    """Errors and costs by leak and kind of reference."""
    blocks: list[Block] = [
        Text(
            "The error is the distance between reference and true position. Each run lasts one episode; a plant is "
            "one draw of the uncertain parameters. Leaks are in l/min at 100 bar across the piston; up to "
            f"{setting(content.bounds.healthy_up_to)} l/min a seal counts as healthy."
        ),
        overview(content),
        *tracking_plots(content),
        Text(
            "“Worst 5 %” is the mean over the worst twentieth of the runs (conditional value at risk, CVaR); “worst "
            "run” is the largest value of all.",
            "soft",
        ),
        Fold("Mean errors with intervals", [metric_table(content, by, "mean_error_mm") for by in ("level", "family")]),
    ]
    ratios = ratio_tables(content)
    if ratios:
        note = "A controller “wins” or “loses” only if the whole interval is on one side of 1."
        blocks.append(Fold("Ratios of errors, with verdicts", [Text(note), *ratios]))
    note = (
        "The settling time includes only standstills in which the axis settled: read it together with the share of the "
        "others."
    )
    blocks.append(Fold("All other metrics by leak size", [Text(note), *metric_tables(content, "level")]))
    blocks.append(Fold("All other metrics by kind of reference", metric_tables(content, "family")))
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


@section("Detecting the leak", needs=("detection_summary",))
def detection(content: Content) -> list[Block]:
    """The leakage head under every controller."""
    return [
        Text(
            "A neural network, the leakage head, reads the measured signals of one episode (position, both pressures, "
            "spool position, command) and estimates the probability of a leak and its size. A leak is flagged if the "
            "probability reaches the threshold. The head never reads the leak itself."
        ),
        *detection_plots(content),
        Fold("Detection in numbers", detection_tables(content)),
    ]


@section("Training", needs=("training_curve",))
def training(content: Content) -> list[Block]:
    """Error, reward and updates of the policy while it learned."""
    curve = content.table("training_curve")
    learning = learning_plots(
        curve, content.baseline, content.other("validation_error_mm", float("nan")), content.looks
    )
    plots = training_plots(curve, content.looks)
    more = [Fold("Reward, errors and updates of the policy", plots, not learning)] if plots else []
    return [*learning, *more]


@section("How it was measured", needs=("cases",))
def study_method(content: Content) -> list[Block]:
    """The method as sentences, with numbers from the tables, and what the terms mean."""
    cases = content.table("cases")
    levels = [setting(level) for level in sorted(cases["leakage_flow_lpm"].unique())]
    families = [family_name(str(name)) for name in cases["family"].unique()]
    runs = len(cases) // len(content.controllers)
    sentences = [
        f"Tracking: {runs} runs per controller. For each kind of reference ({listed(families)}) there are "
        f"{plants_of(content)} plants, each run at every leak size ({listed(levels)} l/min at 100 bar across the "
        "piston).",
        "Every controller runs on the same plants, references and sensor noise: all comparisons are paired.",
        _seeds_sentence(content),
        f"Intervals of means and ratios: 95 %, bootstrap over plants ({RESAMPLES} resamplings); of shares: 95 %, "
        "Wilson. About one in twenty of many such intervals misses its true value.",
    ]
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
