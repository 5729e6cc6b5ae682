"""``hydro evaluate``: compare controllers on test plants."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_agents.commands.options import (
    Agents,
    Config,
    Overwrite,
    Resume,
    Rig,
    Task,
    command_line,
    named_agents,
    side_by_side,
    tell_rigs,
)
from hydro_env import ConfigurationError

if TYPE_CHECKING:
    from hydro_agents.commands.protocols import Options
    from hydro_agents.detection.head import LeakageHead
    from hydro_agents.study.settings import StudySettings
    from hydro_env import TaskConfig

SETTINGS_FILE = "evaluation.yaml"
NO_HEAD = Path("none")


@side_by_side
def evaluate(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for the results; default: results/evaluate, or results/PROTOCOL."),
    ] = None,
    config: Config = None,
    agent: Agents = None,
    task: Task = None,
    rig: Rig = None,
    head: Annotated[
        Path | None, typer.Option(help="Weights of a leakage head, or none; default: the shipped one.")
    ] = None,
    plants: Annotated[
        int | None, typer.Option(min=3, max=10_000, help="Plants per leak level and reference family.")
    ] = None,
    protocol: Annotated[
        str | None,
        typer.Option(
            "--protocol",
            help="Run a protocol instead: robustness, pauses, quick, leakage, leakage_quick, or a YAML file.",
        ),
    ] = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Compare the controllers of a study and your own on test plants, and evaluate the leakage head.

    All controllers get the same plants, references and noise. Trained controllers take the shipped weights unless
    `--agent` gives others. The command writes CSV tables with all numbers and a report, and prints the main figures. If
    a controller fails, the results of the others are kept. `--agent NAME#0=…` and `NAME#1=…` give training seeds of one
    controller, which share its row. One line names each controller that oscillates at rest.

    With `--rig` the task is moved to another rig. The command takes the gains and weights that ship for this rig.
    Without them flow linearisation has its gains for any rig, a simulation of the rig searches those of the PID, a
    minute or two, the policy is that for any axis, and other controllers are left out, with one line each.

    With `--protocol` the shipped controllers (or those of `--config`) and your own run under every condition of a
    protocol: leaks, parameters beyond their bounds, latency, forces, other rigs. `--task` and `--rig`
    replace those of the protocol. Ctrl-C keeps the finished jobs, and `--resume` goes on.

    With `--protocol leakage` the leakage head (that of `--head`, or the shipped one) and the estimator read windows of
    healthy, leaking and otherwise faulty axes under many motions and controllers. The command writes tables and a page
    for maintenance: how small a leak is found, how early, how surely, and what is taken for one.
    """
    from hydro_agents.commands.protocols import Options
    from hydro_agents.evaluation.evaluate import ProtocolSettings
    from hydro_agents.evaluation.participants import split_name
    from hydro_agents.study.settings import default_study
    from hydro_env.files import validate
    from hydro_env.folders import config_file

    if protocol is not None:
        file = config_file("protocols", protocol)
        _run_protocol(file, Options(task, rig, output, resume, overwrite, command_line()), config, agent, head, plants)
        return
    if resume:
        raise ConfigurationError("--resume: needs --protocol")
    study = default_study(config, task, rig)
    if plants is not None:
        changed = validate(ProtocolSettings, {**study.evaluation.model_dump(), "plants": plants}, "--plants")
        study = study.model_copy(update={"evaluation": changed})
    if rig is not None:
        study = study.with_gains_of_rig()
    own = named_agents(agent)
    replaced = {split_name(name)[0] for name in own}
    beside = _trained_beside(config, study)
    agents = {name: what for name, what in beside.items() if name not in replaced} | own
    _compare(study, agents, head, output or Path("results/evaluate"), overwrite)


def _run_protocol(
    file: Path, options: Options, config: Path | None, agent: list[str] | None, head: Path | None, plants: int | None
) -> None:
    """Run a protocol; controllers of a leakage protocol stand in its file, a robustness protocol has no detector."""
    from hydro_agents.commands.protocols import evaluate_leak_protocol, evaluate_protocol
    from hydro_env.files import read_yaml

    about_leaks = read_yaml(file).get("kind") == "leakage"
    foreign = {"--agent": agent, "--config": config} if about_leaks else {"--head": head}
    for option, value in {**foreign, "--plants": plants}.items():
        if value is not None:
            raise ConfigurationError(f"{option}: a protocol takes it from its file")
    if about_leaks:
        evaluate_leak_protocol(file, head, options)
    else:
        evaluate_protocol(file, named_agents(agent), config, options)


def _compare(study: StudySettings, agents: dict[str, str], head: Path | None, output: Path, overwrite: bool) -> None:
    """Evaluate the controllers of a study and ``agents``, by name, and write the report."""
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.study.results import REPORT_FILE, REPORT_FILES, evaluate_study, print_summary
    from hydro_env.files import read_text, write_yaml

    controllers, unfit = study.fitting(agents)
    for reason in unfit:
        print(f"hydro: left out: {reason}", file=sys.stderr)
    tell_rigs(study, controllers)
    watching = None if head == NO_HEAD else _watching(head, study.task)
    with output_folder(output, "evaluate", [SETTINGS_FILE, *REPORT_FILES], overwrite=overwrite):
        write_yaml(output / SETTINGS_FILE, study.model_dump(mode="json"))
        with ProgressDisplay() as display:
            evaluation = evaluate_study(
                study,
                controllers,
                watching,
                output,
                display,
                configuration=read_text(output / SETTINGS_FILE),
                command=command_line(),
            )
        print_summary(evaluation, display)
        display.say(f"report: {(output / REPORT_FILE).resolve()}")
    if evaluation.errors:
        raise ConfigurationError(f"{', '.join(evaluation.errors)} failed; {output} holds the results of the others")


def _trained_beside(config: Path | None, study: StudySettings) -> dict[str, str]:
    """By controller, the weights that a study has trained, if the settings are the file in the folder of this study."""
    from hydro_agents.running.weights import weight_files

    if config is None or not config.is_file():  # none, or a name in configs/studies
        return {}
    weights = {name: config.parent / "controllers" / name / "policy" for name in study.trained}
    return {name: str(path) for name, path in weights.items() if weight_files(path)[1].is_file()}


def _watching(head: Path | None, task: TaskConfig) -> LeakageHead | None:
    """The leakage head; none, with one line on standard error, if the shipped one cannot watch this task."""
    from hydro_agents.detection.monitor import load_head

    try:
        return load_head(head, task)
    except ConfigurationError as error:
        if head is not None:
            raise
        print(f"hydro: no leak detection: {error}; hydro train head makes one for this task", file=sys.stderr)
        return None
