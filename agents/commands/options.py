"""Options that several commands share."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from hydro_env import ConfigurationError

Output = Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")]
Seed = Annotated[
    int | None,
    typer.Option(
        "--seed", "-s", min=0, max=2**32 - 1, help="Seed of everything that is drawn, instead of the study's."
    ),
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with what is in the output folder.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Begin anew where the output folder holds results.")]
Agents = Annotated[
    list[str] | None,
    typer.Option(
        "--agent",
        metavar="NAME=WHAT",
        help="A controller: module:attribute (anything with predict, or what makes one from the task), or the path of "
        "weights. A name of the study replaces that controller. May be given more than once.",
    ),
]
Rig = Annotated[
    Path | None, typer.Option("--rig", help="YAML file of a rig; without it the paper's. `configs/rigs` holds some.")
]
Config = Annotated[
    Path | None, typer.Option("--config", "-c", help="YAML file of a study; `configs/studies` holds some.")
]


def command_line() -> str:
    """The command as the user typed it; a file name that is not UTF-8 is escaped."""
    return " ".join(["hydro", *sys.argv[1:]]).encode("utf-8", "backslashreplace").decode()


def say(*lines: object) -> None:
    """Print what a command leaves, as it is."""
    print(*lines, sep="\n", flush=True)


def named_agents(texts: Sequence[str] | None) -> dict[str, str]:
    """``--agent NAME=WHAT``, by name.

    Raises:
        ConfigurationError: not of this form, or a name is given twice.
    """
    agents: dict[str, str] = {}
    for text in texts or ():
        name, _, what = text.partition("=")
        if not name or not what:
            raise ConfigurationError(f"--agent {text}: must be NAME=module:attribute or NAME=PATH of weights")
        if name in agents:
            raise ConfigurationError(f"--agent {text}: the name '{name}' is given twice")
        agents[name] = what
    return agents
