"""``hydro evaluate --protocol``: controllers, or leak detectors, under every condition of a protocol."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.conditions import Protocol, file_sha256
from hydro_agents.evaluation.participants import (
    Participants,
    participants,
    shipped_controllers,
    split_name,
)
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.runner import NOT_APPLICABLE, Results, run
from hydro_agents.report.content import Content, interval
from hydro_agents.report.page import FIGURE_FILES
from hydro_agents.report.robustness import PAGE_FILE, ROBUSTNESS
from hydro_agents.report.sections import render_page, sections_named
from hydro_agents.running.console import ProgressDisplay, console_table
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import RESULT_FILES
from hydro_agents.running.machine import date_now, machine_description, package_versions
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.text import Table, number
from hydro_env import ConfigurationError
from hydro_env.files import write_yaml
from hydro_env.folders import config_file

PROTOCOL_FILE = "protocol.yaml"

AnyProtocol = TypeVar("AnyProtocol", bound=Protocol[Any])


class Options(NamedTuple):
    """How a protocol runs; ``None`` means the protocol's own value, or the default."""

    task: str | None  # name or file
    rig: Path | None
    output: Path | None  # default: results/<name of the protocol>
    resume: bool  # use the finished jobs in the folder
    overwrite: bool  # replace the results in the folder
    command: str  # the command line

    def moved(self, protocol: AnyProtocol) -> AnyProtocol:
        """The protocol with another task or on another rig, if one is given."""
        return protocol if self.task is None and self.rig is None else protocol.moved(self.task, self.rig)


class PageOf(NamedTuple):
    """What a kind of protocol shows of its results."""

    file: str
    sections: Sequence[str]  # unless the protocol names its own
    content: Callable[[Results], Content]
    summary: Callable[[Results], Table]  # the main figures, for the terminal
    remarks: Callable[[Results], Iterable[str]] = lambda _: ()  # lines after the summary


def evaluate_protocol(file: Path, agents: Mapping[str, str], study_file: Path | None, options: Options) -> None:
    """Run a robustness protocol, write its tables and its page.

    Args:
        file: of the protocol.
        agents: more controllers, by NAME or NAME#SEED, as texts of ``load_controller``.
        study_file: a study whose controllers take part; default: all shipped controllers.
        options: how it runs.

    Raises:
        ConfigurationError: protocol, study or agents are wrong, the folder cannot be used, or a controller failed (the
            results of the others are written first).
    """
    protocol = options.moved(RobustnessProtocol.from_yaml(file))
    chosen = _participants(protocol, agents, study_file)

    def content(results: Results) -> Content:
        return Content(results.tables(), protocol.task)

    run_protocol(protocol, file, chosen, options, PageOf(PAGE_FILE, ROBUSTNESS, content, _ranking, _absences))


def run_protocol(
    protocol: Protocol[Any],
    file: Path,
    chosen: Any,
    options: Options,
    page: PageOf,
) -> None:
    """Run a protocol of any kind, and write its tables and its page.

    Args:
        protocol: conditions and parts.
        file: of the protocol.
        chosen: the participants.
        options: how it runs.
        page: its page, and the figures for the terminal.

    Raises:
        ConfigurationError: the folder cannot be used, or a participant failed (the results of the others are written
            first).
    """
    sections_named(protocol.sections, f"{file}: sections")
    output = options.output if options.output is not None else Path("results") / file.stem
    writes = [PROTOCOL_FILE, RESULT_FILES, "tables/*.csv", page.file, FIGURE_FILES]
    with (
        output_folder(output, "evaluate", writes, resume=options.resume, overwrite=options.overwrite),
        ProgressDisplay() as display,
    ):
        write_yaml(output / PROTOCOL_FILE, protocol.model_dump(mode="json"))
        facts = {
            "file": str(file),
            "file_sha256": file_sha256(file),
            "date": date_now(),
            "command": options.command,
            "machine": machine_description(),
            **package_versions(),
        }
        results = run(protocol, chosen, output, None, display.update, list(facts.items()))
        results.write(output / "tables")
        display.update("page", 0, 1)
        sections = protocol.sections or page.sections
        render_page(protocol.title, sections, page.content(results)).write(output / page.file)
        display.update("page", 1, 1)
    display.console.lines(console_table(page.summary(results), whole=True))
    for remark in page.remarks(results):
        display.console.lines(remark)
    display.say(f"SHA-256 of the protocol: {facts['file_sha256']}")
    display.say(f"tables: {(output / 'tables').resolve()}")
    display.say(f"page: {(output / page.file).resolve()}")
    if errors := results.errors:
        more = f" (and {len(errors) - 1} more, see tables/status.csv)" if len(errors) > 1 else ""
        raise ConfigurationError(f"{errors[0]}{more}; {output} holds the other results")


def _participants(protocol: RobustnessProtocol, agents: Mapping[str, str], study_file: Path | None) -> Participants:
    """The controllers of the protocol; an agent replaces the one of the same name, with all its training seeds."""
    if study_file is None:
        controllers: dict[str, Controller | str | Path] = {**shipped_controllers(protocol.task), **agents}
    else:
        from hydro_agents.study.settings import StudySettings

        study = StudySettings.from_yaml(config_file("studies", study_file)).model_copy(update={"task": protocol.task})
        controllers = dict(study.with_gains_of_rig().with_weights(agents))
    seeded = {split_name(name)[0] for name in agents if SEED_MARK in name}
    controllers = {name: what for name, what in controllers.items() if name not in seeded or name in agents}
    return participants(controllers, protocol)


def _ranking(results: Results) -> Table:
    """Error, worst case and costs as ratios; failed episodes; standstills with a limit cycle."""
    title = f"Ratios to {results.grid.controllers[0]}; conditions and families weighted equally"
    header = ("controller", "error", "[95 %]", "worst", "travel", "rev.", "fails", "cycles")
    rows = [
        (
            str(row["controller"]),
            f"{row['equal_weight']:.3f}",
            f"{row['equal_weight_low']:.2f}–{row['equal_weight_high']:.2f}",
            *(f"{row[name]:.2f}" for name in ("worst_ratio", "travel_ratio", "reversals_ratio")),
            str(row["failures"]),
            f"{row['limit_cycles']}/{row['standstills']}",
        )
        for _, row in results.table("ranking").iterrows()
    ]
    return Table(title, header, rows)


def _absences(results: Results) -> Iterator[str]:
    """One line per condition that does not apply to some controllers."""
    absent = results.status[results.status["status"] == NOT_APPLICABLE]
    for condition, rows in absent.groupby("condition", sort=False):
        yield f"{condition}: not applicable to {', '.join(rows['controller'])}: {rows['message'].iloc[0]}"


def evaluate_leak_protocol(file: Path, head: Path | None, options: Options) -> None:
    """Run a leakage protocol, write its tables and its page.

    Args:
        file: of the protocol.
        head: weights of a leakage head that replaces that of the protocol.
        options: how it runs.

    Raises:
        ConfigurationError: the protocol or the weights are wrong, the folder cannot be used, or a detector failed (the
            results of the others are written first).
    """
    from hydro_agents.detection.detectors import make_detector
    from hydro_agents.detection.monitor import HeadDetector
    from hydro_agents.evaluation.leak_protocol import DRAWN, LeakProtocol
    from hydro_agents.report.leakage import LEAKAGE, PAGE_FILE, level_text

    protocol = options.moved(LeakProtocol.from_yaml(file))
    own = HeadDetector.load(head) if head is not None else None
    detectors = {name: make_detector(choice, own) for name, choice in protocol.detectors.items()}

    def content(results: Results) -> Content:
        return Content(results.tables(), protocol.task, {"base": protocol.base})

    def shares(results: Results) -> Table:
        """Share of windows that each detector reports under the base condition, by size of the leak."""
        found = content(results)
        levels = sorted(level for level in protocol.levels_in(protocol.base) if level != DRAWN)
        rows = []
        for name in found.detectors:
            cells = [found.row("detection", detector=name, condition=protocol.base, level=level) for level in levels]
            rows.append((name, *(number(interval(cell, "flagged", 100.0).value, 1) for cell in cells)))
        title = f"Windows reported as a leak, %: {found.label(protocol.base)}"
        return Table(title, ("detector", *map(level_text, levels)), rows)

    page = PageOf(PAGE_FILE, LEAKAGE, content, shares)
    run_protocol(protocol, file, detectors, options, page)
