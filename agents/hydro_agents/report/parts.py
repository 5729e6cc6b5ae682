"""Parts of several pages: what did not run, and the facts of the run."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from hydro_agents.report.kit import Page
from hydro_agents.running.text import duration


def problems(page: Page, tables: Mapping[str, pd.DataFrame], who: str) -> None:
    """What failed or did not apply, from the tables ``status`` and ``conditions``."""
    status = tables.get("status", pd.DataFrame({"status": []}))
    table = status[status["status"].isin(["failed", "not applicable"])]
    if len(table):
        labels = tables["conditions"].set_index("condition")["label"].to_dict()
        with page.fold("Some parts did not run", opened=(table["status"] == "failed").any()):
            table = table.replace({"condition": labels}).set_index(who)
            page.table(table[["condition", "status", "message"]], words=True)


def run_facts(
    page: Page,
    tables: Mapping[str, pd.DataFrame],
    timings: Mapping[str, float] | None = None,
    configuration: str = "",
) -> None:
    """The tables ``protocol`` and ``conditions``, durations (s) and settings (YAML text) of the run."""
    page.heading("This run")
    if "protocol" in tables:
        page.table(tables["protocol"].set_index("key"), words=True)
    if timings:
        times = {phase: duration(seconds) for phase, seconds in timings.items()}
        page.table(pd.DataFrame({"time": pd.Series(times)}), "Time taken")
    if configuration:
        with page.fold("Configuration"):
            page.code(configuration)
    if "conditions" in tables:
        with page.fold("All conditions"):
            used = tables["conditions"].set_index("condition").dropna(axis=1, how="all")
            page.table(used.astype(object).fillna(""), words=True)
