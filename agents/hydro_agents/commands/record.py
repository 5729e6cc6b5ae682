"""``hydro record``: a recording of a simulated axis."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydro_agents.commands.options import (
    Faults,
    OverwriteFile,
    OwnTask,
    PlantSeed,
    Rig,
    check_new_file,
    command_line,
    exact_task,
    say,
)

if TYPE_CHECKING:
    from hydro_env import TaskConfig


def record(
    output: Annotated[Path | None, typer.Option("--output", "-o", help="CSV file to write.")] = None,
    minari: Annotated[
        str | None,
        typer.Option(metavar="NAME-v0", help="Minari data set to write instead of a CSV file, for offline learning."),
    ] = None,
    episodes: Annotated[int, typer.Option(help="Number of episodes of the data set.")] = 100,
    task: OwnTask = None,
    rig: Rig = None,
    controller: Annotated[
        str,
        typer.Option("--controller", help="A kind (pid, ppo, …), module:attribute, or the path of weights or gains."),
    ] = "pid",
    leakage: Annotated[
        float | None, typer.Option(help="Leak in l/min at 100 bar; default: drawn from the task's ranges.")
    ] = None,
    fault: Faults = None,
    duration: Annotated[
        float | None, typer.Option(help="Length in s; default: 20, or the task's for a data set.")
    ] = None,
    family: Annotated[
        str | None,
        typer.Option(
            help="Kind of reference: step, point_to_point, ramp, sine, multi_sine, start_stop; default: drawn."
        ),
    ] = None,
    seed: PlantSeed = 0,
    overwrite: OverwriteFile = False,
) -> None:
    """Record a simulated axis: time, position, pressures, spool and command as its sensors measure them.

    `hydro diagnose` reads the file. The first line is a comment with this command and the true leak. `--minari` writes
    a data set of episodes instead, with observations, actions, rewards and the hidden leak.

    With `--rig` alone the axis has the parameters of its file. With `--task`, for `--minari`, and without `--rig`, the
    task draws the parameters that are not known exactly.
    """
    from hydro_agents.learning.opponents import opponent
    from hydro_agents.recordings.simulated import named_faults, record_axis
    from hydro_env import ConfigurationError
    from hydro_env.task.configuration import task_config
    from hydro_env.task.reference_signals import FAMILIES

    if family is not None and family not in FAMILIES:
        raise ConfigurationError(f"--family '{family}': must be one of {', '.join(FAMILIES)}")
    if (output is None) == (minari is None):
        raise ConfigurationError("record: needs either --output FILE or --minari NAME")
    faults = named_faults(fault or [])
    if output is None:
        given = {"leakage_flow_lpm": leakage, "reference": family, "faults": faults or None}
        length = duration if duration is not None else task_config(task, rig=rig).episode_duration
        config = task_config(task, rig=rig, episode_duration=length)
        _record_dataset(str(minari), config, controller, episodes, seed, given)
        return
    check_new_file(output, overwrite)
    config = task_config(exact_task(task, rig), rig=rig, episode_duration=20.0 if duration is None else duration)
    mover = opponent(controller, config, "--controller")
    done = record_axis(output, config, mover, seed, leakage, family, faults, command_line())
    end = f"; the axis failed after {done.failed_at:g} s" if done.failed_at is not None else ""
    drawn = f"; parameters of the plant drawn by --seed {seed}" if config.randomisation else ""
    leak = f"leak {done.leakage_flow_lpm:.3g} l/min at 100 bar"
    say(f"{output}: {done.rows} rows, {done.duration:g} s, {leak}{drawn}{end}")


def _record_dataset(
    name: str, config: TaskConfig, controller: str, episodes: int, seed: int, given: Mapping[str, Any]
) -> None:
    from hydro_agents.learning.opponents import opponent
    from hydro_agents.recordings.simulated import check_dataset, record_dataset
    from hydro_agents.running.console import ProgressDisplay

    check_dataset(name)
    mover = opponent(controller, config, "--controller")
    options = {option: value for option, value in given.items() if value is not None}
    with ProgressDisplay() as display:

        def progress(finished: int) -> None:
            display.update("episodes", finished, episodes)

        data = record_dataset(name, config, mover, controller, episodes, seed, options, command_line(), progress)
    say(f"{name}: {data.episodes} episodes, {data.steps} steps, in {data.folder}")
