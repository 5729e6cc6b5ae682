"""``hydro evaluate``: judge controllers and the leakage head on test plants."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agents.commands.options import Config, Output, Overwrite, command_line, default_study
from hydro_env.files import validate


def evaluate(
    output: Output = Path("results/evaluate"),
    config: Config = None,
    policy: Annotated[Path | None, typer.Option(help="Weights of a policy; default the shipped one.")] = None,
    head: Annotated[Path | None, typer.Option(help="Weights of a leakage head; default the shipped one.")] = None,
    plants: Annotated[
        int | None, typer.Option(min=3, max=10_000, help="Plants per leak level and reference family.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Judge PID, policy and leakage head on test plants: the same plants, references and noise for each.

    Writes CSV tables with every number and a report, and prints the main figures.
    """
    from agents.study import jobs

    settings = default_study(config)
    if plants is not None:
        changed = {**settings.model_dump(), "evaluation": {**settings.evaluation.model_dump(), "plants": plants}}
        settings = validate(type(settings), changed, "--plants")
    jobs.evaluate_to_folder(settings, output, policy, head, overwrite, command_line())
