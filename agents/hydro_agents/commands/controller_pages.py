"""What the commands show of a protocol of controllers: the page, and the main figures on the terminal."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from hydro_agents.commands.protocols import PageOf
from hydro_agents.evaluation.participants import split_name
from hydro_agents.evaluation.runner import NOT_APPLICABLE, Results
from hydro_agents.report.controllers_page import Example, controllers_page
from hydro_agents.report.kit import Page
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.limit_cycles import rest_warning
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.running.text import Table

EXAMPLE_FAMILIES = {"step": "steps", "start_stop": "start–stop moves"}


def robustness_page() -> PageOf:
    """The page of a robustness protocol."""

    def draw(results: Results) -> Page:
        return controllers_page(results.protocol.title, results.tables())

    return PageOf("robustness.html", draw, summary, remarks)


def study_page(configuration: str) -> PageOf:
    """The page of a study with these settings (YAML)."""

    def draw(results: Results) -> Page:
        examples = example_traces(results)
        return controllers_page(results.protocol.title, results.tables(), examples, configuration)

    return PageOf("report.html", draw, summary, remarks)


def example_traces(results: Results) -> list[Example]:
    """Time traces of two test episodes under every controller (of several training seeds the first), at every leak."""
    protocol, runs = results.protocol, {}
    families, leaks = list(EXAMPLE_FAMILIES), sorted(protocol.leak_levels)
    count = len(families) * len(leaks)
    cases = Cases(
        np.full(count, EXPERIMENT_AXES.first, dtype=np.int64),
        np.tile(leaks, len(families)),
        np.repeat(families, len(leaks)),
    )
    for label, controller in results.participants.controllers.items():
        name = split_name(label)[0]
        if name in results.controllers and name not in runs:
            runs[name] = run_cases(protocol.task, controller, cases)
    examples = []
    for case, (family, leak) in enumerate(product(families, leaks)):
        examples.append(Example(EXAMPLE_FAMILIES[family], leak, runs, case))
    return examples


def summary(results: Results) -> Iterator[Table]:
    """Errors, worst case and costs as ratios; mean return; failed episodes; standstills with a limit cycle."""
    title = f"Ratios to {results.controllers[0]}, and mean return; conditions and families weighted equally"
    header = ("controller", "error", "[95 %]", "worst", "return", "travel", "rev.", "fails", "cycles")
    pattern = "{controller}|{equal_weight:.3f}|{equal_weight_low:.2f}–{equal_weight_high:.2f}|{worst_ratio:.2f}"
    pattern += "|{return:.2f}|{travel_ratio:.2f}|{reversals_ratio:.2f}|{failures}|{limit_cycles}/{standstills}"
    rows = []
    for row in results.table("ranking").to_dict("records"):
        rows.append(tuple(cell.format(**row) for cell in pattern.split("|")))
    yield Table(title, header, rows)


def remarks(results: Results) -> Iterator[str]:
    """One line per condition that does not apply to some controllers, and per controller that does not come to rest."""
    absent = results.status[results.status["status"] == NOT_APPLICABLE]
    for condition, rows in absent.groupby("condition", sort=False):
        yield f"{condition}: not applicable to {', '.join(rows['controller'])}: {rows['message'].iloc[0]}"
    for row in results.table("limit_cycle_summary").to_dict("records"):
        if warning := rest_warning(row["controller"], row, baseline=row["controller"] == results.controllers[0]):
            yield warning
