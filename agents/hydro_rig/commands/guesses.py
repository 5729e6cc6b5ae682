"""What commands that read recordings show while they read."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from hydro_agents.commands.options import say
from hydro_env import ConfigurationError

if TYPE_CHECKING:
    from hydro_agents.running.jobs import Report


@contextlib.contextmanager
def reading(quiet: bool = False) -> Iterator[Report | None]:
    """Show the progress, which the block reports through what it gets, or nothing; ``None``: ``quiet``.

    For a recording with unknown headings it prints the map that is guessed; the error goes on.
    """
    from hydro_agents.running.console import ProgressDisplay
    from hydro_rig.recordings.guessed_map import UnknownHeadingsError

    try:
        with contextlib.nullcontext() if quiet else ProgressDisplay() as display:
            yield None if display is None else display.update
    except UnknownHeadingsError as error:
        say(error.guess)
        advice = "a map guessed from the headings stands above: save it as FILE, check it, add --map FILE"
        raise ConfigurationError(f"{error}; {advice}") from None
