"""Writes the page of the robustness protocol: one HTML file without external parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pandas as pd

from hydro_agents.report.heat import SCALE, colour_share, heat_map
from hydro_agents.report.page import Page, make_page
from hydro_agents.report.price_plots import price_plots
from hydro_agents.report.robustness_findings import findings
from hydro_agents.report.robustness_page_tables import (
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
from hydro_agents.report.robustness_pictures import (
    bode_plots,
    failure_plots,
    gap_plot,
    profile_plots,
    stiffness_plots,
)
from hydro_agents.report.robustness_record import Record, Trace
from hydro_agents.report.text import Table, setting
from hydro_agents.report.traces import Replay, worst_traces
from hydro_agents.running.machine import Origin
from hydro_env import TaskConfig

HERE = Path(__file__).parent

PAGE_FILE = "robustness.html"


def write_robustness_report(
    folder: Path,
    tables: Mapping[str, pd.DataFrame],
    task: TaskConfig,
    replay: Replay,
) -> None:
    """Repeat the worst cases, and write the page.

    Args:
        folder: of the results; the page is :data:`PAGE_FILE` in it.
        tables: of the protocol, by the name of their CSV file.
        task: of the protocol.
        replay: runs one case of the table ``cases`` again.

    Raises:
        ConfigurationError: a file cannot be written.
    """
    record = Record(tables)
    traces: list[Trace] = []
    if len(record.names) > 1:
        preview = max(task.references.preview_times, default=0.0)
        traces = worst_traces(replay, record.table("cases"), record.baseline, record.label, preview)
    render_page(replace(record, traces=traces)).write(folder / PAGE_FILE)


def render_page(record: Record) -> Page:
    """The page."""
    bases = record.corrects().values()
    record = record.with_full_names()
    facts = record.facts()
    return make_page(
        HERE / "robustness.html.j2",
        Origin.of(facts),
        title=facts.get("title", "Robustness of servo axis controllers"),
        names=record.names,
        baseline=record.baseline,
        corrects=dict(zip(record.corrects(), bases, strict=True)),
        findings=findings(record),
        problems=problems(record),
        heat=heat_map(record),
        scale=[(setting(ratio), "better" if ratio < 1.0 else "worse", colour_share(ratio)) for ratio in SCALE],
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
        price=price_plots(record.table("leak_price")),
        price_tables=[*price_table(record), *energy_table(record)],
        sees=sees_table(record),
        facts=Table("Facts of this run", ("Fact", "Value"), list(facts.items())),
        conditions=conditions_table(record),
    )


def problems(record: Record) -> list[str]:
    """Controllers that failed or were not applicable under a condition, one line each."""
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
    """Changes of each condition."""
    table = record.table("conditions")
    if table.empty:
        return []
    columns = [name for name in ("label", "description", "changes", "cases") if name in table]
    rows = [tuple(str(row[name]) for name in columns) for row in table.fillna("").to_dict("records")]
    return [Table("", tuple(columns), rows)]
