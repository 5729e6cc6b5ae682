"""``hydro alarms``: set an alarm to a rate of false alarms per 100 hours, and test it on new axes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_agents.commands.options import Output, Overwrite, Resume, Rig, Task, Written, command_line, write_results

if TYPE_CHECKING:
    from hydro_agents.running.console import ProgressDisplay


def alarms(
    output: Output = Path("results/alarms"),
    task: Task = None,
    rig: Rig = None,
    detector: Annotated[
        str,
        typer.Option(
            metavar="head|estimator|MODULE:ATTRIBUTE",
            help="Detector: the leakage head, the estimator with the simulator as its model, or your own.",
        ),
    ] = "head",
    head: Annotated[Path | None, typer.Option(help="Weights of a leakage head; default: the shipped one.")] = None,
    rate: Annotated[float, typer.Option(help="Accepted false alarms per 100 hours.")] = 1.0,
    hours: Annotated[
        float | None,
        typer.Option(
            help="Hours of healthy axes to simulate, first for the calibration and again for the test. Default: 40 "
            "(head), 2 (estimator)."
        ),
    ] = None,
    axes: Annotated[
        int | None,
        typer.Option(help="Axes that begin to leak, per leak size and activity. Default: 128 (head), 16 (estimator)."),
    ] = None,
    interval: Annotated[
        float | None, typer.Option(help="Seconds between readings. Default: 0.5 (head), 2 (estimator).")
    ] = None,
    learning: Annotated[
        int | None,
        typer.Option(help="Readings per activity that form an axis's own baseline. Default: 60 (head), 8 (estimator)."),
    ] = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Set an alarm to a rate of false alarms per 100 hours by simulating hours of healthy axes.

    The alarm sums up the readings of a detector. The axes work continuously: all families of references, at full speed,
    slowly, and standing, under the PID and the flow-linearising controller. The command compares several ways to sum up
    evidence on validation seeds, keeps the one that finds leaks soonest, and tests it on test seeds: false alarms,
    delays, leaks from the start, other faults, growth. It writes `alarm.yaml` (the settings), `alarms.md` and one CSV
    per table. The head with 40 hours takes some ten minutes, the estimator with 2 hours far longer; the first part
    shows how long on your machine. Ctrl-C keeps the finished jobs, and `--resume` continues.
    """
    from hydro_agents.detection.alarm_job import SIZES, run_job
    from hydro_agents.detection.alarm_simulation import Bench
    from hydro_agents.detection.detectors import DetectorChoice, make_detector
    from hydro_agents.detection.looks import window_of
    from hydro_agents.detection.monitor import HEAD_FILE
    from hydro_agents.learning.opponents import shipped
    from hydro_agents.running.jobs import JOBS_FOLDER
    from hydro_agents.running.text import frame_markdown
    from hydro_env import ConfigurationError
    from hydro_env.files import validate
    from hydro_env.task.configuration import task_config

    config = task_config(task, rig=rig)
    weights = str(head) if head is not None else None
    choice = validate(DetectorChoice, {"kind": detector, "weights": weights}, "--detector")
    if detector != "head" and head is not None:
        raise ConfigurationError(f"--head {head}: only the head has weights; leave out --head or --detector {detector}")
    given = {"rate": rate, "hours": hours, "axes": axes, "interval": interval, "learning": learning}
    chosen = {name: value for name, value in given.items() if value is not None}
    usual = SIZES["estimator" if detector == "estimator" else "head"]
    job = validate(type(usual), usual.model_dump() | chosen, "alarms")
    watching = make_detector(choice, following=True)
    window_of(watching, config)  # refuses a task that it cannot read
    name = f"leakage head {Path(head or HEAD_FILE).name}" if detector == "head" else detector
    controllers = {kind: shipped(kind, config) for kind in ("pid", "flow_linearising")}

    def work(display: ProgressDisplay) -> Written:
        together = 16 if detector == "estimator" else 128
        settings, tables = run_job(Bench(config, controllers, watching, name, output, together, display.update), job)
        settings.save(output / "alarm.yaml")
        files = {f"{title}.csv": table.to_csv(index=False) for title, table in tables.items()}
        shown = [
            f"## {title.replace('_', ' ')}\n\n{frame_markdown(table.set_index(table.columns[0]), 3)}"
            for title, table in tables.items()
        ]
        text = "\n\n".join([f"`{command_line()}`", *shown])
        return text, {**files, "alarms.md": text + "\n"}

    names = ["alarm.yaml", "alarms.md", "*.csv", f"{JOBS_FOLDER}/*.npz"]
    write_results(output, "alarms", names, work, resume, overwrite)
