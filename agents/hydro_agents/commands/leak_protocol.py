"""``hydro evaluate --protocol leakage``: every leak detector under every condition of a protocol."""

from __future__ import annotations

from pathlib import Path

import joblib

from hydro_agents.commands.robustness import PROTOCOL_FILE, Place
from hydro_agents.detection.alarm import AlarmSettings
from hydro_agents.detection.detectors import make_detector
from hydro_agents.detection.head import LeakageHead
from hydro_agents.evaluation.conditions import file_sha256
from hydro_agents.evaluation.leak_alarm_jobs import AlarmJob, alarm_plan
from hydro_agents.evaluation.leak_protocol import DRAWN, LeakProtocol
from hydro_agents.evaluation.leak_running import run_leak_protocol
from hydro_agents.evaluation.leak_tables import make_tables
from hydro_agents.report.content import Content
from hydro_agents.report.leakage import LEAKAGE, PAGE_FILE, level_text
from hydro_agents.report.page import FIGURE_FILES
from hydro_agents.report.sections import render_page
from hydro_agents.running.console import ProgressDisplay, console_table
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import JOBS_FOLDER, default_jobs
from hydro_agents.running.machine import date_now, machine_description, package_versions
from hydro_agents.running.text import Table, number
from hydro_env import ConfigurationError
from hydro_env.files import write_yaml


def evaluate_leak_protocol(
    file: Path, head: Path | None, place: Place, jobs: int | None, resume: bool, overwrite: bool, command: str
) -> None:
    """Run a leakage protocol, write its tables and its page.

    Args:
        file: of the protocol.
        head: weights of a leakage head that replaces that of the protocol.
        place: another task or rig, and the folder for the results.
        jobs: number of jobs side by side; default: one per core.
        resume: whether to use the finished jobs in the folder.
        overwrite: whether to replace the results in the folder.
        command: the command line.

    Raises:
        ConfigurationError: the protocol or the weights are wrong, the folder cannot be used, or a detector failed (the
            results of the others are written first).
    """
    protocol = LeakProtocol.from_yaml(file)
    if place.task is not None or place.rig is not None:
        protocol = protocol.moved(place.task, place.rig)
    own = LeakageHead.load(head) if head is not None else None
    detectors = {name: make_detector(choice, own) for name, choice in protocol.detectors.items()}
    digests = {name: str(joblib.hash(detector)) for name, detector in detectors.items()}
    facts = {
        "file": str(file),
        "file_sha256": file_sha256(file),
        "date": date_now(),
        "command": command,
        "machine": machine_description(),
        **package_versions(),
    }
    output = place.output if place.output is not None else Path("results") / file.stem
    writes = [PROTOCOL_FILE, f"{JOBS_FOLDER}/*.npz", "tables/*.csv", PAGE_FILE, FIGURE_FILES]
    with output_folder(output, "evaluate", writes, resume=resume, overwrite=overwrite), ProgressDisplay() as display:
        write_yaml(output / PROTOCOL_FILE, protocol.model_dump(mode="json"))
        alarms: list[AlarmJob] = []
        for name, settings in protocol.alarms.items() if protocol.alarm_hours > 0.0 else ():
            if not Path(settings).exists():
                display.say(f"{name}: no alarm: {settings} does not exist; hydro alarms writes it")
            else:
                watching, chosen = (
                    make_detector(protocol.detectors[name], own, following=True),
                    AlarmSettings.load(settings),
                )
                alarms += alarm_plan(name, watching, chosen, protocol.task, protocol.alarm_hours, digests[name])
        run = run_leak_protocol(protocol, detectors, digests, alarms, output, jobs or default_jobs(), display.update)
        display.update("page", 0, 1)
        tables = make_tables(protocol, run, list(facts.items()))
        tables.write(output / "tables")
        content = Content(tables.by_name(), protocol.task, {"base": protocol.base})
        render_page(protocol.title, LEAKAGE, content).write(output / PAGE_FILE)
        display.update("page", 1, 1)
    _print_shares(content, protocol, display)
    display.say(f"SHA-256 of the protocol: {facts['file_sha256']}")
    display.say(f"tables: {(output / 'tables').resolve()}")
    display.say(f"page: {(output / PAGE_FILE).resolve()}")
    failed = run.status[run.status["status"] == "failed"].to_dict("records")
    if failed:
        more = f" (and {len(failed) - 1} more, see tables/status.csv)" if len(failed) > 1 else ""
        first = f"{failed[0]['detector']} under {failed[0]['condition']}: {failed[0]['message']}"
        raise ConfigurationError(f"{first}{more}; {output} holds the other results")


def _print_shares(content: Content, protocol: LeakProtocol, display: ProgressDisplay) -> None:
    """Print the share of windows that each detector reports under the base condition, by size of the leak."""
    title = f"Windows reported as a leak, %: {content.label(protocol.base)}"
    levels = sorted(level for level in protocol.levels_in(protocol.base) if level != DRAWN)
    rows = [
        (name, *(number(content.share(name, protocol.base, level).value, 1) for level in levels))
        for name in content.detectors
    ]
    shown = Table(title, ("detector", *map(level_text, levels)), rows)
    display.console.lines(console_table(shown, whole=True))
