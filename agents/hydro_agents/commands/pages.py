"""What a command shows of the results of a protocol: its page, and its main figures on the terminal."""

from collections.abc import Callable, Iterable, Iterator
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hydro_agents.evaluation.robustness_protocol import split_name
from hydro_agents.evaluation.runner import NOT_APPLICABLE, Results
from hydro_agents.report.controllers_page import Example, controllers_page
from hydro_agents.report.kit import Page, as_text
from hydro_agents.report.leakage_page import leakage_page
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.console import ProgressDisplay, console_table
from hydro_agents.running.limit_cycles import rest_warning
from hydro_agents.running.machine import Origin
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.running.text import FAMILY_NAMES, Table, setting
from hydro_env import ConfigurationError

EXAMPLE_FAMILIES = ("step", "start_stop")


class PageOf(NamedTuple):
    """What a command shows of the results of a protocol."""

    file: str
    draw: Callable[[Results], Page]
    summary: Callable[[Results], Iterable[Table]]  # the main figures, for the terminal
    remarks: Callable[[Results], Iterable[str]] = lambda _: ()  # lines after the summary

    @property
    def files(self) -> list[str]:
        """Names of the files that :meth:`write` may write."""
        return ["tables/*.csv", self.file]

    def write(self, results: Results, output: Path, display: ProgressDisplay) -> None:
        """Write the tables and the page of results into a folder."""
        results.write(output / "tables")
        display.update("page", 0, 1)
        self.draw(results).write(output / self.file, Origin.of(dict(results.facts)))
        display.update("page", 1, 1)

    def tell(self, results: Results, output: Path, display: ProgressDisplay) -> None:
        """Print the main figures, and where the results are.

        Raises:
            ConfigurationError: a participant failed.
        """
        for table in self.summary(results):
            display.console.table(console_table(table, whole=True))
        for remark in self.remarks(results):
            display.say(remark)
        display.say(f"tables: {(output / 'tables').resolve()}")
        display.say(f"page: {(output / self.file).resolve()}")
        if errors := results.errors:
            more = f" (and {len(errors) - 1} more, see tables/status.csv)" if len(errors) > 1 else ""
            raise ConfigurationError(f"{errors[0]}{more}; {output} holds the other results")


# Controllers ----------------------------------------------------------------------------------------------------------


def study_page(configuration: str) -> PageOf:
    """The page of a study with these settings (YAML)."""

    def draw(results: Results) -> Page:
        return controllers_page(results.protocol.title, results.tables(), example_traces(results), configuration)

    return PageOf("report.html", draw, summary, remarks)


def example_traces(results: Results) -> list[Example]:
    """Time traces of test episodes under every controller (of several training seeds the first), at every leak.

    There is one of each kind of reference in :data:`EXAMPLE_FAMILIES` that the protocol has.
    """
    protocol, runs = results.protocol, {}
    families = [family for family in EXAMPLE_FAMILIES if family in protocol.families]
    leaks = sorted(protocol.leak_levels)
    seeds = np.full(len(families) * len(leaks), EXPERIMENT_AXES.first, np.int64)
    cases = Cases(seeds, np.tile(leaks, len(families)), np.repeat(families, len(leaks)))
    for label, controller in results.participants.controllers.items():
        name = split_name(label)[0]
        if families and name in results.controllers and name not in runs:
            runs[name] = run_cases(protocol.task, controller, cases)
    kinds = enumerate(product(families, leaks))
    return [Example(FAMILY_NAMES[family], leak, runs, case) for case, (family, leak) in kinds]


def summary(results: Results) -> Iterator[Table]:
    """Errors, worst case and costs as ratios; mean return; failed episodes; standstills with a limit cycle."""
    title = f"Ratios to {results.controllers[0]}, and mean return; conditions and families weighted equally"
    header = ("controller", "error", "[95 %]", "worst", "return", "travel", "rev.", "fails", "cycles")
    pattern = "{controller}|{equal_weight:.3f}|{equal_weight_low:.2f}–{equal_weight_high:.2f}|{worst_ratio:.2f}"
    pattern += "|{return:.2f}|{travel_ratio:.2f}|{reversals_ratio:.2f}|{failures}|{limit_cycles}/{standstills}"
    cells, records = pattern.split("|"), results.table("ranking").to_dict("records")
    yield Table(title, header, [tuple(cell.format(**row) for cell in cells) for row in records])


def remarks(results: Results) -> Iterator[str]:
    """One line per condition that does not apply to some controllers, and per controller that does not come to rest."""
    absent = results.status[results.status["status"] == NOT_APPLICABLE]
    for condition, rows in absent.groupby("condition", sort=False):
        yield f"{condition}: not applicable to {', '.join(rows['controller'])}: {rows['message'].iloc[0]}"
    for row in results.table("limit_cycle_summary").to_dict("records"):
        if warning := rest_warning(row["controller"], row, baseline=row["controller"] == results.controllers[0]):
            yield warning


ROBUSTNESS_PAGE = PageOf(
    "robustness.html", lambda results: controllers_page(results.protocol.title, results.tables()), summary, remarks
)


# Detectors ------------------------------------------------------------------------------------------------------------


def shares(results: Results) -> Iterator[Table]:
    """Share of windows that each detector reports under the base condition, by size of the leak."""
    found, base = results.table("detection"), results.protocol.base
    found = found[found["condition"] == base]
    rates = 100.0 * found.pivot(index="detector", columns="level", values="flagged").loc[found["detector"].unique()]
    rates = rates.rename(columns=lambda level: f"{setting(level)} l/min" if level > 0.0 else "healthy")
    yield as_text(rates, f"Windows reported as a leak, %: {base}")


LEAKAGE_PAGE = PageOf(
    "leakage.html",
    lambda results: leakage_page(results.protocol.title, results.tables(), results.protocol.base),
    shares,
)
