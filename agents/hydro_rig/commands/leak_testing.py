"""``hydro leak-test``: plan a test that shows a leak, and read its recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from hydro_agents.commands.options import Columns, Overwrite, OwnTask, Rig, command_line, say


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
    from hydro_env.task.configuration import task_config
    from hydro_rig.diagnosis import leak_test_page as pages
    from hydro_rig.diagnosis.leak_test_plan import plan
    from hydro_rig.diagnosis.leak_test_reading import read_leak_test
    from hydro_rig.diagnosis.verdict import EXIT_CODES
    from hydro_rig.estimation.progress import shown
    from hydro_rig.recordings.columns import read_map
    from hydro_rig.recordings.findings import lines_of

    config = task_config(task, rig=rig)
    if recording is None:
        folder = output or Path("results/leak_test_plan")
        refuse_taken(folder, pages.JOB, pages.PLAN_FILES, overwrite)
        planned = plan(config, duration, speed and 1e-3 * speed, stop)
        with output_folder(folder, pages.JOB, pages.PLAN_FILES, overwrite=overwrite):
            pages.write_plan(folder, planned, command_line())
        say(*(folder / name for name in pages.PLAN_FILES), planned.line())
        return
    folder = output or Path("results/leak_test")
    refuse_taken(folder, pages.JOB, pages.READING_FILES, overwrite)
    mapped = read_map(columns) if columns is not None else None
    with shown():
        found, quantities = read_leak_test(recording, config, mapped)
    with output_folder(folder, pages.JOB, pages.READING_FILES, overwrite=overwrite):
        pages.write_reading(folder, found, quantities, command_line())
    say(*lines_of(found.checked.findings), folder / pages.READING_FILES[0], found.verdict.line())
    raise typer.Exit(EXIT_CODES[found.verdict.kind])
