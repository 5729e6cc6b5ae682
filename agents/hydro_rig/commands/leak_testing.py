"""``hydro leak-test``: plan a test that shows a leak, and read its recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Columns, Json, Overwrite, OwnTask, Rig, command_line, say
from hydro_rig.commands.guesses import reading

_PLAN = "Limits of the plan"


def leak_test(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="[RECORDING]", help="Recording of the test, to be read. Without it the test is planned."
        ),
    ] = None,
    rig: Rig = None,
    task: OwnTask = None,
    columns: Columns = None,
    limit: Annotated[
        float | None,
        typer.Option(
            min=1e-6, max=100.0, help="Leak in l/min at 100 bar from which the seal is faulty; default: the task's."
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(help="s; default: 60.", rich_help_panel=_PLAN)] = None,
    speed: Annotated[
        float | None,
        typer.Option(help="Largest speed in mm/s, also against a stop; default: 50.", rich_help_panel=_PLAN),
    ] = None,
    opening: Annotated[
        float | None, typer.Option(help="Largest opening of the valve in %; default: 30.", rich_help_panel=_PLAN)
    ] = None,
    pressure: Annotated[
        float | None, typer.Option(help="Largest pressure in bar; default: the rating.", rich_help_panel=_PLAN)
    ] = None,
    stop: Annotated[
        str,
        typer.Option(metavar="both|extended|retracted", help="Stops to press against.", rich_help_panel=_PLAN),
    ] = "both",
    between: Annotated[
        str | None,
        typer.Option(metavar="LOW..HIGH", help="Allowed positions in mm from mid-stroke.", rich_help_panel=_PLAN),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder; default: results/leak_test_plan, or results/leak_test."),
    ] = None,
    as_json: Json = False,
    overwrite: Overwrite = False,
) -> None:
    """Plan an active test of a minute that shows a leak past the piston; or, with RECORDING, read it.

    The test presses the axis against its stops at several openings, closes the valve, and makes short moves. The plan
    is the one with the lowest Cramér–Rao bound that stays within your limits on simulated axes. Written are a page
    (`plan.html`), the commands (`commands.csv`) and a simulated recording. The reading gives litres per
    minute with an interval, the leak of the seal apart from that of the valve's edges, as `leak_test.html` and JSON.
    Exit codes of the reading: 0 healthy, 10 internal leak, 11 something else, 12 cannot tell.
    """
    from hydro_agents.running.folders import refuse_taken
    from hydro_env import ConfigurationError
    from hydro_env.task.configuration import task_config
    from hydro_rig.diagnosis import leak_test_page as pages
    from hydro_rig.diagnosis.leak_test_plan import plan
    from hydro_rig.diagnosis.leak_test_reading import read_leak_test
    from hydro_rig.diagnosis.leak_test_steps import LeakTestSettings
    from hydro_rig.diagnosis.verdict import EXIT_CODES
    from hydro_rig.recordings.columns import read_map

    config = task_config(task, rig=rig)
    low, high = _ends(between)
    limits = {
        "duration": (duration, 1.0),
        "speed": (speed, 1e-3),
        "opening": (opening, 1e-2),
        "pressure": (pressure, 1e5),
        "low": (low, 1e-3),
        "high": (high, 1e-3),
    }
    given = {name: factor * value for name, (value, factor) in limits.items() if value is not None}
    if recording is None:
        folder = output or Path("results/leak_test_plan")
        refuse_taken(folder, pages.JOB, pages.PLAN_FILES, overwrite)
        settings = LeakTestSettings.of(config, **given, stop=stop)
        with reading(as_json) as progress:
            planned = plan(config, settings, progress)
        lines = pages.plan_to_folder(folder, planned, overwrite, command_line())
        say(json.dumps(pages.plan_facts(planned), indent=1) if as_json else "\n".join(lines))
        return
    if given or stop != "both":
        option = next(iter(given), "stop") if between is None else "between"
        raise ConfigurationError(f"--{option}: belongs to the plan; leave out RECORDING, or the option")
    folder = output or Path("results/leak_test")
    refuse_taken(folder, pages.JOB, pages.READING_FILES, overwrite)
    mapped = read_map(columns) if columns is not None else None
    with reading(as_json) as progress:
        found = read_leak_test(recording, config, mapped, limit, progress)
    lines = pages.reading_to_folder(folder, found, overwrite, command_line())
    say(json.dumps(pages.reading_facts(found), indent=1) if as_json else "\n".join(lines))
    raise typer.Exit(EXIT_CODES[found.verdict.kind])


def _ends(between: str | None) -> tuple[float | None, float | None]:
    """Both ends of ``LOW..HIGH``; ``None``: not given."""
    from hydro_env import ConfigurationError

    low, _, high = (between or "..").partition("..")
    try:
        return float(low) if low else None, float(high) if high else None
    except ValueError:
        raise ConfigurationError(f"--between {between}: must be positions in mm as -60..60") from None
