"""``hydro train``: train one part of a study."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from agents.commands.options import Config, Output, Overwrite, Resume, Seed, default_study, say


class Trainable(StrEnum):
    """What ``hydro train`` trains."""

    PPO = "ppo"
    HEAD = "head"
    PID = "pid"


def train(
    what: Annotated[
        Trainable, typer.Argument(help="ppo, head (the leakage head) or pid (its gains, by an optimiser).")
    ],
    output: Output = Path("results/train"),
    config: Config = None,
    policy: Annotated[
        Path | None,
        typer.Option(help="For the head: weights of the policy that makes half of the data; default the shipped one."),
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="For PPO: control periods, instead of the study's.")] = None,
    seed: Seed = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Train one part of a study. Ctrl-C keeps the last checkpoint; `--resume` goes on from it."""
    from agents.study import jobs

    settings = default_study(config)
    seed = settings.seed if seed is None else seed
    if what is Trainable.PPO:
        file = jobs.train_policy(settings, output, seed, resume, overwrite, steps)
    elif what is Trainable.HEAD:
        file = jobs.train_leakage_head(settings, output, seed, resume, overwrite, policy)
    else:
        file = jobs.tune_gains(settings, output, seed, overwrite)
    say(f"written: {file}")
