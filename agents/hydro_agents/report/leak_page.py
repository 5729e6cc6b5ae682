"""Writes the page of the leakage protocol: one HTML file without external parts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.report.leak_findings import findings
from hydro_agents.report.leak_page_tables import (
    alarm_tables,
    conditions_tables,
    confusions,
    detection_tables,
    masking_tables,
    size_tables,
)
from hydro_agents.report.leak_pictures import (
    coverage_plots,
    detection_plot,
    fault_plots,
    masking_plot,
    motion_plots,
    reliability_plot,
    size_plot,
)
from hydro_agents.report.leak_record import Record
from hydro_agents.report.page import Page, make_page
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table

HERE = Path(__file__).parent
PAGE_FILE = "leakage.html"


def write_leak_report(folder: Path, tables: Mapping[str, pd.DataFrame], protocol: LeakProtocol) -> None:
    """Write the page :data:`PAGE_FILE`.

    Args:
        folder: of the results.
        tables: of the protocol, by the name of their CSV file.
        protocol: the protocol.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    render_page(Record(tables, protocol.base)).write(folder / PAGE_FILE)


def render_page(record: Record) -> Page:
    """The page."""
    facts = record.facts()
    return make_page(
        HERE / "leakage.html.j2",
        Origin.of(facts),
        title=facts.get("title", "Leak detection"),
        detectors=record.detectors,
        findings=findings(record),
        problems=problems(record),
        small=[*detection_plot(record), *size_plot(record)],
        alarms=alarm_tables(record),
        motions=motion_plots(record),
        faults=fault_plots(record),
        confusions=confusions(record),
        reliability=reliability_plot(record),
        coverage=coverage_plots(record),
        masking=masking_plot(record),
        masking_tables=masking_tables(record),
        detection=detection_tables(record),
        sizes=size_tables(record),
        facts=Table("Facts of this run", ("Fact", "Value"), list(facts.items())),
        conditions=conditions_tables(record),
    )


def problems(record: Record) -> list[str]:
    """Detectors that failed or were not applicable under a condition, one line each."""
    status = record.table("status")
    if status.empty:
        return []
    failed = status[status["status"] == "failed"].to_dict("records")
    lines = [f"{row['detector']} failed under {record.label(row['condition'])}: {row['message']}" for row in failed]
    absent = status[status["status"] == "not applicable"]
    for name, frame in absent.groupby("detector", sort=False):
        where = ", ".join(record.label(str(condition)) for condition in frame["condition"])
        lines.append(f"{name} did not read {where}: {frame['message'].iloc[0]}.")
    return lines
