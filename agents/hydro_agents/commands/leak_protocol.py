"""``hydro evaluate --protocol leakage``: every leak detector under every condition of a protocol."""

from __future__ import annotations

from pathlib import Path

from hydro_agents.commands.robustness import Options, PageOf, run_protocol
from hydro_agents.detection.alarm import AlarmSettings
from hydro_agents.detection.detectors import make_detector
from hydro_agents.detection.head import LeakageHead
from hydro_agents.evaluation.leak_protocol import DRAWN, Detectors, LeakProtocol, Watch
from hydro_agents.evaluation.runner import Results
from hydro_agents.report.content import Content
from hydro_agents.report.leakage import LEAKAGE, PAGE_FILE, level_text
from hydro_agents.running.console import ProgressDisplay, console_table
from hydro_agents.running.text import Table, number


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
    protocol = options.moved(LeakProtocol.from_yaml(file))
    own = LeakageHead.load(head) if head is not None else None
    alarms, notes = {}, []
    for name, settings in protocol.alarms.items() if protocol.alarm_hours > 0.0 else ():
        if Path(settings).exists():
            watching = make_detector(protocol.detectors[name], own, following=True)
            alarms[name] = Watch(watching, AlarmSettings.load(settings))
        else:
            notes.append(f"{name}: no alarm: {settings} does not exist; hydro alarms writes it")
    detectors = {name: make_detector(choice, own) for name, choice in protocol.detectors.items()}

    page = PageOf(PAGE_FILE, LEAKAGE, _content)
    run_protocol(protocol, file, Detectors(detectors, alarms), options, page, _print_shares, notes)


def _content(results: Results) -> Content:
    return Content(results.tables(), results.protocol.task, {"base": results.protocol.base})


def _print_shares(results: Results, display: ProgressDisplay) -> None:
    """Print the share of windows that each detector reports under the base condition, by size of the leak."""
    protocol, content = results.protocol, _content(results)
    title = f"Windows reported as a leak, %: {content.label(protocol.base)}"
    levels = sorted(level for level in protocol.levels_in(protocol.base) if level != DRAWN)
    rows = [
        (name, *(number(content.share(name, protocol.base, level).value, 1) for level in levels))
        for name in content.detectors
    ]
    shown = Table(title, ("detector", *map(level_text, levels)), rows)
    display.console.lines(console_table(shown, whole=True))
