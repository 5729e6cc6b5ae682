"""``hydro study`` and ``hydro train``: whole studies, and one training."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hydro_agents.commands.options import (
    Agents,
    Config,
    Jobs,
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
    from hydro_agents.evaluation.runner import Results
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.study.settings import StudySettings

    Claim = Callable[[str, Sequence[str], Sequence[str]], AbstractContextManager[ProgressDisplay]]
    """Claims the folder of a training: its part, the files that it writes, and those from which it can resume."""


def study(
    output: Output = Path("results/study"),
    config: Config = None,
    task: Task = None,
    rig: Rig = None,
    seed: Seed = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help="Number of training seeds of each learned controller; default: one."),
    ] = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    jobs: Jobs = None,
) -> None:
    """Train PPO on flow linearisation from scratch, compare all controllers, write one report.

    Writes to the output folder: `report.html` (self-contained), `tables/*.csv` (all numbers), the weights, and
    `study.yaml` (the configuration used). `controllers:` in the YAML file lists the participants.

    With `--seeds 5` each learned controller is trained with five seeds, as `NAME#0`, `NAME#1`, …: they share its rows,
    whose intervals include the seeds, and `tables/seeds.csv` holds each of them.

    With `--rig` the task is adapted to another rig: references, sensors and reward follow from its stroke, speed and
    pressure. Gains belong to a rig; the command therefore tunes the classical controllers first.
    """
    from hydro_agents.running.jobs import workers
    from hydro_agents.study.settings import default_study

    settings = default_study(config, task, rig)
    first = settings.seed if seed is None else seed
    with workers(jobs):
        whole_study(settings, output, range(first, first + (seeds or 1)), resume, overwrite)


def whole_study(
    study: StudySettings, folder: Path, seeds: range, resume: bool = False, overwrite: bool = False
) -> Results:
    """Run a study in its folder, and write its tables and its page; ``resume`` skips the phases that are finished.

    Raises:
        ConfigurationError: settings contradict each other, the folder cannot be used, its results have other settings,
            or a controller failed (the results of the others are written first).
        KeyboardInterrupt: Ctrl-C; the finished work remains and the study can be resumed.
    """
    from hydro_agents.commands.controller_pages import study_page
    from hydro_agents.commands.protocols import facts_of
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.jobs import JOBS_FOLDER
    from hydro_agents.study.run import CONFIG_FILE, claimed, run_study

    study.check()
    with claimed(study, folder, seeds, study_page("").files, resume, overwrite), ProgressDisplay() as display:
        results = run_study(study, folder, seeds, display, facts_of(seed=str(seeds[0])))
        page = study_page((folder / CONFIG_FILE).read_text(encoding="utf-8"))
        page.write(results, folder, display)
        shutil.rmtree(folder / JOBS_FOLDER, ignore_errors=True)
    page.tell(results, folder, display)
    return results


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
    seed: Seed = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    jobs: Jobs = None,
) -> None:
    """Train one part of a study. Ctrl-C keeps the last checkpoint; `--resume` continues from it.

    The command writes the best gains of a classical controller to KIND.yaml after every generation.
    The head learns from episodes under every controller of the study; trained controllers take the shipped weights
    unless `--agent` gives others.

    With `--rig` the task is adapted to another rig. If a trained controller corrects a classical one, the command tunes
    the classical one first.
    """
    from hydro_agents.controllers.registry import CONTROLLERS
    from hydro_agents.running.jobs import workers
    from hydro_agents.study.settings import default_study

    study = default_study(config, task, rig)
    seed = study.seed if seed is None else seed
    part = what.lower()
    if steps is not None and part == "head":
        raise ConfigurationError("--steps: does not apply to hydro train head")
    if agent is not None and part != "head":
        raise ConfigurationError(f"--agent: does not apply to hydro train {part}")
    with workers(jobs):
        claim = partial(_claimed, output, resume=resume, overwrite=overwrite)
        if part == "head":
            file = _head(study, output, seed, named_agents(agent), claim)
        elif part in CONTROLLERS:
            file = _gains(_of_gains(study, part, steps), part, output, seed, claim)
        else:
            file = _controller(*_named(study, what, steps), output, seed, claim)
    say(f"written: {output / file}")


@contextmanager
def _claimed(
    folder: Path, part: str, files: Sequence[str], kept: Sequence[str], resume: bool, overwrite: bool
) -> Iterator[ProgressDisplay]:
    """The folder of a training for its files; without one of those ``kept`` none can be resumed."""
    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.running.jobs import JOBS_FOLDER

    if resume and not any(file for pattern in kept for file in folder.glob(pattern)):
        raise ConfigurationError(f"{folder}: nothing to resume; leave --resume out")
    claimed = output_folder(folder, f"train {part}", files, resume=resume, overwrite=overwrite)
    with claimed, ProgressDisplay() as display:
        yield display
        shutil.rmtree(folder / JOBS_FOLDER, ignore_errors=True)


def _named(study: StudySettings, what: str, steps: int | None) -> tuple[StudySettings, str]:
    """The study with another length of a training, and the trained controller by its name or, if it is alone, kind."""
    from hydro_agents.controllers.registry import CONTROLLERS
    from hydro_agents.learning.trainers import TRAINERS

    kinds = [study.controllers[name].kind for name in study.trained]
    known = []
    for name, kind in zip(study.trained, kinds, strict=True):
        alone = kinds.count(kind) == 1
        if what.lower() == name.lower() or (alone and what.lower() == kind):
            return study if steps is None else _with_steps(study, name, steps), name
        known.append(kind if alone and kind in TRAINERS else name.lower())
    known += ["head", *CONTROLLERS]
    raise ConfigurationError(
        f"train '{what}': unknown; this study trains: {', '.join(known)}{did_you_mean(what, known)}"
    )


def _with_steps(study: StudySettings, name: str, steps: int) -> StudySettings:
    """The study with another length of a training."""
    from hydro_env.files import validate

    entry = study.controllers[name]
    settings = validate(type(entry.settings), {**entry.settings.model_dump(), "total_steps": steps}, "--steps")
    return study.model_copy(update={"controllers": study.controllers | {name: entry.changed(settings=settings)}})


def _of_gains(study: StudySettings, kind: str, steps: int | None) -> StudySettings:
    """A study that tunes one classical controller for the task of another one; each family has the same weight."""
    from hydro_agents.learning.tuning import EVALUATIONS
    from hydro_agents.study.settings import StudySettings as Study
    from hydro_env.files import validate

    entry = {"kind": kind, "tune": {"evaluations": steps or EVALUATIONS}}
    return validate(Study, {"task": study.task, "controllers": {kind: entry}}, "train")


def _controller(study: StudySettings, name: str, folder: Path, seed: int, claim: Claim) -> str:
    """Train a controller; gains of the rig for the one that it corrects are tuned first."""
    from hydro_agents.controllers.registry import GAINS_FILE
    from hydro_agents.running.jobs import RESULT_FILES
    from hydro_agents.study.training import CHECKPOINTS, TRAINING_FILES, WEIGHTS, train_controller, tune_controller

    entry = study.controllers[name]
    if entry.corrects in study.trained:
        raise ConfigurationError(f"{name} corrects {entry.corrects}, which must be trained first; run hydro study")
    base = None if entry.corrects is None else study.make(entry.corrects)
    one_rig = getattr(entry.settings, "law", None) is None  # gains of one rig serve no policy for any axis
    tuned = one_rig and entry.corrects in study.tuned
    files = (*TRAINING_FILES, GAINS_FILE, RESULT_FILES) if tuned else TRAINING_FILES
    with claim(name, files, (CHECKPOINTS, RESULT_FILES)) as display:
        if entry.corrects is not None and tuned:
            base = tune_controller(study, entry.corrects, folder / GAINS_FILE, folder, seed, display)
        train_controller(study, name, folder, seed, base, display)
    return f"{WEIGHTS}.safetensors"


def _head(study: StudySettings, folder: Path, seed: int, agents: dict[str, str], claim: Claim) -> str:
    from hydro_agents.running.jobs import RESULT_FILES
    from hydro_agents.study.training import HEAD_WEIGHTS, train_leakage_head

    study.leakage_head.check(study.task)
    named = study.with_weights(agents) if study.leakage_head.law is None else {}
    tell_rigs(study, named)
    with claim("head", [f"{HEAD_WEIGHTS}.*", RESULT_FILES], [RESULT_FILES]) as display:
        train_leakage_head(study, folder, seed, list(named.values()), display)
    return f"{HEAD_WEIGHTS}.safetensors"


def _gains(study: StudySettings, kind: str, folder: Path, seed: int, claim: Claim) -> str:
    from hydro_agents.running.jobs import RESULT_FILES
    from hydro_agents.study.training import tune_controller

    file = f"{kind}.yaml"
    with claim(kind, [file, RESULT_FILES], [RESULT_FILES]) as display:
        tune_controller(study, kind, folder / file, folder, seed, display)
    return file
