"""``hydro study`` and ``hydro train``: whole studies, and one training."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

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
    refuse_given,
    say,
    tell_rigs,
    working_in,
)
from hydro_env import ConfigurationError
from hydro_env.files import validate
from hydro_env.mistakes import did_you_mean

if TYPE_CHECKING:
    from hydro_agents.controllers.base import Controller
    from hydro_agents.evaluation.runner import Results
    from hydro_agents.evaluation.study import StudySettings
    from hydro_agents.running.console import ProgressDisplay

HEAD_WEIGHTS = "leakage_head"


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
    from hydro_agents.evaluation.study import default_study
    from hydro_agents.running.jobs import workers

    settings = default_study(config, task, rig)
    first = settings.seed if seed is None else seed
    with workers(jobs):
        whole_study(settings, output, range(first, first + (seeds or 1)), resume, overwrite)


def whole_study(
    study: "StudySettings", folder: Path, seeds: range, resume: bool = False, overwrite: bool = False
) -> "Results":
    """Run a study in its folder, and write its tables and its page; ``resume`` skips the phases that are finished.

    Raises:
        ConfigurationError: settings contradict each other, the folder cannot be used, its results have other settings,
            or a controller failed (the results of the others are written first).
        KeyboardInterrupt: Ctrl-C; the finished work remains and the study can be resumed.
    """
    from hydro_agents.commands.pages import study_page
    from hydro_agents.commands.protocols import facts_of
    from hydro_agents.evaluation.study_run import CONFIG_FILE, files_of, run_study
    from hydro_agents.running.jobs import JOBS_FOLDER

    study.check()
    writes = [*files_of(study, seeds), *study_page("").files]
    with working_in(folder, "study", writes, resume, overwrite) as display:
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
    from hydro_agents.evaluation.study import default_study
    from hydro_agents.evaluation.study_run import CHECKPOINTS
    from hydro_agents.running.jobs import JOBS_FOLDER, RESULT_FILES, workers

    study = default_study(config, task, rig)
    name = what.lower()
    unused = {"--steps": steps} if name == "head" else {"--agent": agent}
    refuse_given(unused, f"does not apply to hydro train {name}")
    with workers(jobs):
        if name == "head":
            part = _head(study, named_agents(agent))
        elif name in CONTROLLERS:
            part = _gains(study, name, steps)
        else:
            part = _controller(study, what, steps)
        if resume and not any(file for pattern in (CHECKPOINTS, RESULT_FILES) for file in output.glob(pattern)):
            raise ConfigurationError(f"{output}: nothing to resume; leave --resume out")
        with working_in(output, f"train {part.name}", part.files, resume, overwrite) as display:
            part.work(output, study.seed if seed is None else seed, display)
            shutil.rmtree(output / JOBS_FOLDER, ignore_errors=True)
    say(f"written: {output / part.written}")


class _Part(NamedTuple):
    """A part of a study that is trained alone."""

    name: str
    written: str  # its result
    files: Sequence[str]  # that it may write
    work: "Callable[[Path, int, ProgressDisplay], object]"  # in a folder, with a seed


def _controller(study: "StudySettings", what: str, steps: int | None) -> _Part:
    """The training of a controller; gains of the rig for the one that it corrects are tuned first."""
    from hydro_agents.controllers.registry import GAINS_FILE
    from hydro_agents.evaluation.study_run import TRAINING_FILES, WEIGHTS, train_controller, tune_controller

    name = _trained(study, what)
    entry = study.controllers[name]
    if steps:
        longer = validate(type(entry.settings), {**entry.settings.model_dump(), "total_steps": steps}, "--steps")
        entry = entry.changed(settings=longer)
        study = study.changed(controllers=study.controllers | {name: entry})
    corrected = entry.corrects
    if corrected in study.trained:
        raise ConfigurationError(f"{name} corrects {corrected}, which must be trained first; run hydro study")
    one_rig = not getattr(entry.settings, "law", None)  # gains of one rig serve no policy for any axis

    def work(folder: Path, seed: int, display: "ProgressDisplay") -> None:
        base: Controller | None = None
        if corrected in study.tuned and one_rig:
            base = tune_controller(study, corrected, folder / GAINS_FILE, folder, seed, display)
        elif corrected:
            base = study.make(corrected)
        train_controller(study, name, folder, seed, base, display)

    return _Part(name, f"{WEIGHTS}.safetensors", (*TRAINING_FILES, GAINS_FILE), work)


def _trained(study: "StudySettings", what: str) -> str:
    from hydro_agents.controllers.registry import CONTROLLERS
    from hydro_agents.learning.trainers import TRAINERS

    kinds = [study.controllers[name].kind for name in study.trained]
    known = []
    for name, kind in zip(study.trained, kinds, strict=True):
        alone = kinds.count(kind) == 1
        if what.lower() == name.lower() or (alone and what.lower() == kind):
            return name
        known.append(kind if alone and kind in TRAINERS else name.lower())
    known += ["head", *CONTROLLERS]
    guess = did_you_mean(what, known)
    raise ConfigurationError(f"train '{what}': unknown; this study trains: {', '.join(known)}{guess}")


def _gains(study: "StudySettings", kind: str, steps: int | None) -> _Part:
    """The tuning of one classical controller for the task of a study; each family has the same weight."""
    from hydro_agents.evaluation.study import StudySettings
    from hydro_agents.evaluation.study_run import tune_controller
    from hydro_agents.learning.tuning import EVALUATIONS

    entry = {"kind": kind, "tune": {"evaluations": steps or EVALUATIONS}}
    alone, file = validate(StudySettings, {"task": study.task, "controllers": {kind: entry}}, "train"), f"{kind}.yaml"

    def work(folder: Path, seed: int, display: "ProgressDisplay") -> None:
        tune_controller(alone, kind, folder / file, folder, seed, display)

    return _Part(kind, file, (file,), work)


def _head(study: "StudySettings", agents: dict[str, str]) -> _Part:
    study.leakage_head.check(study.task)
    named = {} if study.leakage_head.law else study.with_weights(agents)
    tell_rigs(study, named)

    def work(folder: Path, seed: int, display: "ProgressDisplay") -> None:
        from hydro_agents.detection.head_training import train_head  # loads torch

        def report(phase: str, *done: Any) -> None:
            display.update(f"leakage head, {phase}", *done)

        head = train_head(study.task, list(named.values()), study.leakage_head, seed, report, folder)
        head.save(folder / HEAD_WEIGHTS)

    return _Part("head", f"{HEAD_WEIGHTS}.safetensors", (f"{HEAD_WEIGHTS}.*",), work)
