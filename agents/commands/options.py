"""Options that several commands share, and what Ctrl-C says."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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
Config = Annotated[
    Path | None, typer.Option("--config", "-c", help="YAML file of a study; `configs/studies` holds some.")
]


def command_line() -> str:
    """The command as the user typed it."""
    return " ".join(["hydro", *sys.argv[1:]])


@contextmanager
def stoppable(kept: bool | Callable[[], bool]) -> Iterator[None]:
    """Ctrl-C ends the command with one line that says what becomes of the work.

    Args:
        kept: whether ``--resume`` can go on with what was done; asked when Ctrl-C is pressed.
    """
    try:
        yield
    except KeyboardInterrupt:
        resumable = kept if isinstance(kept, bool) else kept()
        fate = (
            "what is done so far was kept, --resume goes on with it" if resumable else "it begins anew when run again"
        )
        print(f"\nhydro: stopped; {fate}", file=sys.stderr)
        raise typer.Exit(130) from None


def checkpoints_in(folder: Path) -> Callable[[], bool]:
    """Whether a folder, or one below it, holds weights or a checkpoint."""
    return lambda: any(folder.rglob("*.safetensors"))


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
