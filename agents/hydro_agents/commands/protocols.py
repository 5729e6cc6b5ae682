"""Runs a protocol for a command: its folder, its tables, its page, and its main figures on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from hydro_agents.evaluation.conditions import Protocol
from hydro_agents.evaluation.runner import Results, run
from hydro_agents.running.console import ProgressDisplay, console_table
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import RESULT_FILES
from hydro_agents.running.machine import date_now, machine_description, package_versions
from hydro_agents.running.text import Table
from hydro_env import ConfigurationError
from hydro_env.files import write_yaml

AnyProtocol = TypeVar("AnyProtocol", bound=Protocol[Any])


class Options(NamedTuple):
    """How a protocol runs; ``None`` means the protocol's own value."""

    task: str | None  # name or file
    rig: Path | None
    output: Path
    resume: bool  # use the finished jobs in the folder
    overwrite: bool  # replace the results in the folder
    command: str  # the command line

    def moved(self, protocol: AnyProtocol) -> AnyProtocol:
        """The protocol with another task or on another rig, if one is given."""
        return protocol if self.task is None and self.rig is None else protocol.moved(self.task, self.rig)


class PageOf(NamedTuple):
    """What a command shows of the results of a protocol."""

    file: str
    draw: Callable[[Results, Path], None]  # writes the page into a file
    summary: Callable[[Results], Iterable[Table]]  # the main figures, for the terminal
    remarks: Callable[[Results], Iterable[str]] = lambda _: ()  # lines after the summary


def page_files(page: PageOf) -> list[str]:
    """Names of the files that :func:`write_results` may write."""
    return ["tables/*.csv", page.file]


def facts_of(command: str, **more: str) -> Sequence[tuple[str, str]]:
    """Keys and values of a run: date, command, machine, versions, and more."""
    facts = {**more, "date": date_now(), "command": command, "machine": machine_description(), **package_versions()}
    return list(facts.items())


def run_protocol(
    protocol: Protocol[Any],
    chosen: Any,
    options: Options,
    page: PageOf,
    settings: tuple[str, Mapping[str, Any]],
    facts: Sequence[tuple[str, str]],
) -> None:
    """Run a protocol of any kind, and write its tables and its page.

    Args:
        protocol: conditions and parts.
        chosen: the participants.
        options: how it runs.
        page: its page, and the figures for the terminal.
        settings: name and content of the YAML file that tells what ran.
        facts: keys and values of the run.

    Raises:
        ConfigurationError: the folder cannot be used, or a participant failed (the results of the others are written
            first).
    """
    output, (file, content) = options.output, settings
    writes = [file, RESULT_FILES, *page_files(page)]
    with (
        output_folder(output, "evaluate", writes, resume=options.resume, overwrite=options.overwrite),
        ProgressDisplay() as display,
    ):
        write_yaml(output / file, content)
        results = run(protocol, chosen, output, None, display.update, facts)
        write_results(results, output, page, display)
    tell(results, output, page, display)


def write_results(results: Results, output: Path, page: PageOf, display: ProgressDisplay) -> None:
    """Write the tables and the page of results into a folder."""
    results.write(output / "tables")
    display.update("page", 0, 1)
    page.draw(results, output / page.file)
    display.update("page", 1, 1)


def tell(results: Results, output: Path, page: PageOf, display: ProgressDisplay) -> None:
    """Print the main figures, and where the results are.

    Raises:
        ConfigurationError: a participant failed.
    """
    for table in page.summary(results):
        display.console.lines(console_table(table, whole=True))
    for remark in page.remarks(results):
        display.say(remark)
    display.say(f"tables: {(output / 'tables').resolve()}")
    display.say(f"page: {(output / page.file).resolve()}")
    if errors := results.errors:
        more = f" (and {len(errors) - 1} more, see tables/status.csv)" if len(errors) > 1 else ""
        raise ConfigurationError(f"{errors[0]}{more}; {output} holds the other results")
