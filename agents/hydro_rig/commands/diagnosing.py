"""``hydro diagnose``, ``watch`` and ``trend``: verdicts on a machine, once, while it runs, and over weeks."""

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


def watch(
    columns: Columns = None,
    task: OwnTask = None,
    rig: Annotated[
        list[str] | None,
        typer.Option(metavar="[AXIS=]NAME|FILE", help="A rig, for all axes or one; repeat it. Default: the paper's."),
    ] = None,
    append: Annotated[
        Path, typer.Option(metavar="FILE", help="The table of readings, as that of `hydro trend`.")
    ] = Path("results/watch/watch.csv"),
    tag: Annotated[str, typer.Option(help="Column, or tag of line protocol, that names the axis.")] = "axis",
    oil: Annotated[
        str, typer.Option(metavar="GRADE", help="ISO VG grade, or mm²/s at 40 and 100 °C such as 46/8.1.")
    ] = "46",
    limit: Annotated[
        float, typer.Option(min=1e-3, max=100.0, help="Leak in l/min at 100 bar that is out of specification.")
    ] = 0.3,
    mqtt: Annotated[
        str | None, typer.Option(metavar="HOST[:PORT]/TOPIC", help="Read an MQTT topic instead of the standard input.")
    ] = None,
    protocol: Annotated[bool, typer.Option("--line-protocol", help="Print line protocol instead of JSON.")] = False,
) -> None:
    """Watch running axes: rows come in, one line per axis and look goes out, in the words of NAMUR NE 107.

    Rows are CSV below a heading line or the line protocol of InfluxDB, of one axis or several (`--tag`). A look every
    four seconds checks the wiring as `hydro diagnose` does, reads the newest window, and adds it to an alarm that gives
    one false alarm in 100 hours. The table holds a reading per hour and each change of state; beside it lies the memory
    of the alarms, with which the next call goes on. `docs/watch.md` shows Telegraf and MQTT.
    """
    from hydro_rig.recordings.columns import read_map
    from hydro_rig.watching.oil import Oil
    from hydro_rig.watching.rows import RowReader
    from hydro_rig.watching.sources import broker, lines_of, standard_input
    from hydro_rig.watching.stream import FleetWatch
    from hydro_rig.watching.watch import task_of

    fleet = FleetWatch(task_of(task, rig or []), limit, append, Oil.of(oil))
    reader = RowReader(read_map(columns) if columns is not None else None, tag)
    for look in fleet.looks(lines_of(broker(mqtt) if mqtt else standard_input), reader):
        say(look.line(protocol))
        sys.stdout.flush()


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
