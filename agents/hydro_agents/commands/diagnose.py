"""``hydro diagnose``: a verdict on the recording of an axis."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Columns, Output, Overwrite, OwnTask, Recording, Rig, command_line, say


def diagnose(
    recording: Recording,
    columns: Columns = None,
    task: OwnTask = None,
    rig: Rig = None,
    head: Annotated[Path | None, typer.Option(help="Weights of a leakage head; default: the shipped one.")] = None,
    alarm: Annotated[
        Path | None, typer.Option(help="Settings of an alarm, from `hydro alarms`, that watches the recording.")
    ] = None,
    window: Annotated[float, typer.Option(min=0.2, max=60.0, help="Length of one reading in s.")] = 2.0,
    output: Output = Path("results/diagnose"),
    overwrite: Overwrite = False,
) -> None:
    """Judge a recording: healthy, internal leak (with its size), another fault (which), or undecided (why).

    First it checks the recording: gaps, jitter, units, signs, exchanged chambers, stuck and saturated sensors. Then two
    detectors read the leak window by window: an estimator with the simulator as model, and the leakage head. Writes a
    page (`diagnosis.html`), a picture, the leak over time and the findings as CSV; the last line is the verdict.
    Columns need the names that `hydro record` writes, or a map; `docs/diagnose.md` shows one.
    """
    from hydro_agents.detection.alarm import AlarmSettings
    from hydro_agents.detection.head import LeakageHead
    from hydro_agents.recordings.columns import read_map
    from hydro_agents.rigs.diagnose import diagnose as diagnose_recording
    from hydro_agents.rigs.diagnosis_page import diagnose_to_folder
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import pretrained_folder
    from hydro_env.task.configuration import task_config

    config = task_config(task, rig=rig)
    weights = LeakageHead.load(head or pretrained_folder() / "leakage_head")
    mapped = read_map(columns) if columns is not None else None
    settings = AlarmSettings.load(alarm) if alarm is not None else None
    with ProgressDisplay() as display:
        found = diagnose_recording(recording, config, weights, mapped, window, settings, display.update)
    say(*diagnose_to_folder(output, found, overwrite, command_line()))
