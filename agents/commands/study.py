"""``hydro study``: the whole job."""

from __future__ import annotations

from pathlib import Path

from agents.commands.options import Config, Output, Overwrite, Resume, Seed, command_line, default_study


def study(
    output: Output = Path("results/study"),
    config: Config = None,
    seed: Seed = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Train PPO and the leakage head from nothing, evaluate them beside the PID, write one report.

    Leaves in the output folder: `report.html` (self-contained), `tables/*.csv` (every number), the weights, and
    `study.yaml` (the configuration used).
    """
    from agents.study import jobs

    settings = default_study(config)
    seed = settings.seed if seed is None else seed
    jobs.study_to_folder(settings, output, seed, resume, overwrite, command_line())
