"""``hydro study``: training, evaluation and report."""

from __future__ import annotations

from pathlib import Path

from agents.commands.options import Config, Output, Overwrite, Resume, Seed, command_line


def study(
    output: Output = Path("results/study"),
    config: Config = None,
    seed: Seed = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Train PPO and the leakage head from scratch, compare them with the PID, write one report.

    Writes to the output folder: `report.html` (self-contained), `tables/*.csv` (all numbers), the weights, and
    `study.yaml` (the configuration used). `controllers:` in the YAML file lists the participants.
    """
    from agents.study.run import run_study
    from agents.study.settings import default_study

    settings = default_study(config)
    run_study(settings, output, settings.seed if seed is None else seed, resume, overwrite, command_line())
