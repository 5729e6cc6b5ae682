"""``hydro record``, a recording of a simulated axis, and ``identify``, the unknowns of a rig from its recordings."""

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import (
    Faults,
    Output,
    Overwrite,
    OverwriteFile,
    OwnTask,
    PlantSeed,
    Rig,
    check_new_file,
    command_line,
    say,
)


def record(
    output: Annotated[Path, typer.Option("--output", "-o", help="CSV file to write.")],
    task: OwnTask = None,
    rig: Rig = None,
    controller: Annotated[
        str, typer.Option(help="A kind (pid, ppo, …), module:attribute, or the path of weights or gains.")
    ] = "pid",
    leakage: Annotated[float | None, typer.Option(help="Leak in l/min at 100 bar; default: drawn.")] = None,
    fault: Faults = None,
    duration: Annotated[float, typer.Option(help="Length in s.")] = 20.0,
    family: Annotated[
        str | None, typer.Option(help="Kind of reference, such as sine, step or point_to_point; default: drawn.")
    ] = None,
    seed: PlantSeed = 0,
    overwrite: OverwriteFile = False,
) -> None:
    """Record a simulated axis: time, position, pressures, spool and command as its sensors measure them.

    `hydro diagnose` reads the file. The first line is a comment with this command and the true leak. With `--rig`
    alone the axis has the parameters of its file; otherwise the task draws those that are not known exactly.
    """
    from hydro_agents.learning.loading import GainsOrigin, load_controller, origin_of_gains, shipped
    from hydro_agents.learning.rig_gains import chosen_gains
    from hydro_agents.running.tasks import named_faults
    from hydro_env import ConfigurationError, task_config
    from hydro_env.task.reference_signals import FAMILIES
    from hydro_rig.recordings.simulated import record_axis

    if family is not None and family not in FAMILIES:
        raise ConfigurationError(f"--family '{family}': must be one of {', '.join(FAMILIES)}")
    check_new_file(output, overwrite)
    if task is None and rig:
        task = "as_given"  # the parameters of the file, without any draw
    usual = task_config(task, rig=rig)
    config = task_config(usual, episode_duration=duration)
    origin = GainsOrigin.TUNED
    if controller == "pid":  # its gains need no episodes as long as the recording
        mover = shipped(controller, config, lambda kind, _: chosen_gains(kind, usual))
        origin = origin_of_gains(controller, config)
    else:
        mover = load_controller(controller, config, "--controller")
    done = record_axis(output, config, mover, seed, leakage, family, named_faults(fault or []), command_line())
    if origin != GainsOrigin.TUNED:
        say(f"{output}: gains of the PID: {origin}")
    told = [f"{output}: {done.rows} rows, {done.duration:g} s, leak {done.leakage_flow_lpm:.3g} l/min at 100 bar"]
    if config.randomisation:
        told.append(f"parameters of the plant drawn by --seed {seed}")
    if done.failed_at is not None:
        told.append(f"the axis failed after {done.failed_at:g} s")
    say("; ".join(told))


def identify(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING...", help="Measured signals of one axis, one file or several: CSV, Parquet, MAT."
        ),
    ],
    rig: Annotated[
        Path,
        typer.Option(metavar="NAME|FILE", help="The rig file; its `randomisation` holds a range for each unknown."),
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
    from hydro_env import task_config
    from hydro_env.task.rig import read_rig
    from hydro_rig.estimation.solver import shown
    from hydro_rig.identification.identification_page import FILES, JOB, identify_to_folder
    from hydro_rig.identification.identify import identify as identify_recordings
    from hydro_rig.recordings.columns import maps_of

    refuse_taken(output, JOB, FILES, overwrite)
    known = read_rig(rig)
    config = task_config(task, rig=known.source)
    with shown():
        found = identify_recordings(recordings, config, known, maps_of(columns or [], recordings), hold_back or [])
    say(*identify_to_folder(output, found, overwrite, command_line()))
