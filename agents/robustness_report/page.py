"""Writes the page of the robustness protocol as one HTML file without external parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
from markupsafe import Markup

from agents.evaluation.statistics import RESAMPLES
from agents.report.text import Table, templates
from agents.robustness_report.findings import findings
from agents.robustness_report.heat import heat_map
from agents.robustness_report.pictures import (
    bode_plots,
    failure_plots,
    gap_plot,
    price_plots,
    profile_plots,
    stiffness_plots,
)
from agents.robustness_report.record import Record, Trace
from agents.robustness_report.tables import (
    absolute_table,
    bandwidth_table,
    cycles_by_condition,
    energy_table,
    price_table,
    ranking_table,
    sees_table,
    standstill_tables,
    stiffness_table,
    worst_table,
)
from hydro_env.files import write_whole

HERE = Path(__file__).parent


def write_page(
    path: Path,
    tables: Mapping[str, pd.DataFrame],
    traces: Sequence[Trace] = (),
    errors: Mapping[str, str] | None = None,
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        tables: by the name of their CSV file: those of the protocol (``summary`` is needed), and those of
            :func:`~agents.experiments.series.run_experiments`. The section of a table that is missing is left out.
        traces: worst cases, of :func:`~agents.robustness_report.record.worst_traces`.
        errors: controllers whose experiments failed, with the reason.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    write_whole(path, render_page(Record(tables, traces, errors or {})).encode())


def render_page(record: Record) -> str:
    """The page as HTML."""
    facts = record.facts()
    return (
        templates(HERE)
        .get_template("page.html.j2")
        .render(
            title=facts.get("title", "Robustness of servo axis controllers"),
            names=record.names,
            baseline=record.baseline,
            findings=findings(record),
            problems=problems(record),
            heat=heat_map(record),
            heat_mean=heat_map(record, "ratio"),
            ranking=ranking_table(record),
            absolute=absolute_table(record),
            profiles=[*profile_plots(record), *gap_plot(record)],
            failures=failure_plots(record),
            worst=worst_table(record),
            bode=bode_plots(record),
            bandwidth=bandwidth_table(record),
            stiffness=stiffness_plots(record),
            stiffness_tables=stiffness_table(record),
            standstill=standstill_tables(record),
            cycles=cycles_by_condition(record),
            price=price_plots(record),
            price_tables=[*price_table(record), *energy_table(record)],
            sees=sees_table(record),
            facts=Table("", ("Fact", "Value"), list(facts.items())),
            conditions=conditions_table(record),
            resamples=RESAMPLES,
            svg=lambda plot: Markup(plot.svg),
        )
    )


def problems(record: Record) -> list[str]:
    """Controllers that failed, or did not apply, under a condition, one line each."""
    lines = [f"Experiments left out: {message}" for message in record.errors.values()]
    status = record.table("status")
    if status.empty:
        return lines
    failed = status[status["status"] == "failed"]
    lines += [
        f"{row['controller']} failed under {record.label(str(row['condition']))}: {row['message']}"
        for row in failed.to_dict("records")
    ]
    absent = status[status["status"] == "not applicable"]
    for name, frame in absent.groupby("controller", sort=False):
        where = ", ".join(record.label(str(condition)) for condition in frame["condition"])
        lines.append(f"{name} did not run under {where}: {frame['message'].iloc[0]}.")
    return lines


def conditions_table(record: Record) -> list[Table]:
    """What each condition changes."""
    table = record.table("conditions")
    if table.empty:
        return []
    columns = [name for name in ("label", "description", "changes", "cases") if name in table]
    rows = [tuple(str(row[name]) for name in columns) for row in table.fillna("").to_dict("records")]
    return [Table("", tuple(columns), rows)]
