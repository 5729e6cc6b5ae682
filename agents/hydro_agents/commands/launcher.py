"""Entry point of the command ``hydro``: if the learning libraries are missing, it names the extra to install."""

import sys


def main() -> None:
    """Run the command line, or print one line that names the missing extra."""
    try:
        from hydro_agents.commands.application import main as command
    except ModuleNotFoundError as error:
        print(
            f"hydro: {error.name} is not installed; install the extra: pip install 'hydro_env[agents]'", file=sys.stderr
        )
        sys.exit(2)
    command()
