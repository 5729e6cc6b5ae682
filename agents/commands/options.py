"""Options that several commands share, and what Ctrl-C says."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
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
Config = Annotated[
    Path | None, typer.Option("--config", "-c", help="YAML file of a study; `configs/studies` holds some.")
]


def command_line() -> str:
    """The command as the user typed it."""
    return " ".join(["hydro", *sys.argv[1:]])


@contextmanager
def stoppable(resumable: bool) -> Iterator[None]:
    """Ctrl-C ends the command with one line that says what becomes of the work."""
    fate = "what is done so far was kept, --resume goes on with it" if resumable else "it begins anew when run again"
    try:
        yield
    except KeyboardInterrupt:
        print(f"\nhydro: stopped; {fate}", file=sys.stderr)
        raise typer.Exit(130) from None


def default_study(config: Path | None) -> Any:
    """The study of a file, or the default one."""
    from agents.running.folders import config_folder
    from agents.study.run import StudySettings

    return StudySettings.from_yaml(config if config is not None else config_folder() / "studies" / "default.yaml")
