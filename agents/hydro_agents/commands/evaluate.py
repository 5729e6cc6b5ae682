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

if TYPE_CHECKING:
    from hydro_agents.detection.head import LeakageHead
    from hydro_agents.study.settings import StudySettings
    from hydro_env import TaskConfig


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
    head: Annotated[Path | None, typer.Option(help="Weights of a leakage head; default: the shipped one.")] = None,
    no_detection: Annotated[bool, typer.Option("--no-detection", help="Leave the leakage head out.")] = False,
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

    With `--rig` the task is moved to another rig. The command tunes nothing. It takes the gains and weights that ship
    for this rig; without them it keeps the gains of the study and leaves out shipped weights that do not fit. One line
    names what was made for another rig, and what is left out.

    With `--protocol` the shipped controllers (or those of `--config`) and your own run under every condition of a
    protocol: leaks, parameters beyond their bounds, latency, forces, other rigs. `--agent NAME@CONDITION=…` gives a
    controller that was made for this condition. `--task` and `--rig` replace those of the protocol. Ctrl-C keeps the
    finished jobs, and `--resume` goes on.

    With `--protocol leakage` the leakage head (that of `--head`, or the shipped one) and the estimator read windows of
    healthy, leaking and otherwise faulty axes under many motions and controllers. The command writes tables and a page
    for maintenance: how small a leak is found, how early, how surely, and what is taken for one.
    """
    from hydro_env import ConfigurationError

    if protocol is not None:
        from hydro_agents.commands.protocols import Options, evaluate_leak_protocol, evaluate_protocol
        from hydro_env.files import read_yaml
        from hydro_env.folders import config_file

        file = config_file("protocols", protocol)
        options = Options(task, rig, output, resume, overwrite, command_line())
        about_leaks = read_yaml(file).get("kind") == "leakage"
        # Controllers of a leakage protocol stand in its file; a robustness protocol has no detector.
        foreign = {"--agent": agent, "--config": config} if about_leaks else {"--head": head}
        for option, value in {**foreign, "--plants": plants, "--no-detection": no_detection or None}.items():
            if value is not None:
                raise ConfigurationError(f"{option}: a protocol takes it from its file")
        if about_leaks:
            evaluate_leak_protocol(file, head, options)
        else:
            evaluate_protocol(file, named_agents(agent), config, options)
        return
    if resume:
        raise ConfigurationError("--resume: needs --protocol")
    if no_detection and head is not None:
        raise ConfigurationError("--no-detection: leaves the leakage head out; give it without --head")
    from hydro_agents.evaluation.evaluate import ProtocolSettings
    from hydro_agents.evaluation.participants import split_name
    from hydro_agents.learning.opponents import SHIPPED_WEIGHTS
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.study.results import REPORT_FILE, REPORT_FILES, evaluate_study, print_summary
    from hydro_agents.study.settings import default_study
    from hydro_env.files import validate, write_yaml

    output = output if output is not None else Path("results/evaluate")
    study = default_study(config, task, rig)
    if plants is not None:
        changed = validate(ProtocolSettings, {**study.evaluation.model_dump(), "plants": plants}, "--plants")
        study = study.model_copy(update={"evaluation": changed})
    if rig is not None:
        study = study.with_shipped_gains()
    own = named_agents(agent)
    given = {split_name(name)[0] for name in own}
    agents = {name: what for name, what in _trained_beside(config, study).items() if name not in given} | own
    controllers, unfit = study.fitting(agents)
    for reason in unfit:
        print(f"hydro: left out: {reason}", file=sys.stderr)
    tell_rigs(study, controllers)
    watching = None if no_detection else _watching(head, study.task)
    weights = {name: what for name, what in agents.items() if what not in SHIPPED_WEIGHTS}
    weights |= {"leakage_head": str(head)} if head is not None else {}
    settings_file = "evaluation.yaml"
    with output_folder(output, "evaluate", [settings_file, *REPORT_FILES], overwrite=overwrite):
        write_yaml(output / settings_file, study.model_dump(mode="json"))
        text = (output / settings_file).read_text(encoding="utf-8")
        with ProgressDisplay() as display:
            evaluation = evaluate_study(
                study,
                controllers,
                watching,
                output,
                display,
                configuration=text,
                command=command_line(),
                weights=weights,
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
    from hydro_env import ConfigurationError

    try:
        return load_head(head, task)
    except ConfigurationError as error:
        if head is not None:
            raise
        print(f"hydro: no leak detection: {error}; hydro train head makes one for this task", file=sys.stderr)
        return None
