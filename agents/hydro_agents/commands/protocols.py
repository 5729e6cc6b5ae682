"""Runs a protocol for a command: as its options say, in its folder, with the facts of the run."""

from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from hydro_agents.commands.options import command_line, working_in
from hydro_agents.commands.pages import PageOf
from hydro_agents.evaluation.conditions import Protocol
from hydro_agents.evaluation.runner import Facts, run
from hydro_agents.running.machine import date_now, machine_description, package_versions
from hydro_agents.running.tasks import timed_task
from hydro_env.files import Group, write_yaml

AnyProtocol = TypeVar("AnyProtocol", bound=Protocol[Any])


class Options(NamedTuple):
    """How a protocol runs; ``None`` means the protocol's own value."""

    task: str | None  # name or file
    rig: Path | None
    output: Path
    resume: bool  # use the finished jobs in the folder
    overwrite: bool  # replace the results in the folder
    file: Path | None = None  # of the protocol; none: it is the evaluation of a study
    period: str | None = None  # with its unit
    latency: str | None = None

    def read(self, kind: type[AnyProtocol]) -> AnyProtocol:
        """The protocol of the file, with another task or on another rig if one is given."""
        assert self.file
        protocol = kind.from_yaml(self.file)
        if (self.task, self.rig, self.period, self.latency) == (None,) * 4:
            return protocol
        task = protocol.task if self.task is None else self.task
        return protocol.moved(timed_task(task, self.rig, self.period, self.latency, "evaluate"))


def facts_of(**more: str) -> Facts:
    """Keys and values of a run: date, command, machine, versions, and more."""
    run_by = {"date": date_now(), "command": command_line(), "machine": machine_description()}
    return list((more | run_by | package_versions()).items())


def run_protocol(protocol: Protocol[Any], chosen: Any, options: Options, page: PageOf, settings: Group) -> None:
    """Run a protocol of any kind with the chosen participants; write tables, page and settings, and print the figures.

    Raises:
        ConfigurationError: the folder cannot be used, or a participant failed (the results of the others are written
            first).
    """
    output, file, facts = options.output, "evaluation.yaml", facts_of()
    if options.file:
        file, facts = "protocol.yaml", facts_of(file=str(options.file))
    with working_in(output, "evaluate", [file, *page.files], options.resume, options.overwrite) as display:
        write_yaml(output / file, settings.model_dump(mode="json"))
        results = run(protocol, chosen, output, display.update, facts)
        page.write(results, output, display)
    page.tell(results, output, display)
