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
    unknown: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="An unknown in addition to the task's, such as valve.null_shift or load.external_force; repeat "
            "the option for several.",
        ),
    ] = None,
    controller: MovingController = "pid",
    plants: Annotated[int | None, typer.Option(min=3, max=10_000, help="Plants per motion and leak.")] = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Compute how precisely any method could estimate the leak: the Cramér–Rao bound.

    The bound is the smallest standard deviation, in l/min at 100 bar, that the sensors, their noise and the motion
    allow when the plant's equations are known but its parameters are not. The command compares sets of unknowns, sets
    of sensors, lengths of the window, and motions. It takes some minutes; its first parts show how many on your
    machine. It writes all numbers as CSV, tables as Markdown and a picture. Ctrl-C keeps the finished jobs, and
    `--resume` goes on.
    """
    from hydro_agents.learning.opponents import opponent
    from hydro_agents.running.jobs import JOBS_FOLDER
    from hydro_env.files import validate
    from hydro_env.task.configuration import task_config
    from hydro_rig.estimation.leak_bound import SurveySettings, checked, survey
    from hydro_rig.estimation.leak_bound_page import bound_markdown, bound_picture

    given = {"leak_levels": leak, "windows": window, "plants": plants, "more_unknowns": unknown}
    settings = validate(SurveySettings, {name: value for name, value in given.items() if value}, "leak-bound")
    config = task_config(task, rig=rig)
    checked(settings, config)
    moving = opponent(controller, config, f"--controller {controller}")

    def work(display: ProgressDisplay) -> Written:
        table = survey(config, moving, settings, output, display.update)
        text = bound_markdown(table)
        numbers = table.to_csv(index=False, float_format="%.6g")
        return text, {
            "leak_bound.csv": numbers,
            "leak_bound.md": f"`{command_line()}`\n\n{text}\n",
            "leak_bound.png": bound_picture(table),
        }

    files = ["leak_bound.csv", "leak_bound.md", "leak_bound.png", f"{JOBS_FOLDER}/*.npz"]
    write_results(output, "leak-bound", files, work, resume, overwrite)
