"""``hydro bound``: the smallest errors that a controller could reach."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_agents.commands.options import (
    Agents,
    Output,
    Overwrite,
    Rig,
    Task,
    Written,
    command_line,
    named_agents,
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
        typer.Option(help="Leak in l/min at 100 bar; repeat the option for several. Default: 0.01, 0.3, 1, 4."),
    ] = None,
    agent: Agents = None,
    overwrite: Overwrite = False,
) -> None:
    """Find the smallest errors that a controller could reach, and compare them with those of the shipped controllers.

    A search plans the commands with the simulator itself. It knows the plant with its leak, and either the true state
    or what a Kalman filter makes of the measured signals: the bound that a controller can reach. The command prints
    the mean error for each family of references and each leak, and writes all cases as CSV. It takes some minutes; the
    first seconds of the search show how many on your machine.
    """
    from hydro_agents.evaluation.bound_comparison import bound_protocol, compare, means_by, summary
    from hydro_agents.running.text import frame_markdown
    from hydro_agents.study.settings import StudySettings
    from hydro_env.folders import config_file
    from hydro_env.task.configuration import task_config

    study = StudySettings.from_yaml(config_file("studies", "opponents"))
    config = task_config(task, rig=rig)
    protocol = bound_protocol(config, leak or [0.01, 0.3, 1.0, 4.0], plants)

    def compared(display: ProgressDisplay) -> Written:
        moved = study.model_copy(update={"task": config}).with_gains_of_rig()
        controllers, unfit = moved.fitting(named_agents(agent))
        for reason in unfit:
            display.say(f"left out: {reason}")
        frame = compare(protocol, controllers, display.update)
        parts = [frame_markdown(summary(frame, by)) for by in ("family", "leakage_flow_lpm")]
        travel = frame_markdown(means_by(frame, "valve_travel_per_s"), 2)
        text = "\n\n".join(["Mean |error|, mm:", *parts, "Valve travel, full strokes per second:", travel])
        return text, {"bound.csv": frame.to_csv(index=False), "bound.md": f"`{command_line()}`\n\n{text}\n"}

    write_results(output, "bound", ["bound.md", "bound.csv"], compared, overwrite=overwrite)
