"""One self-contained HTML file that tells an evaluation: sentences first, then figures, tables and how it was done.

Every number comes from the tables of the :class:`~agents.evaluation.protocol.Evaluation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from markupsafe import Markup
from numpy.typing import NDArray

from agents.evaluation.metrics import METRICS
from agents.evaluation.protocol import Evaluation
from agents.evaluation.statistics import RESAMPLES, Interval
from agents.report.canvas import controllers_of, looks_of
from agents.report.detection_plots import detection_plots
from agents.report.findings import (
    caution,
    decimals_for,
    failures,
    family_name,
    findings,
    interval_text,
    listed,
    number,
    percent,
    plants_of,
    row_interval,
    verdict,
)
from agents.report.plots import example_plot, tracking_plots, training_plot
from agents.running.seeds import TEST_SEEDS, TRAINING_SEEDS, VALIDATION_SEEDS
from hydro_env.files import write_whole

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Example:
    """One test episode under every controller. Arrays (T,)."""

    title: str
    time: Array  # s
    reference: Array  # m
    position: dict[str, Array]  # controller → m
    command: dict[str, Array]  # controller → parts of 10 V


@dataclass(frozen=True)
class StudyRecord:
    """What a report tells besides the evaluation."""

    title: str
    configuration: str  # YAML text of the study configuration
    command: str  # command line that made it
    versions: dict[str, str]  # package → version
    machine: str
    seed: int
    timings: dict[str, float]  # phase → seconds
    training_curve: pd.DataFrame  # columns: steps, seconds, mean_reward; may be empty
    examples: list[Example]


@dataclass(frozen=True)
class Table:
    """A table of texts; the first column names its rows."""

    caption: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    groups: tuple[tuple[str, int], ...] = ()  # (title, columns) above the header, after the first column


def write_report(path: Path, evaluation: Evaluation, record: StudyRecord) -> None:
    """Write the report as one HTML file without external parts.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    write_whole(path, render_report(evaluation, record).encode())


def render_report(evaluation: Evaluation, record: StudyRecord) -> str:
    """The report as HTML."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    source = files("agents.report").joinpath("report.html.j2").read_text(encoding="utf-8")
    looks = looks_of(controllers_of(evaluation))
    return environment.from_string(source).render(
        record=record,
        names=list(looks),
        healthy=f"{evaluation.bounds.healthy_up_to:g}",
        findings=findings(evaluation),
        caution=caution(evaluation),
        failures=failures(evaluation),
        tracking_plots=tracking_plots(evaluation),
        tracking_tables=[_metric_table(evaluation, by, "mean_error_mm") for by in ("level", "family")],
        ratio_tables=_ratio_tables(evaluation),
        metric_tables={by: _metric_tables(evaluation, by) for by in ("level", "family")},
        examples=[example_plot(example, i, looks) for i, example in enumerate(record.examples)],
        detection_plots=detection_plots(evaluation),
        detection_tables=_detection_tables(evaluation),
        training_plot=training_plot(record.training_curve),
        protocol=_protocol(evaluation),
        definitions=_definitions(),
        versions=Table("Versions", ("Package", "Version"), list(record.versions.items())),
        timings=Table("Time taken", ("Phase", "Time"), [(k, duration(v)) for k, v in record.timings.items()]),
        svg=lambda plot: Markup(plot.svg),
    )


def write_tables(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Write every table that is not empty as CSV; returns the files.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    written = []
    for field in fields(evaluation):
        table = getattr(evaluation, field.name)
        if isinstance(table, pd.DataFrame) and not table.empty:
            path = Path(folder) / f"{field.name}.csv"
            write_whole(path, table.to_csv(index=False).encode())
            written.append(path)
    return written


def duration(seconds: float) -> str:
    """Seconds as a person says them."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


# Tables -------------------------------------------------------------------------------------------------------------

SHOWN: dict[str, tuple[str, str, float]] = {
    "mean_error_mm": ("Mean error", "mm", 1.0),
    "rms_error_mm": ("Root-mean-square error", "mm", 1.0),
    "peak_error_mm": ("Peak error", "mm", 1.0),
    "settling_time_s": ("Settling time, where it settled", "s", 1.0),
    "unsettled_share": ("Standstills on which it never settled", "%", 100.0),
    "overshoot_percent": ("Overshoot of steps", "%", 1.0),
    "steady_state_error_mm": ("Steady-state error", "mm", 1.0),
    "itae_mm_s2": ("Time-weighted error (ITAE)", "mm s²", 1.0),
    "control_effort": ("Command, root mean square", "V", 10.0),
    "valve_travel_per_s": ("Spool travel", "strokes per second", 1.0),
    "failed": ("Failed runs", "%", 100.0),
}
"""Name, unit and factor with which a metric is shown."""


def _shown(metric: str) -> tuple[str, str, float]:
    return SHOWN.get(metric, (metric, METRICS[metric][0], 1.0))


def _group(by: str) -> tuple[str, str]:
    """Column, and head of the column, of what the rows of a table are."""
    return ("leakage_flow_lpm", "Leak, l/min") if by == "level" else ("family", "Reference")


def _metric_table(evaluation: Evaluation, by: str, metric: str) -> Table:
    """Mean with interval, worst 5 % and worst of every controller."""
    column, first = _group(by)
    table = evaluation.levels if by == "level" else evaluation.families
    table = table[table["metric"] == metric]
    label, unit, factor = _shown(metric)
    names = controllers_of(evaluation)
    means = factor * table["mean"].abs()
    decimals = decimals_for(float(means[means > 0.0].median()))
    rows = []
    for value in table[table["mean"].notna()][column].unique():
        cells = [f"{value:g}" if by == "level" else family_name(str(value))]
        for name in names:
            row = table[(table["controller"] == name) & (table[column] == value)].iloc[0]
            mean = Interval(*(factor * float(row[key]) for key in ("mean", "low", "high")))
            tail = (factor * float(row[key]) for key in ("cvar_5_percent", "worst"))
            cells += [interval_text(mean, decimals=decimals), *(number(part, decimals) for part in tail)]
        rows.append(tuple(cells))
    caption = f"{label}, {unit}, by {'leak size' if by == 'level' else 'kind of reference'}"
    header = (first, *("mean (95 % interval)", "worst 5 %", "worst run") * len(names))
    return Table(caption, header, rows, tuple((name, 3) for name in names))


def _metric_tables(evaluation: Evaluation, by: str) -> list[Table]:
    """All other metrics that have a value, and the failures where there are any."""
    frame = evaluation.levels if by == "level" else evaluation.families
    told = frame["mean"].notna() & ((frame["metric"] != "failed") | (frame["mean"] > 0.0))
    valued = {str(name) for name in frame[told]["metric"]} - {"mean_error_mm"}
    return [_metric_table(evaluation, by, metric) for metric in METRICS if metric in valued]


def _ratio_tables(evaluation: Evaluation) -> list[Table]:
    if evaluation.ratios.empty:
        return []
    plants, tables = plants_of(evaluation), []
    for name, frame in evaluation.ratios.groupby("controller", sort=False):
        rows = []
        for row in frame.to_dict("records"):
            interval, value = row_interval(row, "ratio"), str(row["value"])
            label = {"": "all runs"}.get(value, family_name(value))
            label = f"leak of {float(value):g} l/min" if row["group"] == "level" else label
            share = float(row["share_of_cases_better"])
            better = "–" if np.isnan(share) else f"{100.0 * share:.0f} %"
            rows.append((label, interval_text(interval, decimals=3), verdict(interval, plants), better))
        header = ("Runs", "ratio (95 % interval)", f"{name} …", "better in")
        tables.append(Table(f"Mean error of {name} over mean error of {frame['against'].iloc[0]}", header, rows))
    return tables


def _detection_tables(evaluation: Evaluation) -> list[Table]:
    if evaluation.detection.empty:
        return []
    return [
        _detection_rates(evaluation, "class", "Share of episodes flagged, by class of leak", "Class"),
        _detection_rates(evaluation, "range", "Share of leaks flagged, by size", "Leak, l/min"),
        _detection_summary(evaluation),
    ]


def _detection_rates(evaluation: Evaluation, group: str, caption: str, first: str) -> Table:
    rates, names = evaluation.detection_rates, controllers_of(evaluation)
    part = rates[rates["group"] == group]
    rows = []
    for value in part["value"].unique():
        each = [part[(part["controller"] == name) & (part["value"] == value)].iloc[0] for name in names]
        cells = [percent(row_interval(row, "flagged_share")) for row in each]
        rows.append((str(value), *cells, str(int(each[0]["episodes"]))))
    return Table(caption, (first, *names, "episodes"), rows)


SUMMARY: dict[str, tuple[str, float, int, str]] = {
    "auroc": ("Area under the ROC curve, leaks above {above:g} l/min", 1.0, 3, ""),
    "average_precision": ("Average precision, leaks above {above:g} l/min", 1.0, 3, ""),
    "threshold": ("Threshold of the leak probability", 1.0, 3, ""),
    "false_alarm_rate": ("False alarms at this threshold", 100.0, 1, " %"),
    "detection_rate_moderate": ("Leaks from {moderate:g} l/min flagged at this threshold", 100.0, 1, " %"),
    "detection_rate_moderate_at_1_percent": (
        "Leaks from {moderate:g} l/min flagged if the threshold gave 1 % false alarms on these very episodes",
        100.0,
        1,
        " %",
    ),
    "median_size_error_factor": ("Size: factor of error, half of the leaks within", 1.0, 2, ""),
    "p90_size_error_factor": ("Size: factor of error, nine in ten within", 1.0, 2, ""),
    "healthy_episodes": ("Healthy episodes", 1.0, 0, ""),
    "leaking_episodes": ("Leaking episodes", 1.0, 0, ""),
}
"""What the rows of the summary are called, factor, decimals, unit."""


def _detection_summary(evaluation: Evaluation) -> Table:
    summary = evaluation.detection_summary
    bounds = evaluation.bounds
    names = {"above": bounds.leaking_above, "moderate": bounds.moderate_from}
    rows = [
        (label.format(**names), *(f"{factor * float(value):.{decimals}f}{unit}" for value in summary[key]))
        for key, (label, factor, decimals, unit) in SUMMARY.items()
        if key in summary
    ]
    return Table("Detection, summary", ("Quantity", *map(str, summary["controller"])), rows)


def _definitions() -> Table:
    rows = []
    for name, (unit, meaning) in METRICS.items():
        rows.append((_shown(name)[0], meaning if unit == "1" else f"{meaning}; {unit}", name))
    return Table("Metrics of a run", ("Name", "meaning", "in the CSV files"), rows)


def _span(seeds: pd.Series | range) -> str:
    return f"{int(min(seeds))} to {int(max(seeds))}"


def _protocol(evaluation: Evaluation) -> list[str]:
    """How it was done, as sentences with numbers from the tables."""
    cases = evaluation.cases
    levels = [f"{level:g}" for level in sorted(cases["leakage_flow_lpm"].unique())]
    families = [family_name(str(name)) for name in cases["family"].unique()]
    runs = len(cases) // len(controllers_of(evaluation))
    sentences = [
        f"Tracking: {runs} runs per controller. For each kind of reference ({listed(families)}) there are "
        f"{plants_of(evaluation)} plants, each run at every leak size ({listed(levels)} l/min at 100 bar across the "
        "piston).",
        "Every controller meets the same plants, references and sensor noise, so that all comparisons are paired.",
        _seeds_sentence(evaluation),
        f"Intervals of means and ratios: 95 %, bootstrap over plants ({RESAMPLES} resamplings); of shares: 95 %, "
        "Wilson. Of many such intervals side by side, about one in twenty misses its true value.",
    ]
    if not evaluation.detection.empty:
        row = evaluation.detection_summary.iloc[0]
        sentences.append(
            f"Detection: {int(row['healthy_episodes'])} healthy and {int(row['leaking_episodes'])} leaking episodes "
            f"per controller, on other plants (seeds {_span(evaluation.detection['seed'])}); leak sizes are spread "
            "evenly over the logarithm, kinds of reference are drawn. The network sees the signals of one whole "
            "episode."
        )
    return sentences


def _seeds_sentence(evaluation: Evaluation) -> str:
    """Which seeds were used, and whether they are those kept for the test."""
    tables = [table["seed"] for table in (evaluation.cases, evaluation.detection) if not table.empty]
    inside = all(min(seeds) >= TEST_SEEDS.start and max(seeds) < TEST_SEEDS.stop for seeds in tables)
    kept = "so no plant met here took part in training or in setting thresholds"
    broken = "but some runs here used seeds outside those kept for the test: they may have been trained on"
    return (
        f"A seed fixes plant, reference and noise. Tracking uses seeds {_span(evaluation.cases['seed'])}; training is "
        f"given {_span(TRAINING_SEEDS)}, validation {_span(VALIDATION_SEEDS)}, {kept if inside else broken}."
    )
