"""``hydro train``: train one part of a study."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_agents.commands.options import (
    Agents,
    Config,
    Output,
    Overwrite,
    Resume,
    Rig,
    Seed,
    Task,
    named_agents,
    say,
    tell_rigs,
)
from hydro_env import ConfigurationError
from hydro_env.mistakes import did_you_mean

if TYPE_CHECKING:
    from hydro_agents.study.settings import StudySettings


class Objective(StrEnum):
    """The figure that tuning minimises; see :class:`hydro_agents.learning.tuning.Score`."""

    MEAN = "mean"
    EQUAL = "equal"


def train(
    what: Annotated[
        str,
        typer.Argument(
            help="ppo (or another trained controller of the study), head (the leakage head), or a classical controller "
            "(pid, flow_linearising, ...), whose gains are tuned."
        ),
    ],
    output: Output = Path("results/train"),
    config: Config = None,
    agent: Agents = None,
    task: Task = None,
    rig: Rig = None,
    steps: Annotated[int | None, typer.Option(min=1, help="For PPO: control periods, instead of the study's.")] = None,
    objective: Annotated[
        Objective | None,
        typer.Option(
            help="For gains: mean (mean absolute error) or equal (geometric mean over the families; the default)."
        ),
    ] = None,
    evaluations: Annotated[
        int | None, typer.Option(min=1, help="For gains: number of sets of gains to try, instead of 2800.")
    ] = None,
    start: Annotated[
        Path | None, typer.Option(help="For gains: YAML file with the gains where the search starts.")
    ] = None,
    seed: Seed = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Train one part of a study. Ctrl-C keeps the last checkpoint; `--resume` continues from it.

    The command writes the best gains of a classical controller to KIND.yaml after every generation.
    The head learns from episodes under every controller of the study; trained controllers take the shipped weights
    unless `--agent` gives others.

    With `--rig` the task is adapted to another rig. If a trained controller corrects a classical one, the command tunes
    the classical one first.
    """
    from hydro_agents.controllers.registry import CONTROLLERS
    from hydro_agents.study.settings import default_study

    study = default_study(config, task, rig)
    seed = study.seed if seed is None else seed
    part = what.lower()
    classical = part in CONTROLLERS
    _refuse("--steps", steps is not None and (classical or part == "head"), part)
    _refuse("--agent", agent is not None and part != "head", part)
    for option, value in (("--objective", objective), ("--evaluations", evaluations), ("--start", start)):
        _refuse(option, value is not None and not classical, part)
    if part == "head":
        file = _head(study, output, seed, resume, overwrite, named_agents(agent))
    elif classical:
        aim = objective or Objective.EQUAL
        file = _gains(study, part, output, aim, evaluations, start, seed, resume, overwrite)
    else:
        name = next((name for name in study.trained if name.lower() == part), None)
        if name is None:
            known = [*(name.lower() for name in study.trained), "head", *CONTROLLERS]
            guess = did_you_mean(what, known)
            raise ConfigurationError(f"train '{what}': unknown; this study trains: {', '.join(known)}{guess}")
        file = _controller(study, name, output, seed, resume, overwrite, steps)
    say(f"written: {file}")


def _refuse(option: str, given: bool, part: str) -> None:
    if given:
        raise ConfigurationError(f"{option}: does not apply to hydro train {part}")


def _controller(
    study: StudySettings, name: str, folder: Path, seed: int, resume: bool, overwrite: bool, steps: int | None
) -> Path:
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.study.training import (
        CHECKPOINTS,
        TRAINING_FILES,
        TUNING_FILES,
        WEIGHTS,
        train_controller,
        tune_controller,
    )
    from hydro_env.files import validate

    settings = study.training_settings(name)
    if steps is not None:
        settings = validate(type(settings), {**settings.model_dump(), "total_steps": steps}, "--steps")
    corrected = study.controllers[name].corrects
    if corrected in study.trained:
        raise ConfigurationError(f"{name} corrects {corrected}, which must be trained first; run hydro study")
    base = study.make(corrected) if corrected is not None else None
    files = (*TRAINING_FILES, *TUNING_FILES) if corrected in study.tuned else TRAINING_FILES
    if resume and not any(file for kept in (CHECKPOINTS, *TUNING_FILES) for file in folder.glob(kept)):
        raise ConfigurationError(f"{folder}: nothing to resume, there is no checkpoint; leave --resume out")
    with (
        output_folder(folder, f"train {name}", files, resume=resume, overwrite=overwrite),
        ProgressDisplay() as display,
    ):
        if corrected in study.tuned:
            base = tune_controller(study, corrected, folder, seed, display)
            resume = any(folder.glob(CHECKPOINTS))
        train_controller(study, name, folder, seed, resume, base, display, settings)
    return folder / f"{WEIGHTS}.safetensors"


def _head(study: StudySettings, folder: Path, seed: int, resume: bool, overwrite: bool, agents: dict[str, str]) -> Path:
    from hydro_agents.detection.dataset import HeadTrainingSettings
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.study.training import HEAD_CHECKPOINTS, HEAD_FILES, HEAD_WEIGHTS, train_leakage_head

    (study.leakage_head or HeadTrainingSettings()).check(study.task)
    named = study.with_weights(agents)
    controllers = list(named.values())
    tell_rigs(study, named)
    if resume and not any(folder.glob(HEAD_CHECKPOINTS)):
        raise ConfigurationError(f"{folder}: nothing to resume, there is no checkpoint of the head; leave --resume out")
    with (
        output_folder(folder, "train head", HEAD_FILES, resume=resume, overwrite=overwrite),
        ProgressDisplay() as display,
    ):
        train_leakage_head(study, folder, seed, resume, controllers, display)
    return folder / f"{HEAD_WEIGHTS}.safetensors"


def _gains(
    study: StudySettings,
    kind: str,
    folder: Path,
    objective: Objective,
    evaluations: int | None,
    start: Path | None,
    seed: int,
    resume: bool,
    overwrite: bool,
) -> Path:
    from hydro_agents.controllers.registry import CONTROLLERS
    from hydro_agents.learning.tuning import EVALUATIONS
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.study.settings import TuningSettings
    from hydro_agents.study.training import TUNING_LOG, tune_gains
    from hydro_env.files import read_yaml, validate

    budget = TuningSettings(objective=objective.value, evaluations=evaluations or EVALUATIONS)
    path, log = folder / f"{kind}.yaml", folder / TUNING_LOG
    first = validate(CONTROLLERS[kind][1], read_yaml(start), str(start)) if start is not None else None
    if resume and not log.exists():
        raise ConfigurationError(f"{folder}: nothing to resume, there is no {log.name}; leave --resume out")
    with (
        output_folder(folder, f"train {kind}", [path.name, log.name], resume=resume, overwrite=overwrite),
        ProgressDisplay() as display,
    ):
        best = tune_gains(kind, study.task, budget, first, path, log, seed, resume, display, f"tune {kind}")
        display.say(
            f"{kind}: on training cases, cost of command changes included: mean {1e3 * best.score.mean:.4f} mm, "
            f"geometric mean of the families {1e3 * best.score.equal:.4f} mm"
        )
    return path
