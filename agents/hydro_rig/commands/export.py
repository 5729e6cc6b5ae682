"""``hydro export`` and ``rehearse``: the plant, a controller or the leak detector for other tools, and its trial."""

import sys
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from hydro_agents.commands.options import Latency, Output, Overwrite, Period, Rig, Task, command_line, say
from hydro_env import ConfigurationError
from hydro_env.folders import page

if TYPE_CHECKING:
    from hydro_agents.controllers.base import Controller
    from hydro_env import TaskConfig
PLANT_FILES = "hydro_axis.fmu", "hydro_axis_fmi3.fmu", "hydro_axis.mo", "plant.h", "plant.c"
JOB = "export"
HEAD = "leakage_head"
TRAINED_FOR = ("plant", "control_period", "command_latency")  # of the task, what a head for one rig cannot change
Exported = tuple[Mapping[str, bytes], Sequence[str]]  # contents of files by name, and lines about them
Job = tuple[Sequence[str], Callable[[], Exported]]  # names of the files, and what makes them


class Gains(StrEnum):
    """Where the gains of an exported controller come from."""

    SEARCHED = "searched"
    FIGURES = "figures"


def export(
    what: Annotated[
        str,
        typer.Argument(
            help="plant: the axis as an FMU, in Modelica and in C. leakage_head: the leak detector, or the path of "
            "your own. Or a controller: results/study/controllers/NAME of a study on your rig; as shipped: "
            "flow_linearising, ppo or pid, for any rig; a file of gains, weights, or module:attribute.",
            show_default=False,
        ),
    ],
    output: Output = Path("results/export"),
    task: Task = None,
    rig: Rig = None,
    period: Period = None,
    latency: Latency = None,
    name: Annotated[
        str | None, typer.Option(metavar="Lift", help="Name of a controller's block, its types, functions and files.")
    ] = None,
    gains: Annotated[
        Gains | None,
        typer.Option(
            help="Gains of a controller without weights. searched: a simulation of the rig searches them, a minute; "
            "the next command finds them again. figures: they follow from the figures of the rig, in seconds."
        ),
    ] = None,
    single: Annotated[
        bool,
        typer.Option(
            "--single",
            help="A controller in single precision: REAL in Structured Text and float in C.",
            show_default=False,
        ),
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Write the plant, a controller or the leakage head for other tools, or for your own C program.

    `hydro export plant` writes `hydro_axis.fmu` and `hydro_axis_fmi3.fmu` (co-simulation, FMI 2.0 and 3.0, for
    Simulink, Amesim, OpenModelica and others, with the binary of this platform and its sources; it needs a C compiler),
    `hydro_axis.mo` (the equations in Modelica) and `plant.c`, `plant.h` (C99, no library but the mathematical one). Its
    inputs are the voltage of the valve, an external force, the leak and, but in Modelica, the faults. With `--rig` the
    parameters are those of your rig.

    `hydro export CONTROLLER` writes a folder that needs nothing of this project to run: the controller from measured
    signals in SI units to the voltage of the valve as `controller.onnx`, as C99 and as Structured Text (IEC 61131-3),
    a test program with test vectors, and a README with signals, limits and rules. Before the folder is written, ONNX
    and C are compared with the controller in Python. It needs `pip install 'hydro_env[export]'`. A rig that nobody
    tuned: `hydro export flow_linearising --rig my.yaml --period 2ms`.

    `hydro export leakage_head` writes such a folder for the shipped leakage head, C99 and Structured Text from measured
    signals to the probability and size of a leak, with the alarm; with `--rig` and `--period` on your rig, without
    training. `hydro export study/leakage_head` does so for your own.
    """
    from hydro_agents.detection.head import KIND
    from hydro_agents.running.folders import output_folder, refuse_taken
    from hydro_agents.running.weights import kind_of_weights
    from hydro_env.files import write_whole
    from hydro_rig.export.controller_folder import NAME, check_block_name, files_of

    request = _Request(task, rig, period, latency)
    is_controller = what != "plant" and what != HEAD and (":" in what or kind_of_weights(what) != KIND)
    if not is_controller and (name, gains, single) != (None, None, False):
        raise ConfigurationError(f"export {what}: takes no --name, no --gains and no --single; a controller does")
    if what == "plant":
        if period is not None or latency is not None:
            raise ConfigurationError("export plant: takes no --period and no --latency; a controller does")
        names, make = _plant(task, rig)
    elif not is_controller:
        names, make = _head(what, request)
    else:
        check_block_name(name or NAME)
        refuse_taken(output, JOB, files_of(name or NAME), overwrite)  # before a simulation of the rig searches gains
        names, make = _controller(what, request, name or NAME, gains, single)
    with output_folder(output, JOB, names, overwrite=overwrite):
        files, report = make()
        for name, content in files.items():
            write_whole(output / name, content)
    say(*report, *(f"written: {output / name}" for name in names))


class _Request(NamedTuple):
    """The task that the user gives for a controller; ``None``: its own."""

    task: str | None
    rig: Path | None
    period: str | None
    latency: str | None


def _plant(task: str | None, rig: Path | None) -> Job:
    from hydro_env import task_config
    from hydro_rig.export.plant import make_fmus, modelica_text, plant_code

    config = task_config(task, rig=rig)

    def make() -> Exported:
        code = plant_code(config.plant)
        texts = modelica_text(config), code["plant.h"], code["plant.c"]
        contents = *make_fmus(config), *(text.encode() for text in texts)
        return dict(zip(PLANT_FILES, contents, strict=True)), ()

    return PLANT_FILES, make


def _head(what: str, request: _Request) -> Job:
    from hydro_agents.detection.head import LeakageHead
    from hydro_agents.running.folders import shipped_weights
    from hydro_agents.running.tasks import timed_task
    from hydro_rig.export.onnx_writer import package

    package("pycparser")
    from hydro_rig.export.leakage_head import FILES, exported_head

    config = timed_task(*request, f"export {what}")
    head = LeakageHead.load(shipped_weights(what, config) if what == HEAD else what)
    if head.for_any_axis:
        head = head.moved_to(config)
        _tell_distance(what, head, config)
    elif any(request) and any(getattr(head.settings.task, name) != getattr(config, name) for name in TRAINED_FOR):
        raise ConfigurationError(
            f"export {what}: was trained for another rig or period; the shipped leakage_head serves any"
        )
    return FILES, partial(exported_head, head, command_line())


def _tell_distance(what: str, trained: object, config: "TaskConfig") -> None:
    from hydro_agents.learning.loading import outside_training

    if far := outside_training(trained, config):
        print(f"hydro: {what}: outside the rigs of the training: {far}", file=sys.stderr)


def _controller(what: str, request: _Request, name: str, gains: Gains | None, single: bool) -> Job:
    from hydro_agents.controllers.registry import CONTROLLERS
    from hydro_agents.learning.loading import GainsOrigin, origin_of_gains, trained_elsewhere
    from hydro_rig.export.controller_folder import exported_files, files_of
    from hydro_rig.export.onnx_writer import package

    package("onnx")  # report a missing package at the start
    controller, config = _controller_and_task(what, request, gains)
    if trained_elsewhere(controller, config):
        print(f"hydro: {what}: trained for another rig", file=sys.stderr)
    _tell_distance(what, controller, config)
    origin = origin_of_gains(what, config) if what in CONTROLLERS else ""
    if gains is not None:
        origin = GainsOrigin.SEARCHED if gains is Gains.SEARCHED else GainsOrigin.FIGURES
    if origin in (GainsOrigin.ANY_RIG, GainsOrigin.RIG):
        say(f"{what}: {origin}: {page('drawn_rigs.md')} says what they cost")
    return files_of(name), partial(exported_files, controller, config, command_line(), origin, name, single)


def _with_gains(what: str, gains: Gains, config: "TaskConfig") -> "Controller":
    """A controller whose gains are searched for a rig, or follow from its figures."""
    from hydro_agents.controllers.registry import make_controller
    from hydro_agents.learning.rig_gains import NEAR, gain_sets, searched_gains

    if what not in NEAR:
        raise ConfigurationError(f"export {what}: --gains {gains}: must be the gains of {' or '.join(NEAR)}")
    found = searched_gains(what, config) if gains is Gains.SEARCHED else gain_sets(what, config)[0]
    return make_controller(what, config, found.model_dump())


def _controller_and_task(what: str, request: _Request, gains: Gains | None) -> "tuple[Controller, TaskConfig]":
    """The controller and the task for which it is exported: that of its training, unless the user gives one."""
    from hydro_agents.controllers.registry import CONTROLLERS
    from hydro_agents.learning.loading import SHIPPED_WEIGHTS, found_in, load_controller
    from hydro_agents.learning.policy import PolicyController
    from hydro_agents.running.folders import shipped_weights
    from hydro_agents.running.tasks import timed_task
    from hydro_agents.running.weights import weight_files
    from hydro_env.mistakes import unknown

    names = (*CONTROLLERS, *SHIPPED_WEIGHTS)
    path = Path(found_in(what))
    if what not in names and ":" not in what and not (path.exists() or weight_files(path)[1].is_file()):
        known = unknown(what, ("plant", HEAD, *names))
        raise ConfigurationError(f"export '{what}': {known}, the path of weights or gains, or module:attribute")
    config = timed_task(*request, f"export {what}")
    if gains is not None:
        return _with_gains(what, gains, config), config
    if request.task is None and request.rig is None:
        if (request.period, request.latency) != (None, None) and what not in CONTROLLERS and ":" not in what:
            raise ConfigurationError(
                f"export {what}: --period and --latency need --rig or --task; gains and weights have those for which "
                "they were made"
            )
        weights = shipped_weights(SHIPPED_WEIGHTS[what], config) if what in SHIPPED_WEIGHTS else path
        if ":" not in what and weight_files(weights)[0].is_file():
            config = PolicyController.load(weights).features.config
        if path.suffix == ".yaml":
            config = _task_of_gains(path)
    return load_controller(what, config, what), config


def _task_of_gains(gains: Path) -> "TaskConfig":
    """The task of the study in whose folder a file of gains lies.

    Raises:
        ConfigurationError: it lies in no folder of a study.
    """
    from hydro_agents.evaluation.study import StudySettings
    from hydro_agents.evaluation.study_run import TUNED_FILE

    study = gains.absolute().parent.parent.parent / TUNED_FILE  # controllers/NAME/gains.yaml
    if not study.is_file():
        raise ConfigurationError(f"{gains}: gains belong to a rig, and the file does not tell which; give --rig FILE")
    return StudySettings.from_yaml(study).task


def rehearse(
    folder: Annotated[Path, typer.Argument(help="Folder that `hydro export CONTROLLER` wrote.")],
    rig: Rig = None,
    output: Output = Path("results/rehearse"),
    overwrite: Overwrite = False,
) -> None:
    """Let the exported C code move the simulated axis: healthy, worn, wrong, with broken cables and an emergency stop.

    Without --rig the axis is that for which the folder was exported. Written are a page with curves and a table of what
    an engineer signs: peak error, overshoot, swing at rest, time to hold, travel after a fault. It needs a C compiler.
    Exit codes: 0 all scenes passed, 1 one of them did not.
    """
    from hydro_agents.report.kit import shown
    from hydro_agents.running.folders import output_folder
    from hydro_rig.export.rehearsal import FILES, JOB, write_rehearsal

    with output_folder(output, JOB, FILES, overwrite=overwrite):
        table = write_rehearsal(output, folder, rig, command_line())
    for scene, row in table.iterrows():
        figures = [f"{name.replace(', ', ' ')} {shown(value)}" for name, value in row.iloc[:5].dropna().items()]
        say(f"{scene}: {row['end']}; {', '.join(figures)}")
    say(*(output / name for name in FILES))
    raise typer.Exit(int((table["end"] != "passed").any()))
