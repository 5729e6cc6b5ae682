"""Entry point of the command ``hydro``: says what to install where the learning libraries are missing."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line, or say in one line that the extra ``agents`` is needed."""
    try:
        from agents.commands.application import main as command
    except ModuleNotFoundError as error:
        print(
            f"hydro: {error.name} is not installed; install the extra: pip install 'hydro_env[agents]'", file=sys.stderr
        )
        sys.exit(2)
    command()
