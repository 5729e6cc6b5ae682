"""``hydro check-rig``: a table of a rig's speeds, forces, frequency and gain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Overwrite, Rig, say


def check_rig(
    rig: Rig = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for check.csv and check.md; default: no files.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Print the figures that an engineer calculates by hand for a rig, and refuse a rig that cannot work.

    The figures are areas, flows, speeds, forces, reach, natural frequency and damping, the largest stable proportional
    gain of the sampled position loop with a tight and a leaking seal, and the inner steps of the integrator.
    """
    from hydro_agents.rigs.check_table import check_to_console

    files = check_to_console(rig, output, overwrite)
    if files:
        say(*files)
