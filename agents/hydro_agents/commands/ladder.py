"""``hydro ladder``: trainings that each differ in one setting, on several seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Output, Overwrite, Resume, say


def ladder(
    config: Annotated[
        Path | None,
        typer.Option(
            "--config", "-c", metavar="NAME|FILE", help="A ladder: a name in `configs/ladders` or a YAML file."
        ),
    ] = None,
    output: Output = Path("results/ladder"),
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, max=1024, help="Trainings that run side by side.")] = 1,
    rung: Annotated[
        list[str] | None, typer.Option("--rung", help="Train this rung alone; repeat the option for several.")
    ] = None,
    seeds: Annotated[int | None, typer.Option(min=1, max=1000, help="Trainings per rung.")] = None,
    test: Annotated[
        bool, typer.Option("--test", help="Evaluate on test plants; use it only after every choice is made.")
    ] = False,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Train every rung of a ladder on several seeds, and write one table of the effect of each change.

    A ladder is a list of trainings, its rungs; each rung changes a few settings of an earlier one. The trainings are
    independent jobs. Ctrl-C keeps finished trainings and checkpoints; `--resume` continues.
    """
    from hydro_agents.study.ladder import LadderSettings, run_ladder
    from hydro_env.folders import config_file

    settings = LadderSettings.from_yaml(config_file("ladders", config or "default"))
    file = run_ladder(settings, output, jobs, rung, seeds, test, resume, overwrite)
    say(file.read_text(encoding="utf-8"), f"written: {file}")
