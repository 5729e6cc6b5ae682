"""``hydro rehearse``: the exported code in closed loop with the simulated axis, before it meets the machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Output, Overwrite, Rig, command_line, say


def rehearse(
    folder: Annotated[Path, typer.Argument(help="Folder that `hydro export CONTROLLER` wrote.")],
    rig: Rig = None,
    output: Output = Path("results/rehearse"),
    overwrite: Overwrite = False,
) -> None:
    """Let the exported C code move the simulated axis: healthy, worn, wrong, with broken cables and an emergency stop.

    Without --rig the axis is that for which the folder was exported. Written are a page with curves and a table of what
    an engineer signs: peak error, overshoot, swing at rest, time to hold, travel after a fault. It needs a C compiler.
    Exit codes: 0 all scenes passed, 1 one of them did not.
    """
    from hydro_agents.report.kit import shown
    from hydro_agents.running.folders import output_folder
    from hydro_rig.export.rehearsal import FILES, JOB, write_rehearsal

    with output_folder(output, JOB, FILES, overwrite=overwrite):
        table = write_rehearsal(output, folder, rig, command_line())
    for scene, row in table.iterrows():
        figures = [f"{name.replace(', ', ' ')} {shown(value)}" for name, value in row.iloc[:5].dropna().items()]
        say(f"{scene}: {row['end']}; {', '.join(figures)}")
    say(*(output / name for name in FILES))
    raise typer.Exit(int((table["end"] != "passed").any()))
