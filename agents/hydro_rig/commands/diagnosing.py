"""``hydro diagnose``, ``leak-test``, ``watch``, ``trend``: verdicts on a machine, once, while it runs, over weeks."""

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from hydro_agents.commands.options import Columns, Json, Output, Overwrite, OwnTask, Recording, Rig, command_line, say

FleetFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help="YAML of all axes: their rigs, maps, oils and limits; nothing else.")
]
OilGrade = Annotated[
    str | None, typer.Option(metavar="GRADE", help="ISO VG grade, or mm²/s at 40 and 100 °C: 46/8.1; default: 46.")
]
Limit = Annotated[
    float | None,
    typer.Option(min=1e-3, max=100.0, help="Leak that is too much, l/min at 100 bar and 40 °C; default: by the rig."),
]


def diagnose(
    recording: Recording,
    columns: Columns = None,
    task: OwnTask = None,
    rig: Rig = None,
    window: Annotated[float, typer.Option(min=0.2, max=60.0, help="Length of one reading in s.")] = 2.0,
    windows: Annotated[int, typer.Option(min=1, help="Readings of a long recording, spread over it.")] = 60,
    before: Annotated[
        Path | None,
        typer.Option(metavar="RECORDING", help="An earlier recording of the axis: has the leak fallen since then?"),
    ] = None,
    oil: OilGrade = None,
    as_json: Json = False,
    output: Output = Path("results/diagnose"),
    overwrite: Overwrite = False,
) -> None:
    """Judge a recording: healthy, internal leak (with its size), another fault (which), or undecided (why).

    First it checks the recording: gaps, jitter, units, signs, exchanged chambers, stuck and saturated sensors. Then
    an estimator reads the leak window by window, with the simulator as model. Writes a page (`diagnosis.html`), the
    leak over time and the findings as CSV; the last line is the verdict. With `--before` the line
    above it tells what a new seal did, at 40 °C. Columns need the names that `hydro record` writes, or a map;
    `docs/diagnose.md` shows one.

    Exit codes: 0 healthy, 10 internal leak, 11 something else, 12 cannot tell, 2 wrong input.
    """
    from hydro_agents.running.folders import refuse_taken
    from hydro_env import task_config
    from hydro_rig.diagnosis.diagnose import change_of, in_json
    from hydro_rig.diagnosis.diagnose import diagnose as diagnose_recording
    from hydro_rig.diagnosis.diagnosis_page import FILES, JOB, diagnose_to_folder
    from hydro_rig.diagnosis.oil import Oil
    from hydro_rig.diagnosis.verdict import EXIT_CODES
    from hydro_rig.estimation.solver import shown
    from hydro_rig.recordings.columns import read_map

    refuse_taken(output, JOB, FILES, overwrite)
    config, mapped = task_config(task, rig=rig), read_map(columns)
    filling, change = Oil.of(oil or "46"), None
    with shown(as_json):
        diagnosis = diagnose_recording(recording, config, mapped, window, windows)
        if before:
            change = change_of(diagnose_recording(before, config, mapped, window, windows), diagnosis, filling)
    lines = diagnose_to_folder(output, diagnosis, overwrite, command_line(), change.line if change else "")
    if as_json:
        facts = in_json(diagnosis)
        if change:
            facts["change"] = {"line": change.line, "fall": change.fall and change.fall._asdict()}
        lines = [json.dumps(facts, indent=1, ensure_ascii=False)]
    say(*lines)
    raise typer.Exit(EXIT_CODES[diagnosis.verdict.kind])


def watch(
    fleet: FleetFile = None,
    columns: Columns = None,
    task: OwnTask = None,
    rig: Rig = None,
    oil: OilGrade = None,
    limit: Limit = None,
    append: Annotated[
        Path, typer.Option(metavar="FILE", help="The table of readings, as that of `hydro trend`.")
    ] = Path("results/watch/watch.csv"),
    tag: Annotated[str, typer.Option(help="Column, or tag of line protocol, that names the axis.")] = "axis",
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
    from hydro_rig.watching.fleet import Fleet
    from hydro_rig.watching.rows import broker, lines_of, standard_input
    from hydro_rig.watching.stream import FleetWatch

    axes = Fleet.of(fleet, task=task, rig=rig, map=columns, oil=oil, limit=limit)
    _tell_rig(fleet, task, rig)
    for look in FleetWatch(axes, append).looks(lines_of(broker(mqtt) if mqtt else standard_input), tag):
        say(look.line(protocol))
        sys.stdout.flush()


def trend(
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FOLDER...", help="Folders of recordings, one sub-folder per axis, or single files."),
    ] = None,
    append: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="The table; rows of new files are added to it. The page is written beside it."
        ),
    ] = Path("results/trend/trend.csv"),
    fleet: FleetFile = None,
    columns: Columns = None,
    task: OwnTask = None,
    rig: Rig = None,
    oil: OilGrade = None,
    limit: Limit = None,
    jobs: Annotated[int, typer.Option(min=1, help="Files that are read side by side.")] = 1,
    as_json: Json = False,
) -> None:
    """Watch axes over weeks: one row per recording, the growth of the leak, and the date of a limit.

    Each file that the table does not hold yet is read: its liveliest windows, with the estimator of `hydro diagnose`.
    Sizes are referred to 100 bar and 40 °C. Writes the table and a page of all axes, the worst first; without a folder
    the page of a table, such as that of `hydro watch`. Ctrl-C keeps all finished files; the same command goes on.
    `docs/trend.md` shows timers and files of historians.

    Exit codes: 0 all healthy and fresh, 10 an axis leaks, 11 something else, 12 cannot tell, 13 unread, 14 stale,
    2 wrong input.
    """
    from hydro_agents.running.machine import Origin
    from hydro_rig.estimation.solver import shown
    from hydro_rig.watching.fleet import Fleet
    from hydro_rig.watching.page import trend_page
    from hydro_rig.watching.watch import watch

    axes = Fleet.of(fleet, task=task, rig=rig, map=columns, oil=oil, limit=limit)
    with shown(as_json):
        found = watch(recordings or [], append, axes, jobs)
    _tell_rig(fleet, task, rig)
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


def _tell_rig(*given: object) -> None:
    if given == (None, None, None):
        print("hydro: every axis is taken for the paper's rig; --rig or --fleet names others", file=sys.stderr)


def leak_test(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="[RECORDING]", help="Recording of the test, to be read. Without it the test is planned."
        ),
    ] = None,
    task: OwnTask = None,
    rig: Rig = None,
    columns: Columns = None,
    duration: Annotated[float, typer.Option(min=2.0, max=600.0, help="Of the plan, s.")] = 60.0,
    speed: Annotated[
        float | None, typer.Option(min=1.0, max=1e4, help="Largest speed of the plan in mm/s; default: 50.")
    ] = None,
    stop: Annotated[Literal["both", "extended", "retracted"], typer.Option(help="Stops to press against.")] = "both",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder; default: results/leak_test_plan, or results/leak_test."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Plan an active test of a minute that shows a leak past the piston; or, with RECORDING, read it.

    The test presses the axis against its stops at several openings, closes the valve, and makes short moves; the
    openings are those with which simulated axes stay within your limits. Written are a page (`plan.html`), the commands
    (`commands.csv`) and a simulated recording. The reading gives litres per minute with an interval, and the wear of
    the valve, as `leak_test.html` and JSON.
    Exit codes of the reading: 0 healthy, 10 internal leak, 11 something else, 12 cannot tell.
    """
    from hydro_agents.running.folders import output_folder, refuse_taken
    from hydro_env import task_config
    from hydro_rig.diagnosis import leak_test_page as pages
    from hydro_rig.diagnosis.leak_test import plan, read_leak_test
    from hydro_rig.diagnosis.verdict import EXIT_CODES
    from hydro_rig.estimation.solver import shown
    from hydro_rig.recordings.columns import read_map
    from hydro_rig.recordings.findings import lines_of

    config = task_config(task, rig=rig)
    files, usual = (pages.READING_FILES, "leak_test") if recording else (pages.PLAN_FILES, "leak_test_plan")
    folder = output or Path("results") / usual
    refuse_taken(folder, pages.JOB, files, overwrite)
    if not recording:
        planned = plan(config, duration, speed and 1e-3 * speed, stop)
        with output_folder(folder, pages.JOB, files, overwrite=overwrite):
            pages.write_plan(folder, planned, command_line())
        say(*(folder / name for name in files), planned.line())
        return
    with shown():
        found, quantities = read_leak_test(recording, config, read_map(columns))
    with output_folder(folder, pages.JOB, files, overwrite=overwrite):
        pages.write_reading(folder, found, quantities, command_line())
    say(*lines_of(found.checked.findings), folder / files[0], found.verdict.line())
    raise typer.Exit(EXIT_CODES[found.verdict.kind])
