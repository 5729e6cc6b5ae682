"""``hydro study``: training, evaluation and report."""

from __future__ import annotations

from pathlib import Path

from agents.commands.options import Config, Output, Overwrite, Resume, Rig, Seed, Task, command_line


def study(
    output: Output = Path("results/study"),
    config: Config = None,
    task: Task = None,
    rig: Rig = None,
    seed: Seed = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Train PPO and the leakage head from scratch, compare all controllers, write one report.

    Writes to the output folder: `report.html` (self-contained), `tables/*.csv` (all numbers), the weights, and
    `study.yaml` (the configuration used). `controllers:` in the YAML file lists the participants.

    With `--rig` the task is adapted to another rig: references, sensors and reward follow from its stroke, speed and
    pressure. Gains belong to a rig; the command therefore tunes the classical controllers first.
    """
    from agents.study.run import run_study
    from agents.study.settings import default_study

    settings = default_study(config, task, rig)
    run_study(settings, output, settings.seed if seed is None else seed, resume, overwrite, command_line())
