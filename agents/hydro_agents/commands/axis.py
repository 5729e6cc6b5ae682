"""``hydro simulate`` and ``render``: runs and films of axes."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_agents.commands.options import (
    Agents,
    Faults,
    Output,
    Overwrite,
    OverwriteFile,
    PlantSeed,
    Rig,
    Task,
    check_new_file,
    exact_task,
    named_agents,
    say,
)

if TYPE_CHECKING:
    from PIL.Image import Image


SHAPES = ("step", "sine", "sweep", "stop")


def simulate(
    output: Output = Path("results/simulate"),
    rig: Rig = None,
    signal: Annotated[
        str,
        typer.Option(
            "--input",
            metavar="step|sine|sweep|stop|FILE",
            help="Shape of the voltage, or a CSV with one voltage per sample (column `voltage`, or the last).",
        ),
    ] = "stop",
    voltage: Annotated[
        float, typer.Option(help="Amplitude in V, −10 to 10, added to the voltage that holds the initial position.")
    ] = 3.0,
    duration: Annotated[float, typer.Option(help="Length in s.")] = 1.0,
    sample_time: Annotated[float, typer.Option(help="Time in s for which each voltage is held.")] = 1e-3,
    leakage: Annotated[float | None, typer.Option(help="Leak in l/min at 100 bar, instead of the rig's own.")] = None,
    position: Annotated[
        float | None,
        typer.Option(help="Start at rest, in m from mid-stroke; default: mid-stroke if it can be held."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Run the rig open loop: states, flows and forces as CSV and as a picture.

    `--input stop` moves at constant voltage and then closes the valve: the quick stop of the paper. Compare
    `--leakage 0.01` with `--leakage 4`: the leak damps the oscillation.
    """
    from hydro_agents.rigs.simulation import simulate_to_folder

    file = None if signal in SHAPES else Path(signal)
    say(*simulate_to_folder(output, rig, signal, voltage, file, duration, sample_time, leakage, position, overwrite))


MOST_PANELS = 6
FRAMES_PER_SECOND = 25.0  # about


def render(
    output: Annotated[Path, typer.Option("--output", "-o", help="The film: .mp4.")],
    task: Task = None,
    rig: Rig = None,
    agent: Agents = None,
    leakage: Annotated[
        list[float] | None,
        typer.Option(help="Leak in l/min at 100 bar; repeat it for panels side by side. Default: drawn."),
    ] = None,
    fault: Faults = None,
    family: Annotated[str, typer.Option(help="Family of references.")] = "point_to_point",
    duration: Annotated[float, typer.Option(min=0.1, max=60.0, help="Length in s.")] = 4.0,
    seed: PlantSeed = 0,
    speed: Annotated[float, typer.Option(min=0.01, max=100.0, help="1 is real time, 0.1 ten times slower.")] = 1.0,
    width: Annotated[int, typer.Option(min=160, max=7680, help="Width in pixels.")] = 1280,
    overwrite: OverwriteFile = False,
) -> None:
    """Film axes under controllers: the same plant, reference and noise, side by side, in real time.

    Without `--agent`: the shipped PID and PPO on flow linearisation. `--agent pid=pid --leakage 0.01 --leakage 2` shows
    a healthy and a leaking seal side by side. With `--rig` alone the axes have the parameters of its file; with
    `--task`, or without `--rig`, the task draws the parameters that are not known exactly.
    """
    from hydro_agents.learning.opponents import opponent
    from hydro_agents.report.film import check_encoder, film, film_size, panels, write_film
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.tasks import named_faults
    from hydro_env import ConfigurationError
    from hydro_env.task.configuration import task_config

    if output.suffix.lower() != ".mp4":
        raise ConfigurationError(f"--output {output}: must end in .mp4")
    if output.is_dir() or not output.parent.is_dir():
        raise ConfigurationError(f"--output {output}: must be a file in a folder that exists")
    check_new_file(output, overwrite)
    check_encoder()
    config = task_config(exact_task(task, rig), rig=rig, episode_duration=duration)
    controllers = {name: opponent(what, config, name) for name, what in named_agents(agent).items()}
    if not controllers:
        controllers["PID"] = opponent("pid", config, "PID")
        try:
            controllers["PPO on flow linearisation"] = opponent("ppo", config, "PPO on flow linearisation")
        except ConfigurationError as error:  # the shipped weights belong to another rig or task
            print(f"hydro: left out: {error}", file=sys.stderr)
    shown = panels(controllers, leakage or [])
    if len(shown) > MOST_PANELS:
        raise ConfigurationError(f"{len(shown)} panels: must be at most {MOST_PANELS}; give fewer --agent or --leakage")
    periods = max(round(speed / (FRAMES_PER_SECOND * config.control_period)), 1)
    rate = speed / (periods * config.control_period)
    side_by_side = math.ceil(math.sqrt(len(shown)))
    options = {"reference": family, "faults": named_faults(fault or [])}
    count = config.steps // periods + 1
    frames = film(config, shown, seed, options, periods, width, side_by_side)
    with ProgressDisplay() as progress:

        def counted() -> Iterator[Image]:
            for number, frame in enumerate(frames):
                progress.update("film", number, count)
                yield frame
            progress.update("film", count, count)

        write_film(output, counted(), rate)
    pixels = film_size(len(shown), width, side_by_side)
    say(
        f"{output}: {count} frames of {pixels[0]} × {pixels[1]} pixels, {rate:.3g} per second, "
        f"{output.stat().st_size / 1e6:.2g} MB"
    )
