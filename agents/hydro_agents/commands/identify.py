"""``hydro identify``: a rig from a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Columns, Output, Overwrite, OwnTask, Recording, command_line, say


def identify(
    recording: Recording,
    rig: Annotated[
        Path,
        typer.Option(
            "--rig", metavar="NAME|FILE", help="The rig file; its `randomisation` holds a range for each unknown."
        ),
    ],
    columns: Columns = None,
    task: OwnTask = None,
    output: Output = Path("results/identify"),
    overwrite: Overwrite = False,
) -> None:
    """Estimate the unknowns of a rig file: fit its ranges, the leak and the sensors' offsets to a recording.

    Writes `rig.yaml` (estimated values, ranges narrowed to their 95 % intervals; ready for `hydro check-rig` and `hydro
    study --rig`), a page (`identification.html`: measured and simulated signals, each interval, the unknowns that the
    recording cannot determine, and motions that would), and all numbers (`identification.json`). If the recording
    contradicts the rig, the command ends with one line. See `docs/identify.md`.
    """
    from hydro_agents.recordings.columns import read_map
    from hydro_agents.rigs.identification_page import identify_to_folder
    from hydro_agents.rigs.identify import identify as identify_recording
    from hydro_agents.running.console import ProgressDisplay
    from hydro_env.task.configuration import task_config
    from hydro_env.task.rig import read_rig

    known = read_rig(rig)
    config = task_config(task, rig=known.source)
    mapped = read_map(columns) if columns is not None else None
    with ProgressDisplay() as display:
        found = identify_recording(recording, config, known, mapped, display.update)
    say(*identify_to_folder(output, found, overwrite, command_line()))
