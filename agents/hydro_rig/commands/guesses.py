"""What commands that read recordings show while they read."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from hydro_agents.commands.options import say
from hydro_env import ConfigurationError


@contextlib.contextmanager
def reading(quiet: bool = False) -> Iterator[None]:
    """Show what the block tells of its progress, unless ``quiet``.

    For a recording with unknown headings it prints the map that is guessed; the error goes on.
    """
    from hydro_agents.running.console import ProgressDisplay
    from hydro_rig.estimation.progress import told_to
    from hydro_rig.recordings.guessed_map import UnknownHeadingsError

    try:
        with (
            contextlib.nullcontext() if quiet else ProgressDisplay() as display,
            told_to(None if display is None else display.update),
        ):
            yield
    except UnknownHeadingsError as error:
        say(error.guess)
        advice = "a map guessed from the headings stands above: save it as FILE, check it, add --map FILE"
        raise ConfigurationError(f"{error}; {advice}") from None
