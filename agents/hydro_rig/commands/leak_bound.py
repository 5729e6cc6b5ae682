"""``hydro leak-bound``: how precisely any method could estimate the leak."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_agents.commands.options import (
    Output,
    Overwrite,
    Resume,
    Rig,
    Task,
    Written,
    command_line,
    side_by_side,
    write_results,
)

if TYPE_CHECKING:
    from hydro_agents.running.console import ProgressDisplay

LEAKS = (0.0, 0.05, 0.1, 0.3, 1.0, 4.0)  # l/min at 100 bar
WINDOWS = (0.5, 1.0, 2.0, 4.0, 8.0)  # s

MovingController = Annotated[
    str,
    typer.Option(
        "--controller",
        metavar="KIND|WHAT",
        help="Controller that moves the axis: pid, flow_linearising, adrc, lqg, mpc or ppo as shipped, "
        "module:attribute, or the path of weights.",
    ),
]


@side_by_side
def leak_bound(
    output: Output = Path("results/leak_bound"),
    task: Task = None,
    rig: Rig = None,
    window: Annotated[
        list[float] | None,
        typer.Option(help="Length in s; repeat the option for several. Default: 0.5, 1, 2, 4 and 8."),
    ] = None,
    leak: Annotated[
        list[float] | None,
        typer.Option(
            help="Leak in l/min at 100 bar; repeat the option for several. Default: 0, 0.05, 0.1, 0.3, 1 and 4."
        ),
    ] = None,
    controller: MovingController = "pid",
    plants: Annotated[int, typer.Option(min=3, max=10_000, help="Plants per motion and leak.")] = 24,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Compute how precisely any method could estimate the leak: the Cramér–Rao bound.

    The bound is the smallest standard deviation, in l/min at 100 bar, that the sensors, their noise and the motion
    allow when the plant's equations are known but its parameters are not. The command compares sets of unknowns, sets
    of sensors, lengths of the window, and motions. It takes some minutes; its first parts show how many on your
    machine. It writes all numbers as CSV and tables as Markdown. Ctrl-C keeps the finished jobs, and
    `--resume` goes on.
    """
    from hydro_agents.learning.opponents import opponent
    from hydro_agents.running.jobs import JOBS_FOLDER
    from hydro_env.task.configuration import task_config
    from hydro_rig.estimation.leak_bound import bound_markdown, survey

    config = task_config(task, rig=rig)
    moving = opponent(controller, config, f"--controller {controller}")

    def work(display: ProgressDisplay) -> Written:
        table = survey(config, moving, leak or LEAKS, window or WINDOWS, plants, output, display.update)
        text = bound_markdown(table)
        numbers = table.to_csv(index=False, float_format="%.6g")
        return text, {"leak_bound.csv": numbers, "leak_bound.md": f"`{command_line()}`\n\n{text}\n"}

    files = ["leak_bound.csv", "leak_bound.md", f"{JOBS_FOLDER}/*.npz"]
    write_results(output, "leak-bound", files, work, resume, overwrite)
