"""What the commands show of a protocol of controllers: the page, and the main figures on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from hydro_agents.commands.protocols import PageOf
from hydro_agents.evaluation.participants import split_name
from hydro_agents.evaluation.runner import NOT_APPLICABLE, Results
from hydro_agents.report.controllers_page import Example, controllers_page, detection_table
from hydro_agents.report.kit import as_text
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.limit_cycles import rest_warning
from hydro_agents.running.machine import Origin
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.running.text import Table

REPORT_FILE = "report.html"
EXAMPLE_FAMILIES = {"step": "steps", "start_stop": "start–stop moves"}


def robustness_page() -> PageOf:
    """The page of a robustness protocol."""

    def draw(results: Results, file: Path) -> None:
        page = controllers_page(results.protocol.title, results.tables())
        page.write(file, Origin.of(dict(results.facts)))

    return PageOf("robustness.html", draw, summary, remarks)


def study_page(configuration: str, timings: Mapping[str, float] | None = None) -> PageOf:
    """The page of a study.

    Args:
        configuration: the settings of the study, YAML.
        timings: s, by phase.
    """

    def draw(results: Results, file: Path) -> None:
        page = controllers_page(
            results.protocol.title,
            results.tables(),
            examples=example_traces(results),
            timings=timings,
            configuration=configuration,
        )
        page.write(file, Origin.of(dict(results.facts)))

    return PageOf(REPORT_FILE, draw, summary, remarks)


def example_traces(results: Results) -> list[Example]:
    """Time traces of two test episodes under every controller (of several training seeds the first), at every leak."""
    protocol, runs = results.protocol, {}
    kinds = [(family, leak) for family in EXAMPLE_FAMILIES for leak in sorted(protocol.leak_levels)]
    seeds = np.full(len(kinds), EXPERIMENT_AXES.first, dtype=np.int64)
    cases = Cases(seeds, np.array([leak for _, leak in kinds]), np.array([family for family, _ in kinds]))
    for label, controller in results.participants.controllers.items():
        name = split_name(label)[0]
        if name in results.controllers and name not in runs:
            runs[name] = run_cases(protocol.task, controller, cases)
    first = next(iter(runs.values()))
    examples = []
    for case, (family, leak) in enumerate(kinds):
        examples.append(
            Example(
                title=EXAMPLE_FAMILIES[family],
                time=first.time,
                reference=first.reference[case],
                position={name: found.position[case] for name, found in runs.items()},
                command={name: found.command[case] for name, found in runs.items()},
                leak=leak,
            )
        )
    return examples


def summary(results: Results) -> Iterator[Table]:
    """Errors, worst case and costs as ratios; failed episodes; standstills with a limit cycle. The detection."""
    title = f"Ratios to {results.controllers[0]}; conditions and families weighted equally"
    header = ("controller", "error", "[95 %]", "worst", "travel", "rev.", "fails", "cycles")
    rows = []
    for row in results.table("ranking").to_dict("records"):
        interval = f"{row['equal_weight_low']:.2f}–{row['equal_weight_high']:.2f}"
        ratios = (f"{row[name]:.2f}" for name in ("worst_ratio", "travel_ratio", "reversals_ratio"))
        cycles = f"{row['limit_cycles']}/{row['standstills']}"
        rows.append((row["controller"], f"{row['equal_weight']:.3f}", interval, *ratios, str(row["failures"]), cycles))
    yield Table(title, header, rows)
    if len(results.table("detection_summary")):
        yield as_text(detection_table(results.table("detection_summary")), "Detection, summary")


def remarks(results: Results) -> Iterator[str]:
    """One line per condition that does not apply to some controllers, and per controller that does not come to rest."""
    absent = results.status[results.status["status"] == NOT_APPLICABLE]
    for condition, rows in absent.groupby("condition", sort=False):
        yield f"{condition}: not applicable to {', '.join(rows['controller'])}: {rows['message'].iloc[0]}"
    for row in results.table("limit_cycle_summary").to_dict("records"):
        if warning := rest_warning(row["controller"], row, baseline=row["controller"] == results.controllers[0]):
            yield warning
