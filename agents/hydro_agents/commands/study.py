"""``hydro study`` and ``hydro train``: whole studies, and one training."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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
    command_line,
    named_agents,
    say,
    side_by_side,
    tell_rigs,
)
from hydro_env import ConfigurationError
from hydro_env.mistakes import did_you_mean

if TYPE_CHECKING:
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.study.settings import StudySettings


@side_by_side
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
    """Train PPO on flow linearisation and the leakage head from scratch, compare all controllers, write one report.

    Writes to the output folder: `report.html` (self-contained), `tables/*.csv` (all numbers), the weights, and
    `study.yaml` (the configuration used). `controllers:` in the YAML file lists the participants.

    With `--seeds 5` the whole study runs five times, with training seeds 0 to 4, each in a folder `seed 0`, `seed 1`,
    … on the same test plants. `tables/over_seeds.csv` then holds every figure by seed, with mean and 95 % interval over
    the seeds, and `learning_curve.svg` the error while learning. `--resume` keeps the studies that are finished.
    With `--config alone` it tells what each choice of a training is worth.

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


@side_by_side
def train(
    what: Annotated[
        str,
        typer.Argument(
            help="ppo (or the name of a trained controller of the study), head (the leakage head), or a classical one "
            "(pid, flow_linearising, ...), whose gains are tuned."
        ),
    ],
    output: Output = Path("results/train"),
    config: Config = None,
    agent: Agents = None,
    task: Task = None,
    rig: Rig = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1, help="For PPO: control periods, instead of the study's. For gains: sets to try, instead of 2800."
        ),
    ] = None,
    objective: Annotated[
        str | None,
        typer.Option(
            metavar="mean|equal",
            help="For gains: mean (mean absolute error) or equal (geometric mean over the families; the default).",
        ),
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
    from hydro_agents.learning.trainers import TRAINERS
    from hydro_agents.study.settings import default_study

    study = default_study(config, task, rig)
    seed = study.seed if seed is None else seed
    part = what.lower()
    classical = part in CONTROLLERS
    _refuse("--steps", steps is not None and part == "head", part)
    _refuse("--agent", agent is not None and part != "head", part)
    for option, value in (("--objective", objective), ("--start", start)):
        _refuse(option, value is not None and not classical, part)
    if part == "head":
        file = _head(study, output, seed, resume, overwrite, named_agents(agent))
    elif classical:
        file = _gains(study, part, output, objective, steps, start, seed, resume, overwrite)
    else:
        kinds = [study.controllers[name].kind for name in study.trained]
        short = {name: kind for name, kind in zip(study.trained, kinds, strict=True) if kinds.count(kind) == 1}
        name = next((name for name in study.trained if part in (name.lower(), short.get(name))), None)
        if name is None:
            known = [short[name] if short.get(name) in TRAINERS else name.lower() for name in study.trained]
            known += ["head", *CONTROLLERS]
            guess = did_you_mean(what, known)
            raise ConfigurationError(f"train '{what}': unknown; this study trains: {', '.join(known)}{guess}")
        file = _controller(study, name, output, seed, resume, overwrite, steps)
    say(f"written: {file}")


def _refuse(option: str, given: bool, part: str) -> None:
    if given:
        raise ConfigurationError(f"{option}: does not apply to hydro train {part}")


@contextmanager
def _training(
    folder: Path, part: str, files: Sequence[str], kept: Sequence[str], resume: bool, overwrite: bool
) -> Iterator[ProgressDisplay]:
    """Claim a folder for a training; without one of the files ``kept`` none can be resumed."""
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder

    if resume and not any(file for pattern in kept for file in folder.glob(pattern)):
        raise ConfigurationError(f"{folder}: nothing to resume, there is no {kept[0].rstrip('*')}; leave --resume out")
    with (
        output_folder(folder, f"train {part}", files, resume=resume, overwrite=overwrite),
        ProgressDisplay() as display,
    ):
        yield display


def _controller(
    study: StudySettings, name: str, folder: Path, seed: int, resume: bool, overwrite: bool, steps: int | None
) -> Path:
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
    one_rig = getattr(settings, "law", None) is None  # gains of one rig serve no policy for any axis
    tuned = corrected if corrected in study.tuned and one_rig else None
    files = (*TRAINING_FILES, *TUNING_FILES) if tuned is not None else TRAINING_FILES
    kept = (CHECKPOINTS, *TUNING_FILES)
    with _training(folder, name, files, kept, resume, overwrite) as display:
        if tuned is not None:
            base = tune_controller(study, tuned, folder, seed, display)
        train_controller(study, name, folder, seed, base, display, settings)
    return folder / f"{WEIGHTS}.safetensors"


def _head(study: StudySettings, folder: Path, seed: int, resume: bool, overwrite: bool, agents: dict[str, str]) -> Path:
    from hydro_agents.detection.training_settings import HeadTrainingSettings
    from hydro_agents.running.jobs import JOBS_FOLDER
    from hydro_agents.study.training import HEAD_CHECKPOINTS, HEAD_FILES, HEAD_WEIGHTS, train_leakage_head

    settings = study.leakage_head or HeadTrainingSettings()
    settings.check(study.task)
    named = study.with_weights(agents) if settings.law is None else {}
    tell_rigs(study, named)
    with _training(folder, "head", HEAD_FILES, [HEAD_CHECKPOINTS], resume, overwrite) as display:
        train_leakage_head(study, folder, seed, list(named.values()), display)
        shutil.rmtree(folder / JOBS_FOLDER, ignore_errors=True)
    return folder / f"{HEAD_WEIGHTS}.safetensors"


def _gains(
    study: StudySettings,
    kind: str,
    folder: Path,
    objective: str | None,
    steps: int | None,
    start: Path | None,
    seed: int,
    resume: bool,
    overwrite: bool,
) -> Path:
    from hydro_agents.controllers.registry import CONTROLLERS
    from hydro_agents.learning.tuning import EVALUATIONS
    from hydro_agents.study.entries import TuningSettings
    from hydro_agents.study.training import TUNING_LOG, tune_gains
    from hydro_env.files import read_yaml, validate

    sizes = {"objective": "equal" if objective is None else objective, "evaluations": steps or EVALUATIONS}
    budget = validate(TuningSettings, sizes, "train")
    path = folder / f"{kind}.yaml"
    first = validate(CONTROLLERS[kind][1], read_yaml(start), str(start)) if start is not None else None
    with _training(folder, kind, [path.name, TUNING_LOG], [TUNING_LOG], resume, overwrite) as display:
        best = tune_gains(kind, study.task, budget, first, path, seed, display, kind)
        display.say(
            f"{kind}: on training cases, cost of command changes included: mean {1e3 * best.cost.mean:.4f} mm, "
            f"geometric mean of the families {1e3 * best.cost.equal:.4f} mm"
        )
    return path
