"""``hydro record``: a recording of a simulated axis."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agents.commands.options import Rig, command_line, say


def record(
    output: Annotated[Path, typer.Option("--output", "-o", help="CSV file to write.")],
    task: Annotated[
        str | None, typer.Option("--task", metavar="NAME|FILE", help="A name in `configs/tasks` or a YAML file.")
    ] = None,
    rig: Rig = None,
    controller: Annotated[
        str, typer.Option("--controller", help="A kind (pid, ppo, …), module:attribute, or the path of weights.")
    ] = "pid",
    leakage: Annotated[
        float | None, typer.Option(help="Leak in l/min at 100 bar; default: drawn from the task's ranges.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option("--fault", metavar="NAME=VALUE", help="Such as valve_null_shift=0.01; repeat it for several."),
    ] = None,
    duration: Annotated[float, typer.Option(help="s")] = 20.0,
    family: Annotated[
        str | None, typer.Option(help="Family of references, such as point_to_point; default: drawn.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", "-s", min=0, max=2**32 - 1, help="Of plant, reference and noise.")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file.")] = False,
) -> None:
    """Record a simulated axis: time, position, pressures, spool and command as its sensors measure them.

    `hydro diagnose` reads the file. The first line is a comment with this command; it tells the leak.
    """
    from agents.evaluation.opponents import opponent
    from agents.recordings.simulated import named_faults, record_axis
    from hydro_env import ConfigurationError
    from hydro_env.task.configuration import task_config

    if output.exists() and not overwrite:
        raise ConfigurationError(f"{output}: exists; --overwrite replaces it")
    if output.is_dir():
        raise ConfigurationError(f"{output}: is a folder; --output needs a file")
    config = task_config(task, rig=rig, episode_duration=duration)
    mover = opponent(controller, config, "--controller")
    done = record_axis(output, config, mover, seed, leakage, family, named_faults(fault or []), command_line())
    end = f"; the axis failed after {done.failed_at:g} s" if done.failed_at is not None else ""
    say(f"{output}: {done.rows} rows, {done.duration:g} s, leak {done.leakage_flow_lpm:.3g} l/min at 100 bar{end}")
