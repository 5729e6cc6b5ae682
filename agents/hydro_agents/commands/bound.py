"""``hydro bound``: how much better than the shipped controllers any controller could be."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Agents, Output, Overwrite, Rig, Task, command_line, named_agents, say, show


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

    from hydro_agents.evaluation.best_found import (
        ComparisonSettings,
        compare,
        convergence,
        summary,
        travel,
    )
    from hydro_agents.report.bounds import convergence_picture
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.running.text import frame_markdown
    from hydro_agents.study.settings import StudySettings
    from hydro_env.files import validate, write_whole
    from hydro_env.folders import config_file
    from hydro_env.task.configuration import task_config

    study = StudySettings.from_yaml(config_file("studies", "opponents"))
    config = task_config(task, rig=rig)
    levels = leak or ([1.0] if converge else [0.01, 0.3, 1.0, 4.0])
    settings = validate(ComparisonSettings, {"leak_levels": levels, "plants": plants, "validation": converge}, "bound")
    files = ["bound.md", "bound.csv", "convergence.md", "convergence.png"]
    with output_folder(output, "bound", files, overwrite=overwrite), ProgressDisplay() as display:
        if converge:
            table = convergence(config, settings, VARIATIONS, display.update)
            table.index = pd.Index(table["setting"] + " " + table["value"].astype(str), name="setting")
            text = frame_markdown(table.drop(columns=["setting", "value"]))
            write_whole(output / "convergence.png", convergence_picture(table))
            write_whole(output / "convergence.md", f"`{command_line()}`, mean error in mm\n\n{text}\n".encode())
        else:
            controllers, unfit = study.model_copy(update={"task": config}).fitting(named_agents(agent))
            for reason in unfit:
                display.say(f"left out: {reason}")
            frame = compare(config, controllers, settings, display.update)
            parts = [frame_markdown(summary(frame, by)) for by in ("family", "leakage_flow_lpm")]
            price = "Valve travel, full strokes per second:"
            text = "\n\n".join(["Mean |error|, mm:", *parts, price, frame_markdown(travel(frame), 2)])
            frame.to_csv(output / "bound.csv", index=False)
            write_whole(output / "bound.md", f"`{command_line()}`\n\n{text}\n".encode())
    show(text)
    say(f"results in {output}")


VARIATIONS = {
    "horizon": (8, 12, 16, 20, 30),
    "iterations": (1, 2, 4),
    "samples": (0, 8, 64),
    "preview": (0, 4, 8, 16, 400),
}
"""Settings of the search that ``--converge`` varies, one at a time."""
