"""``hydro test-move``: a short move that makes a leak visible."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.leak_bound import MovingController
from hydro_agents.commands.options import Output, Overwrite, Rig, Task, command_line, say, show


def design_test_move(
    output: Output = Path("results/test_move"),
    task: Task = None,
    rig: Rig = None,
    travel: Annotated[
        float | None,
        typer.Option(help="Distance in mm between the outermost positions; default: the largest step of the task."),
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="Largest speed in mm/s; default: that of the task's references.")
    ] = None,
    duration: Annotated[float, typer.Option(help="Length in s.")] = 2.0,
    leak: Annotated[float, typer.Option(help="Leak in l/min at 100 bar for which the move is designed.")] = 0.3,
    controller: MovingController = "pid",
    plants: Annotated[int, typer.Option(min=3, max=10_000, help="Simulated axes that try the move.")] = 16,
    evaluations: Annotated[
        int | None, typer.Option(min=1, help="Number of moves that the search tries; default: 240.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Design a short move that makes a leak most visible, and estimate the leak from it on simulated axes.

    The move has up to four strokes with holds between them, within your limits of travel and speed; it ends where it
    began. The search lowers the Cramér–Rao bound of the leak (`hydro leak-bound`) on training plants. Then test plants
    make the move, with and without the leak, and the leak is estimated from their signals. The table also shows the
    estimates from ordinary motion, slow motion and rest. It takes some minutes; its first parts show how many on
    your machine. `move.csv` holds the reference for your own axis.
    """
    from hydro_agents.estimation.move_design import MoveSettings, design, limits_of, moved
    from hydro_agents.evaluation.leak_bound import trial
    from hydro_agents.learning.opponents import opponent
    from hydro_agents.report.bounds import gain, move_picture, move_table, trial_markdown
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.running.seeds import EVALUATION
    from hydro_env.files import validate, write_text, write_whole
    from hydro_env.task.configuration import task_config

    given = {
        "travel": None if travel is None else 1e-3 * travel,
        "speed": None if speed is None else 1e-3 * speed,
        "duration": duration,
        "leak": leak,
        "evaluations": evaluations,
    }
    settings = validate(MoveSettings, {name: value for name, value in given.items() if value is not None}, "test-move")
    config = task_config(task, rig=rig)
    limits_of(config, settings)
    moving = opponent(controller, config, f"--controller {controller}")
    files = ["move.csv", "trial.csv", "test_move.md", "test_move.png"]
    with output_folder(output, "test-move", files, overwrite=overwrite), ProgressDisplay() as display:
        best = design(config, moving, settings, display.update)
        reference = best.move.reference(config.control_period)
        lines = [f"{config.control_period * k:.6g},{x:.6f}" for k, x in enumerate(reference)]
        write_text(output / "move.csv", "\n".join(["time_s,reference_m", *lines]) + "\n")
        leaks = (0.0, leak) if leak > 0.0 else (0.0,)
        table = trial(config, moving, best.move, leaks, plants, display.update)
        text = f"{move_table(best.move)}\n\n{gain(best)}\n\n{trial_markdown(table)}"
        write_text(output / "trial.csv", table.to_csv(index=False, float_format="%.6g"))
        write_text(output / "test_move.md", f"`{command_line()}`\n\n{text}\n")
        windows = moved(config, moving, best.move, EVALUATION.take(plants), plants, leaks[-1])
        write_whole(output / "test_move.png", move_picture(best.move, windows, table, config.control_period))
    show(text)
    say(f"results in {output}")
