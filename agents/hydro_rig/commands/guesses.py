"""What commands that read recordings print when headings are unknown."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from hydro_agents.commands.options import say


@contextlib.contextmanager
def guesses_shown() -> Iterator[None]:
    """Print the map that is guessed for a recording with unknown headings; the error goes on."""
    from hydro_rig.recordings.guessed_map import UnknownHeadingsError

    try:
        yield
    except UnknownHeadingsError as error:
        say(error.guess)
        raise
