"""``hydro study``: training, evaluation and report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Config, Overwrite, Resume, Rig, Seed, Task, command_line, say


def study(
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for the results; default: results/study, results/seeds."),
    ] = None,
    config: Config = None,
    task: Task = None,
    rig: Rig = None,
    seed: Seed = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=2, max=1000, help="Number of studies with one training seed each, and one table over them."),
    ] = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Train PPO and the leakage head from scratch, compare all controllers, write one report.

    Writes to the output folder: `report.html` (self-contained), `tables/*.csv` (all numbers), the weights, and
    `study.yaml` (the configuration used). `controllers:` in the YAML file lists the participants.

    With `--seeds 5` the whole study runs five times, with training seeds 0 to 4, each in a folder `seed 0`, `seed 1`,
    … on the same test plants. `tables/over_seeds.csv` then holds every figure by seed, with mean and 95 % interval over
    the seeds, and `learning_curve.svg` the error while learning. `--resume` keeps the studies that are finished.

    With `--rig` the task is adapted to another rig: references, sensors and reward follow from its stroke, speed and
    pressure. Gains belong to a rig; the command therefore tunes the classical controllers first.
    """
    from hydro_agents.study.over_seeds import run_over_seeds
    from hydro_agents.study.run import run_study
    from hydro_agents.study.settings import default_study

    settings = default_study(config, task, rig)
    first = settings.seed if seed is None else seed
    if seeds is None:
        run_study(settings, output or Path("results/study"), first, resume, overwrite, command_line())
        return
    folder = output or Path("results/seeds")
    say(f"written: {run_over_seeds(settings, folder, range(first, first + seeds), resume, overwrite, command_line())}")
