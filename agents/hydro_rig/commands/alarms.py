"""``hydro alarms``: set an alarm to a rate of false alarms per 100 hours, and test it on new axes."""

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


@side_by_side
def alarms(
    output: Output = Path("results/alarms"),
    task: Task = None,
    rig: Rig = None,
    detector: Annotated[
        str,
        typer.Option(
            metavar="two_stage|head|estimator|MODULE:ATTRIBUTE",
            help="Detector: the leakage head in motion and the estimator at rest or in doubt, one of them alone, or "
            "your own.",
        ),
    ] = "two_stage",
    head: Annotated[Path | None, typer.Option(help="Weights of a leakage head; default: the shipped one.")] = None,
    rate: Annotated[float, typer.Option(help="Accepted false alarms per 100 hours.")] = 1.0,
    axes: Annotated[int, typer.Option(help="Axes for the calibration, and again for the test.")] = 40,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Set an alarm to a rate of false alarms per 100 hours from measured readings of simulated axes.

    The alarm sums up the readings of a detector. Each axis works for ten minutes, healthy and with leaks: all families
    of references, at full speed, slowly, and standing, under the PID and the flow-linearising controller. Hours and
    shifts are then drawn from these readings, axis by axis. The threshold comes from validation seeds; test seeds give
    false alarms, and leaks missed in a shift. Written are `alarm.yaml` (the settings), `alarms.md` and one
    CSV per table. Ctrl-C keeps the finished jobs, and `--resume` continues.
    """
    from hydro_agents.detection.detectors import DetectorChoice, make_detector
    from hydro_agents.detection.looks import window_of
    from hydro_agents.detection.monitor import HEAD_FILE
    from hydro_agents.learning.loading import shipped
    from hydro_agents.running.jobs import RESULT_FILES
    from hydro_agents.running.text import frame_markdown
    from hydro_env import ConfigurationError
    from hydro_env.files import validate
    from hydro_env.task.configuration import task_config
    from hydro_rig.monitoring.alarm_job import AlarmJob, run_job
    from hydro_rig.monitoring.alarm_simulation import Bench

    config = task_config(task, rig=rig)
    weights = str(head) if head is not None else None
    choice = validate(DetectorChoice, {"kind": detector, "weights": weights}, "--detector")
    if head is not None and detector not in ("head", "two_stage"):
        raise ConfigurationError(f"--head {head}: only a head has weights; leave out --head or --detector {detector}")
    job = validate(AlarmJob, {"rate": rate, "axes": axes}, "alarms")
    watching = make_detector(choice)
    window_of(watching, config)  # refuses a task that it cannot read
    name = detector if detector not in ("head", "two_stage") else f"{detector} {Path(head or HEAD_FILE).name}"
    controllers = [shipped(kind, config) for kind in ("pid", "flow_linearising")]

    def work(display: ProgressDisplay) -> Written:
        settings, tables = run_job(Bench(config, controllers, watching, name, output, display.update), job)
        settings.save(output / "alarm.yaml")
        files = {f"{title}.csv": table.to_csv(index=False) for title, table in tables.items()}
        shown = [
            f"## {title.replace('_', ' ')}\n\n{frame_markdown(table.set_index(table.columns[0]), 3)}"
            for title, table in tables.items()
        ]
        text = "\n\n".join([f"`{command_line()}`", *shown])
        return text, {**files, "alarms.md": text + "\n"}

    names = ["alarm.yaml", "alarms.md", "*.csv", RESULT_FILES]
    write_results(output, "alarms", names, work, resume, overwrite)
