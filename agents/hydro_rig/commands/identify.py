"""``hydro identify``: the unknowns of a rig from its recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Output, Overwrite, OwnTask, command_line, say


def identify(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING...",
            help="Measured signals of one axis, one file or several: CSV, Parquet, MAT.",
        ),
    ],
    rig: Annotated[
        Path,
        typer.Option(
            "--rig", metavar="NAME|FILE", help="The rig file; its `randomisation` holds a range for each unknown."
        ),
    ],
    columns: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="[PATTERN=]FILE",
            help="YAML: the signal of each column, with unit, gain and offset. Repeat it for recordings with different "
            "columns: `--map '*_a.csv=a.yaml' --map '*_b.csv=b.yaml'`.",
        ),
    ] = None,
    hold_back: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Recordings that test the fit and are not used for it, such as '*_5V_*'; repeat the option for "
            "several. Default: chosen by motion and amplitude.",
        ),
    ] = None,
    task: OwnTask = None,
    output: Output = Path("results/identify"),
    overwrite: Overwrite = False,
) -> None:
    """Estimate the unknowns of a rig file: fit its ranges, the leak and the sensors' offsets to recordings.

    Several recordings share the unknowns, each with the sensors that it has.

    Writes `rig.yaml` (estimated values, ranges narrowed to their 95 % intervals; ready for `hydro check-rig` and `hydro
    study --rig`), a page (`identification.html`: measured and simulated signals, each interval, and the unknowns that
    the recording does not determine), and all numbers (`identification.json`). If the recording contradicts the rig,
    the command ends with one line. See `docs/identify.md`.
    """
    from hydro_agents.running.folders import refuse_taken
    from hydro_env.task.configuration import task_config
    from hydro_env.task.rig import read_rig
    from hydro_rig.estimation.progress import shown
    from hydro_rig.identification.files import FILES, JOB, identify_to_folder
    from hydro_rig.identification.identify import identify as identify_recordings
    from hydro_rig.recordings.columns import maps_of

    refuse_taken(output, JOB, FILES, overwrite)
    known = read_rig(rig)
    config = task_config(task, rig=known.source)
    maps = maps_of(columns or [], recordings)
    with shown():
        found = identify_recordings(recordings, config, known, maps, hold_back or [])
    say(*identify_to_folder(output, found, overwrite, command_line()))
