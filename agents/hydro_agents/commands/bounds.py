"""``hydro bound`` and ``leak-bound``: what any method could reach."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_agents.commands.options import (
    Agents,
    Output,
    Overwrite,
    Resume,
    Rig,
    Task,
    Written,
    command_line,
    named_agents,
    side_by_side,
    write_results,
)

if TYPE_CHECKING:
    from hydro_agents.running.console import ProgressDisplay


def bound(
    output: Output = Path("results/bound"),
    task: Task = None,
    rig: Rig = None,
    plants: Annotated[int, typer.Option(min=3, max=1000, help="Plants per leak level and reference family.")] = 3,
    leak: Annotated[
        list[float] | None,
        typer.Option(
            help="Leak in l/min at 100 bar; repeat the option for several. Default: 0.01, 0.3, 1, 4; with --converge 1."
        ),
    ] = None,
    converge: Annotated[
        bool, typer.Option("--converge", help="Show how the result depends on the size of the search instead.")
    ] = False,
    agent: Agents = None,
    overwrite: Overwrite = False,
) -> None:
    """Find the smallest errors that a controller could reach, and compare them with those of the shipped controllers.

    A search plans the commands with the simulator itself. It knows the true state, and either the true plant with its
    leak or only the data sheet; the difference is the value of knowing the plant. The command prints the mean error for
    each family of references and each leak, and writes all cases as CSV. It takes some minutes; the first
    seconds of the search show how many on your machine.
    """
    import pandas as pd

    from hydro_agents.evaluation.best_found import ComparisonSettings, compare, convergence, summary, travel
    from hydro_agents.report.bounds import convergence_picture
    from hydro_agents.running.text import frame_markdown
    from hydro_agents.study.settings import StudySettings
    from hydro_env.files import validate
    from hydro_env.folders import config_file
    from hydro_env.task.configuration import task_config

    study = StudySettings.from_yaml(config_file("studies", "opponents"))
    config = task_config(task, rig=rig)
    levels = leak or ([1.0] if converge else [0.01, 0.3, 1.0, 4.0])
    settings = validate(ComparisonSettings, {"leak_levels": levels, "plants": plants, "validation": converge}, "bound")

    def converged(display: ProgressDisplay) -> Written:
        table = convergence(config, settings, VARIATIONS, display.update)
        table.index = pd.Index(table["setting"] + " " + table["value"].astype(str), name="setting")
        text = frame_markdown(table.drop(columns=["setting", "value"]))
        page = f"`{command_line()}`, mean error in mm\n\n{text}\n"
        return text, {"convergence.png": convergence_picture(table), "convergence.md": page}

    def compared(display: ProgressDisplay) -> Written:
        controllers, unfit = study.model_copy(update={"task": config}).fitting(named_agents(agent))
        for reason in unfit:
            display.say(f"left out: {reason}")
        frame = compare(config, controllers, settings, display.update)
        parts = [frame_markdown(summary(frame, by)) for by in ("family", "leakage_flow_lpm")]
        price = "Valve travel, full strokes per second:"
        text = "\n\n".join(["Mean |error|, mm:", *parts, price, frame_markdown(travel(frame), 2)])
        return text, {"bound.csv": frame.to_csv(index=False), "bound.md": _page(text)}

    files = ["bound.md", "bound.csv", "convergence.md", "convergence.png"]
    write_results(output, "bound", files, converged if converge else compared, overwrite=overwrite)


VARIATIONS = {
    "horizon": (8, 12, 16, 20, 30),
    "iterations": (1, 2, 4),
    "samples": (0, 8, 64),
    "preview": (0, 4, 8, 16, 400),
}
"""Settings of the search that ``--converge`` varies, one at a time."""


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
    from hydro_agents.evaluation.leak_bound import SurveySettings, checked, survey
    from hydro_agents.learning.opponents import opponent
    from hydro_agents.report.bounds import bound_markdown, bound_picture
    from hydro_agents.running.jobs import JOBS_FOLDER
    from hydro_env.files import validate
    from hydro_env.task.configuration import task_config

    given = {"leak_levels": leak, "windows": window, "plants": plants, "more_unknowns": unknown}
    settings = validate(SurveySettings, {name: value for name, value in given.items() if value}, "leak-bound")
    config = task_config(task, rig=rig)
    checked(settings, config)
    moving = opponent(controller, config, f"--controller {controller}")

    def work(display: ProgressDisplay) -> Written:
        table = survey(config, moving, settings, output, display.update)
        text = bound_markdown(table)
        numbers = table.to_csv(index=False, float_format="%.6g")
        return text, {"leak_bound.csv": numbers, "leak_bound.md": _page(text), "leak_bound.png": bound_picture(table)}

    files = ["leak_bound.csv", "leak_bound.md", "leak_bound.png", f"{JOBS_FOLDER}/*.npz"]
    write_results(output, "leak-bound", files, work, resume, overwrite)


def _page(text: str) -> str:
    return f"`{command_line()}`\n\n{text}\n"
