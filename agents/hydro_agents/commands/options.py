"""Options that several commands share."""

import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_env import ConfigurationError
from hydro_env.folders import config_file

if TYPE_CHECKING:
    from hydro_agents.controllers.base import Controller
    from hydro_agents.evaluation.study import StudySettings
    from hydro_agents.running.console import ProgressDisplay

Output = Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")]
Seed = Annotated[
    int | None,
    typer.Option("--seed", "-s", min=0, max=2**32 - 1, help="Seed of all random numbers, instead of the study's."),
]
Resume = Annotated[bool, typer.Option("--resume", help="Continue from the results in the output folder.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace earlier results in the output folder.")]
OverwriteFile = Annotated[bool, typer.Option("--overwrite", help="Replace the file.")]
Period = Annotated[str | None, typer.Option(metavar="1ms", help="Control period; default: the task's.")]
Latency = Annotated[str | None, typer.Option(metavar="0.5ms", help="Of the command; default: the task's.")]
Agents = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=WHAT",
        help="A controller: module:attribute (an object with predict, or a function or class that makes one from the "
        "task), the path of weights, or a folder `controllers/NAME` of a study. If NAME is a controller of the study, "
        "it is replaced. Repeat the option for several.",
    ),
]

Jobs = Annotated[int | None, typer.Option("--jobs", "-j", min=1, max=1024, help="At a time; default: one per core.")]


def _rig_file(given: Path | None) -> Path | None:
    from hydro_env.task.rig import law_of

    if given is None:
        return None
    if law_of(given) is not None:
        raise ConfigurationError(f"--rig {given}: draws rigs, and a command needs one; gym.make takes it as rig")
    return config_file("rigs", given)


Rig = Annotated[
    Path | None,
    typer.Option(
        metavar="NAME|FILE",
        callback=_rig_file,
        help="A rig: a name in `configs/rigs` or a YAML file. Default: the study's, or else the paper's.",
    ),
]
Task = Annotated[
    str | None,
    typer.Option(metavar="NAME|FILE", help="A name in `configs/tasks` or a YAML file, instead of the study's task."),
]
Columns = Annotated[
    Path | None,
    typer.Option("--map", metavar="FILE", help="YAML: the signal of each column, with unit, gain and offset."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of lines.")]
Recording = Annotated[Path, typer.Argument(metavar="RECORDING", help="Measured signals: CSV, Parquet or MAT.")]
Faults = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=VALUE", help="A fault, such as valve_null_shift=0.01; repeat the option for several."),
]
PlantSeed = Annotated[int, typer.Option("--seed", "-s", min=0, max=2**32 - 1, help="Of plant, reference and noise.")]
OwnTask = Annotated[str | None, typer.Option(metavar="NAME|FILE", help="A name in `configs/tasks` or a YAML file.")]
Config = Annotated[
    Path | None,
    typer.Option("--config", "-c", metavar="NAME|FILE", help="A study: a name in `configs/studies` or a YAML file."),
]


def check_new_file(output: Path, overwrite: bool) -> None:
    """Check before the work that a file can be written.

    Raises:
        ConfigurationError: it exists already and may not be replaced, is a folder, or its folder cannot be written.
    """
    if output.is_dir():
        raise ConfigurationError(f"{output}: is a folder; --output needs a file")
    if output.exists() and not overwrite:
        raise ConfigurationError(f"{output}: exists; --overwrite replaces it, --output takes another file")
    folder = next(parent for parent in output.absolute().parents if parent.exists())
    if not (folder.is_dir() and os.access(folder, os.W_OK)):
        raise ConfigurationError(f"{output}: cannot be written: {folder} is no folder in which you may write")


def refuse_given(options: Mapping[str, object], why: str) -> None:
    """Refuse options that have no meaning here.

    Raises:
        ConfigurationError: one of them is given.
    """
    for option, value in options.items():
        if value is not None:
            raise ConfigurationError(f"{option}: {why}")


@contextmanager
def working_in(
    folder: Path, job: str, writes: Sequence[str], resume: bool, overwrite: bool
) -> "Iterator[ProgressDisplay]":
    """Claim a folder for the files and jobs of a command (:func:`~hydro_agents.running.folders.output_folder`).

    Raises:
        ConfigurationError: the folder cannot be used.
    """
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.running.jobs import RESULT_FILES

    files = [*writes, RESULT_FILES]
    with output_folder(folder, job, files, resume=resume, overwrite=overwrite), ProgressDisplay() as display:
        yield display


def command_line() -> str:
    """The command as the user typed it; characters that UTF-8 cannot hold are escaped."""
    return " ".join(["hydro", *sys.argv[1:]]).encode("utf-8", "backslashreplace").decode()


def say(*lines: object) -> None:
    """Print the results of a command without formatting."""
    print(*lines, sep="\n", flush=True)


def named_agents(texts: Sequence[str] | None) -> dict[str, str]:
    """The values of ``--agent NAME=WHAT``, by name.

    Raises:
        ConfigurationError: a value has another form, or a name is impossible or given twice.
    """
    from hydro_agents.running.text import NAME_RULE

    agents = {}
    for text in texts or ():
        name, _, what = text.partition("=")
        if not name or not what:
            raise ConfigurationError(f"--agent {text}: must be NAME=module:attribute or NAME=PATH of weights")
        if not re.fullmatch(NAME_RULE, re.split("[#@]", name)[0]):
            must = "must be a name of at most 40 letters, digits, spaces and _ . + -, beginning with a letter or digit"
            raise ConfigurationError(f"--agent '{name[:60]}': {must}")
        if name in agents:
            raise ConfigurationError(f"--agent {text}: the name '{name}' is given twice")
        agents[name] = what
    return agents


def tell_rigs(study: "StudySettings", controllers: "Mapping[str, Controller]") -> None:
    """Name on standard error, in one line, the controllers that were made for another rig than the study's."""
    from hydro_agents.learning.loading import outside_training, trained_elsewhere

    notes = []
    foreign = [name for name, controller in controllers.items() if trained_elsewhere(controller, study.task)]
    if untuned := [name for name in study.tuned if name in controllers]:
        notes.append(f"{', '.join(untuned)}: gains as given, not tuned for this rig")
    if foreign:
        notes.append(f"{', '.join(foreign)}: trained for another rig")
    if notes:
        print(f"hydro: {'; '.join(notes)}; hydro study --rig tunes and trains them", file=sys.stderr)
    for name, controller in controllers.items():
        if far := outside_training(controller, study.task):
            print(f"hydro: {name}: outside the rigs of the training: {far}", file=sys.stderr)
