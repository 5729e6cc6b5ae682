"""``hydro evaluate``: compare controllers on test plants."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydro_agents.commands.options import (
    Agents,
    Config,
    Jobs,
    Latency,
    Overwrite,
    Period,
    Resume,
    Task,
    named_agents,
    refuse_given,
    tell_rigs,
    working_in,
)
from hydro_env.files import Group, read_yaml, validate, write_whole
from hydro_env.folders import config_file

if TYPE_CHECKING:
    from hydro_agents.commands.protocols import Options

OPPONENTS = "opponents"  # the study whose controllers run a protocol by default
DRAWN, TEST_RIGS = Path("results/drawn"), 100


def evaluate(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for the results; default: results/evaluate, or results/PROTOCOL."),
    ] = None,
    config: Config = None,
    agent: Agents = None,
    task: Task = None,
    rig: Annotated[
        Path | None,
        typer.Option(metavar="NAME|FILE", help="A rig: a name in `configs/rigs` or a YAML file; or drawn, or a law."),
    ] = None,
    period: Period = None,
    latency: Latency = None,
    head: Annotated[
        Path | None, typer.Option(help="For --protocol leakage: weights of a leakage head, instead of the shipped one.")
    ] = None,
    plants: Annotated[
        int | None, typer.Option(min=3, max=10_000, help="Plants per leak level and reference family.")
    ] = None,
    protocol: Annotated[
        str | None,
        typer.Option(help="Run a protocol instead: robustness, pauses, quick, leakage, leakage_quick, or a YAML file."),
    ] = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    jobs: Jobs = None,
) -> None:
    """Compare the controllers of a study and your own on test plants, or under the conditions of a protocol.

    All controllers get the same plants, references and noise. Trained controllers take the shipped weights unless
    `--agent` gives others. The command writes CSV tables with all numbers and a report, and prints the main figures. If
    a controller fails, the results of the others are kept. `--agent NAME#0=…` and `NAME#1=…` give training seeds of one
    controller, which share its row. One line names each controller that oscillates at rest.

    With `--rig` the task is moved to another rig. There flow linearisation has its gains for any rig, a simulation of
    the rig searches those of the PID, a minute or two, the policy is that for any axis, and other controllers are left
    out, with one line each.

    With `--rig drawn` agents on the observation of `rig="drawn"` run on 100 rigs of the test split, beside untuned flow
    linearisation on each; a law in a file of its own chooses others (`law: {split: validation, count: 20}`). Weights of
    a policy for any axis run there as well. The command prints ratios of errors and returns.

    With `--protocol` the controllers of the study `opponents` (or of `--config`) and your own run under every condition
    of a protocol: leaks, parameters beyond their bounds, latency, forces, other rigs. `--task` and `--rig` replace
    those of the protocol. Ctrl-C keeps the finished jobs, and `--resume` goes on.

    With `--protocol leakage` the leakage head (that of `--head`, or the shipped one) and the estimator read windows of
    healthy, leaking and otherwise faulty axes under many motions and controllers. The command writes tables and a page
    for maintenance: how small a leak is found, how early, how surely, and what is taken for one.
    """
    from hydro_agents.commands.protocols import Options
    from hydro_agents.running.jobs import workers
    from hydro_env.task.rig import law_of

    if rig:
        law = law_of(rig)
        if law is not None:
            without = {"--config": config, "--protocol": protocol, "--head": head}
            refuse_given(without | {"--period": period, "--latency": latency}, "has no meaning on drawn rigs")
            test = {"split": "test", "count": TEST_RIGS}
            law = law | test if str(rig) == "drawn" else test | law
            options = Options(task, None, output or DRAWN, resume, overwrite)
            with workers(jobs):
                _evaluate_on_drawn_rigs(law, named_agents(agent), plants, options)
            return
        rig = config_file("rigs", rig)
    file = None if protocol is None else config_file("protocols", protocol)
    folder = output or Path("results") / (file.stem if file else "evaluate")
    options = Options(task, rig, folder, resume, overwrite, file, period, latency)
    leaks = file and read_yaml(file).get("kind") == "leakage"
    if not leaks:
        refuse_given({"--head": head}, "belongs to --protocol leakage")
    if file:
        of_the_file = {"--plants": plants} | ({"--agent": agent, "--config": config} if leaks else {})
        refuse_given(of_the_file, "a protocol takes it from its file")
    with workers(jobs):
        if leaks:
            _evaluate_detectors(head, options)
        else:
            _evaluate_controllers(named_agents(agent), config, plants, options)


def _evaluate_detectors(head: Path | None, options: "Options") -> None:
    """Run a leakage protocol; the head of ``--head`` replaces that of the protocol."""
    from hydro_agents.commands.pages import LEAKAGE_PAGE
    from hydro_agents.commands.protocols import run_protocol
    from hydro_agents.evaluation.leak_protocol import LeakProtocol, make_detector

    protocol, own = options.read(LeakProtocol), {"weights": str(head)} if head else {}
    detectors = {name: make_detector(choice.changed(**own)) for name, choice in protocol.detectors.items()}
    run_protocol(protocol, detectors, options, LEAKAGE_PAGE, protocol)


def _evaluate_on_drawn_rigs(
    law: dict[str, Any], agents: dict[str, str], plants: int | None, options: "Options"
) -> None:
    """Run agents and untuned flow linearisation on the rigs of a law, by default those of the test split."""
    from hydro_agents.evaluation.drawn_rigs import PLANTS, on_drawn_rigs, summary
    from hydro_agents.running.console import console_table
    from hydro_agents.running.text import Table
    from hydro_env import task_config

    drawn = task_config(options.task, law=law)
    with working_in(options.output, "evaluate", ["rigs.csv"], options.resume, options.overwrite) as display:
        rows = on_drawn_rigs(drawn, agents, plants or PLANTS, options.output, display.update)
        write_whole(options.output / "rigs.csv", rows.to_csv(index=False).encode())
    header = ("agent", "rigs", "error ÷ untuned, median (95 %)", "geometric mean", "better on", "range", "failures")
    table = Table("", (*header, "return ± sd"), [tuple(row) for row in summary(rows)])
    display.console.table(console_table(table, whole=True))
    display.say(f"rigs, {law['split']} split: {(options.output / 'rigs.csv').resolve()}")


def _evaluate_controllers(agents: dict[str, str], config: Path | None, plants: int | None, options: "Options") -> None:
    """Run a protocol, or the evaluation of a study; agents replace controllers of the study by their names."""
    import yaml

    from hydro_agents.commands.pages import ROBUSTNESS_PAGE, study_page
    from hydro_agents.commands.protocols import run_protocol
    from hydro_agents.evaluation.evaluate import ProtocolSettings
    from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol, participants
    from hydro_agents.evaluation.study import StudySettings, default_study

    if options.file:
        protocol, page = options.read(RobustnessProtocol), ROBUSTNESS_PAGE
        study = StudySettings.from_yaml(config_file("studies", config or OPPONENTS))
        study = study.changed(task=protocol.task).with_gains_of_rig()
        settings: Group = protocol
    else:
        study = default_study(config, options.task, options.rig, options.period, options.latency)
        if plants:
            changed = validate(ProtocolSettings, {**study.evaluation.model_dump(), "plants": plants}, "--plants")
            study = study.changed(evaluation=changed)
        if options.rig:
            study = study.with_gains_of_rig()
        protocol, settings = study.evaluation.protocol(study.task, study.title), study
        page = study_page(yaml.safe_dump(study.model_dump(mode="json"), sort_keys=False, allow_unicode=True))
    controllers = study.with_weights(agents, leave_out=not options.file)
    tell_rigs(study, controllers)
    run_protocol(protocol, participants(controllers, protocol, study.corrects), options, page, settings)
