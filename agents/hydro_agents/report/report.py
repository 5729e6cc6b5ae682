"""The report of an evaluation as one HTML file: sentences first, then figures, tables and the method.

Every number comes from the tables of the :class:`~hydro_agents.evaluation.protocol.Evaluation`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.evaluation.protocol import Evaluation
from hydro_agents.report.canvas import Look, Plot, controllers_of, looks_of
from hydro_agents.report.detection_plots import detection_plots
from hydro_agents.report.findings import caution, failures, findings, plants_of
from hydro_agents.report.page import Page, make_page
from hydro_agents.report.plots import level_plot, tracking_plots
from hydro_agents.report.shared import price_plots, price_sentence
from hydro_agents.report.tables import (
    definitions,
    detection_tables,
    level_tables,
    metric_table,
    metric_tables,
    overview,
    ratio_tables,
)
from hydro_agents.report.traces import Example, example_limits, example_plot
from hydro_agents.report.training_plots import learning_plots, training_plots
from hydro_agents.running.machine import Origin
from hydro_agents.running.resampling import RESAMPLES
from hydro_agents.running.seeds import TEST_SEEDS, TRAINING_SEEDS, VALIDATION_SEEDS
from hydro_agents.running.text import Table, correction_name, duration, family_name, listed, setting, span
from hydro_env.files import write_whole

HERE = Path(__file__).parent

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class StudyRecord:
    """Facts of a study for its report."""

    title: str
    configuration: str  # YAML text of the study configuration
    command: str  # command line of the study
    versions: dict[str, str]  # package → version; commit
    machine: str
    seed: int
    timings: dict[str, float]  # phase → seconds
    training_curve: pd.DataFrame  # see hydro_agents.report.training_plots; may be empty
    examples: list[Example]  # the same episodes at every leak
    corrects: Mapping[str, str] = field(default_factory=dict)  # controller → controller that it corrects
    date: str = ""  # UTC
    leak_price: pd.DataFrame = field(
        default_factory=pd.DataFrame
    )  # see hydro_agents.evaluation.leak_price; may be empty
    validation_error_mm: float = float("nan")  # of the first controller, on the plants of the training curve


def write_report(path: Path, evaluation: Evaluation, record: StudyRecord) -> None:
    """Write the report as one HTML file without external parts, and its figures into a folder beside it.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    render_report(evaluation, record).write(path)


def render_report(evaluation: Evaluation, record: StudyRecord) -> Page:
    """The report. A controller that corrects another is named like 'PPO on PID'."""
    names = {name: correction_name(name, base) for name, base in record.corrects.items()}
    evaluation, record = _renamed(evaluation, record, names)
    looks = looks_of(controllers_of(evaluation))
    energy = level_plot(
        evaluation,
        "supply_energy_j",
        "energy, J",
        "mean",
        "Energy from the supply by leak size",
        "Mean over all runs; the motions are the same for every leak.",
    )
    return make_page(
        HERE / "report.html.j2",
        Origin.of({**record.versions, "command": record.command, "date": record.date}),
        record=record,
        names=list(looks),
        corrects={names[name]: base for name, base in record.corrects.items() if names[name] in looks},
        errors=list(evaluation.errors.values()),
        healthy=setting(evaluation.bounds.healthy_up_to),
        findings=findings(evaluation),
        caution=caution(evaluation),
        failures=failures(evaluation),
        overview=overview(evaluation),
        tracking_plots=tracking_plots(evaluation),
        tracking_tables=[metric_table(evaluation, by, "mean_error_mm") for by in ("level", "family")],
        ratio_tables=ratio_tables(evaluation),
        metric_tables={by: metric_tables(evaluation, by) for by in ("level", "family")},
        levels=_levels(evaluation, record),
        level_plots=_level_plots(record, looks),
        price_plots=[*(price_plots(record.leak_price) if len(record.leak_price) else []), energy],
        detection_plots=detection_plots(evaluation),
        detection_tables=detection_tables(evaluation),
        learning_plots=learning_plots(record.training_curve, next(iter(looks)), record.validation_error_mm, looks),
        training_plots=training_plots(record.training_curve, looks),
        protocol=_protocol(evaluation),
        definitions=definitions(),
        versions=Table("Versions", ("Package", "Version"), list(record.versions.items())),
        timings=Table("Time taken", ("Phase", "Time"), [(k, duration(v)) for k, v in record.timings.items()]),
    )


def _levels(evaluation: Evaluation, record: StudyRecord) -> list[tuple[str, Table, str]]:
    """Each leak as text, its errors and costs, and a sentence about its cost with any controller."""
    return [
        (setting(level), table, price_sentence(record.leak_price, level))
        for level, table in level_tables(evaluation).items()
    ]


def _level_plots(record: StudyRecord, looks: Mapping[str, Look]) -> list[list[Plot]]:
    """The example episodes, one list per leak; an episode has the same scale at every leak."""
    limits = {
        title: example_limits([example for example in record.examples if example.title == title])
        for title in {example.title for example in record.examples}
    }
    plots: dict[float, list[Plot]] = {}
    for number, example in enumerate(record.examples):
        plot = example_plot(example, f"run-{number}", looks, limits[example.title])
        plots.setdefault(example.leak, []).append(plot)
    return [plots[leak] for leak in sorted(plots)]


def _renamed(evaluation: Evaluation, record: StudyRecord, names: Mapping[str, str]) -> tuple[Evaluation, StudyRecord]:
    """Evaluation and record with new names of controllers."""
    if not names:
        return evaluation, record
    tables = {
        name: table.assign(**{c: table[c].replace(names) for c in ("controller", "against") if c in table})
        for name, table in _tables(evaluation).items()
    }
    curve = record.training_curve
    if "controller" in curve:
        curve = curve.assign(controller=curve["controller"].replace(names))
    examples = [example.renamed(names) for example in record.examples]
    return replace(evaluation, **tables), replace(record, examples=examples, training_curve=curve)


def _tables(evaluation: Evaluation) -> dict[str, pd.DataFrame]:
    values = {part.name: getattr(evaluation, part.name) for part in fields(evaluation)}
    return {name: table for name, table in values.items() if isinstance(table, pd.DataFrame)}


def write_tables(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Write every table that is not empty as CSV; returns the files.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    written = []
    for name, table in _tables(evaluation).items():
        if not table.empty:
            written.append(Path(folder) / f"{name}.csv")
            write_whole(written[-1], table.to_csv(index=False).encode())
    return written


def _span(seeds: pd.Series | range) -> str:
    return span(min(seeds), max(seeds))


def _protocol(evaluation: Evaluation) -> list[str]:
    """The method as sentences, with numbers from the tables."""
    cases = evaluation.cases
    levels = [setting(level) for level in sorted(cases["leakage_flow_lpm"].unique())]
    families = [family_name(str(name)) for name in cases["family"].unique()]
    runs = len(cases) // len(controllers_of(evaluation))
    sentences = [
        f"Tracking: {runs} runs per controller. For each kind of reference ({listed(families)}) there are "
        f"{plants_of(evaluation)} plants, each run at every leak size ({listed(levels)} l/min at 100 bar across the "
        "piston).",
        "Every controller runs on the same plants, references and sensor noise: all comparisons are paired.",
        _seeds_sentence(evaluation),
        f"Intervals of means and ratios: 95 %, bootstrap over plants ({RESAMPLES} resamplings); of shares: 95 %, "
        "Wilson. About one in twenty of many such intervals misses its true value.",
    ]
    if not evaluation.detection.empty:
        row = evaluation.detection_summary.iloc[0]
        sentences.append(
            f"Detection: {int(row['healthy_episodes'])} healthy and {int(row['leaking_episodes'])} leaking episodes "
            f"per controller, on other plants (seeds {_span(evaluation.detection['seed'])}); leak sizes are "
            "log-uniform, kinds of reference are drawn at random. The network reads the signals of one whole episode."
        )
    return sentences


def _seeds_sentence(evaluation: Evaluation) -> str:
    """Sentence about the seeds used, and whether all of them are test seeds."""
    tables = [table["seed"] for table in (evaluation.cases, evaluation.detection) if not table.empty]
    inside = all(min(seeds) >= TEST_SEEDS.start and max(seeds) < TEST_SEEDS.stop for seeds in tables)
    kept = "so no plant used here took part in training or in setting thresholds"
    broken = "but some runs here used seeds outside the test seeds; a controller may have been trained on them"
    return (
        f"A seed fixes plant, reference and noise. Tracking uses seeds {_span(evaluation.cases['seed'])}; training "
        f"uses {_span(TRAINING_SEEDS)}, validation {_span(VALIDATION_SEEDS)}, {kept if inside else broken}."
    )
