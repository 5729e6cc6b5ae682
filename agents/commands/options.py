"""Options that several commands share."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

Output = Annotated[Path, typer.Option("--output", "-o", help="Folder for the results.")]
Seed = Annotated[
    int | None,
    typer.Option(
        "--seed", "-s", min=0, max=2**32 - 1, help="Seed of everything that is drawn, instead of the study's."
    ),
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with what is in the output folder.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Begin anew where the output folder holds results.")]
Rig = Annotated[
    Path | None,
    typer.Option("--rig", help="YAML file of a rig; without it the paper's. `configs/rigs` holds some."),
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


def default_study(config: Path | None) -> Any:
    """The study of a file, or the default one."""
    from agents.running.folders import config_folder
    from agents.study.run import StudySettings

    return StudySettings.from_yaml(config if config is not None else config_folder() / "studies" / "default.yaml")
