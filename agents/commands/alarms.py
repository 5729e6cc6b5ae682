"""``hydro alarms``: set alarms over time in false alarms per 100 hours, and prove them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agents.commands.options import Output, Overwrite, Resume, Rig, Task, command_line, say


def alarms(
    output: Output = Path("results/alarms"),
    task: Task = None,
    rig: Rig = None,
    head: Annotated[Path | None, typer.Option(help="Weights of a leakage head; default: the shipped one.")] = None,
    rate: Annotated[float, typer.Option(help="False alarms per 100 hours that are accepted.")] = 1.0,
    hours: Annotated[
        float, typer.Option(help="Hours of healthy axes to simulate, for the calibration and for the proof each.")
    ] = 40.0,
    axes: Annotated[int, typer.Option(help="Axes with the onset of a leak, for each size and activity.")] = 128,
    interval: Annotated[float, typer.Option(help="Seconds from look to look.")] = 0.5,
    learning: Annotated[int, typer.Option(help="Looks in each activity until an axis's own baseline is known.")] = 60,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Set the alarm on top of the leakage head in false alarms per 100 hours, by simulating hours of healthy axes.

    The axes work continuously: all families of references, at full speed, slowly, and standing, under the PID and the
    flow-linearising controller. The command compares several ways to sum up evidence on validation seeds, keeps the one
    that finds leaks soonest, and proves it on test seeds: false alarms, delays, leaks from the start, other faults,
    growth. It writes `alarm.yaml` (the settings), `alarms.md` and one CSV per table. With 40 hours it takes about a
    quarter of an hour on two quiet cores; Ctrl-C keeps the finished parts, and `--resume` goes on.
    """
    import torch

    from agents.alarms.detector import HeadDetector
    from agents.alarms.job import AlarmJob, run_job
    from agents.alarms.store import PATTERN, Bench
    from agents.bound.comparison import markdown
    from agents.evaluation.opponents import check_layout, shipped
    from agents.leakage.head import LeakageHead
    from agents.running.console import ProgressDisplay
    from agents.running.folders import output_folder, pretrained_folder
    from hydro_env import ConfigurationError
    from hydro_env.files import validate, write_text
    from hydro_env.task.configuration import task_config

    config = task_config(task, rig=rig)
    given = {"rate": rate, "hours": hours, "axes": axes, "interval": interval, "learning": learning}
    job = validate(AlarmJob, given, "alarms")
    path = head or pretrained_folder() / "leakage_head"
    watching = LeakageHead.load(path)
    try:
        check_layout(watching.settings.layout, config)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None
    torch.set_num_threads(1)  # the simulation takes the other cores
    controllers = {kind: shipped(kind, config) for kind in ("pid", "flow_linearising")}
    names = ["alarm.yaml", "alarms.md", "*.csv", PATTERN]
    with (
        output_folder(output, "alarms", names, resume=resume, overwrite=overwrite) as folder,
        ProgressDisplay() as display,
    ):
        bench = Bench(config, controllers, HeadDetector(watching), f"leakage head {path.name}", folder)
        settings, tables = run_job(bench, job, display.update)
        settings.save(folder / "alarm.yaml")
        parts = [f"`{command_line()}`"]
        for name, table in tables.items():
            write_text(folder / f"{name}.csv", table.to_csv(index=False))
            parts.append(f"## {name.replace('_', ' ')}\n\n{markdown(table.set_index(table.columns[0]), 3)}")
        text = "\n\n".join(parts)
        write_text(folder / "alarms.md", text + "\n")
    say(text, f"results in {output}")
