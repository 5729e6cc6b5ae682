"""``hydro diagnose`` and ``hydro trend``: verdicts on recordings of a machine, once and over weeks."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import (
    Columns,
    Json,
    Output,
    Overwrite,
    OwnTask,
    Recording,
    Rig,
    command_line,
    say,
)


def diagnose(
    recording: Recording,
    columns: Columns = None,
    task: OwnTask = None,
    rig: Rig = None,
    detector: Annotated[
        str | None,
        typer.Option(
            "--detector",
            "--head",
            metavar="WEIGHTS|MODULE:ATTRIBUTE",
            help="Detector beside the estimator: weights of a leakage head, or your own; default: the shipped head.",
        ),
    ] = None,
    window: Annotated[float, typer.Option(min=0.2, max=60.0, help="Length of one reading in s.")] = 2.0,
    as_json: Json = False,
    output: Output = Path("results/diagnose"),
    overwrite: Overwrite = False,
) -> None:
    """Judge a recording: healthy, internal leak (with its size), another fault (which), or undecided (why).

    First it checks the recording: gaps, jitter, units, signs, exchanged chambers, stuck and saturated sensors. Then two
    detectors read the leak window by window: an estimator with the simulator as model, and the leakage head or another
    one (`--detector`). Writes a page (`diagnosis.html`), the leak over time and the findings as CSV; the last
    line is the verdict. Columns need the names that `hydro record` writes, or a map; `docs/diagnose.md` shows one.

    Exit codes: 0 healthy, 10 internal leak, 11 something else, 12 cannot tell, 2 wrong input.
    """
    from hydro_agents.running.folders import refuse_taken
    from hydro_env.task.configuration import task_config
    from hydro_rig.diagnosis.diagnose import companion_of, in_json
    from hydro_rig.diagnosis.diagnose import diagnose as diagnose_recording
    from hydro_rig.diagnosis.diagnosis_page import FILES, JOB, diagnose_to_folder
    from hydro_rig.diagnosis.verdict import EXIT_CODES
    from hydro_rig.estimation.progress import shown
    from hydro_rig.recordings.columns import read_map

    refuse_taken(output, JOB, FILES, overwrite)
    config = task_config(task, rig=rig)
    companion = companion_of(detector)
    mapped = read_map(columns) if columns is not None else None
    with shown(as_json):
        diagnosis = diagnose_recording(recording, config, companion, mapped, window)
    lines = diagnose_to_folder(output, diagnosis, overwrite, command_line())
    if as_json:
        lines = [json.dumps(in_json(diagnosis), indent=1, ensure_ascii=False)]
    say(*lines)
    raise typer.Exit(EXIT_CODES[diagnosis.verdict.kind])


def trend(
    recordings: Annotated[
        list[Path],
        typer.Argument(metavar="FOLDER...", help="Folders of recordings, one sub-folder per axis, or single files."),
    ],
    append: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="The table; rows of new files are added to it. The page is written beside it."
        ),
    ] = Path("results/trend/trend.csv"),
    columns: Annotated[
        list[str] | None,
        typer.Option("--map", metavar="[PATTERN=]FILE", help="Map of the columns, for all files or by file name."),
    ] = None,
    task: OwnTask = None,
    rig: Annotated[
        list[str] | None,
        typer.Option(metavar="[AXIS=]NAME|FILE", help="A rig, for all axes or one; repeat it. Default: the paper's."),
    ] = None,
    oil: Annotated[
        str, typer.Option(metavar="GRADE", help="ISO VG grade, or mm²/s at 40 and 100 °C such as 46/8.1.")
    ] = "46",
    limit: Annotated[
        float | None,
        typer.Option(min=1e-3, max=100.0, help="Leak in l/min at 100 bar and 40 °C whose date is told; default: 0.3."),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Files that are read side by side.")] = 1,
    as_json: Json = False,
) -> None:
    """Watch axes over weeks: one row per recording, the growth of the leak, and the date of a limit.

    Each file that the table does not hold yet is read: its liveliest windows, with the estimator of `hydro diagnose`.
    Sizes are referred to 100 bar and 40 °C. Writes the table and a page. Ctrl-C keeps all finished files; the same
    command goes on. `docs/trend.md` shows timers and files of historians.

    Exit codes: 0 all healthy and fresh, 10 an axis leaks, 11 something else, 12 cannot tell, 13 unread, 14 stale,
    2 wrong input.
    """
    from hydro_agents.running.machine import Origin
    from hydro_rig.estimation.progress import shown
    from hydro_rig.watching.page import trend_page
    from hydro_rig.watching.watch import watch

    with shown(as_json):
        found = watch(recordings, append, columns or [], task, rig or [], oil, limit, jobs)
    page = append.with_suffix(".html")
    trend_page(found.trends, append.name, found.left_out).write(page, Origin.now(command_line()))
    for line in found.left_out:
        print(f"hydro: left out: {line}", file=sys.stderr)
    if as_json:
        say(json.dumps(found.facts(), indent=1, ensure_ascii=False))
    else:
        done = f"{append}: {found.read} files read, {found.known} known, {len(found.left_out)} left out"
        say(*(one.line() for one in found.trends), done, page)
    raise typer.Exit(found.exit_code)
