"""Tunes and trains the controllers and trains the leakage head of a study, with progress on the console."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, GAINS_FILE, gains_text, make_controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.head_training import train_head
from hydro_agents.detection.training_settings import HeadTrainingSettings
from hydro_agents.learning.progress import PROGRESS_FILE, Progress, read_progress
from hydro_agents.learning.stable_gain import stable_start
from hydro_agents.learning.tuning import Search, Tuned, tune
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.jobs import RESULT_FILES
from hydro_agents.running.limit_cycles import comes_to_rest, counted_at_rest, rest_text
from hydro_agents.running.seeds import STANDSTILLS
from hydro_agents.study.entries import TuningSettings
from hydro_agents.study.settings import StudySettings
from hydro_env import TaskConfig
from hydro_env.files import Group, validate, write_text

WEIGHTS = "policy"
HEAD_WEIGHTS = "leakage_head"
CHECKPOINTS = "checkpoint*"
HEAD_CHECKPOINTS = "head_checkpoint*"
TRAINING_FILES = (f"{WEIGHTS}.*", CHECKPOINTS, PROGRESS_FILE, "events.out.tfevents.*")
"""Files that the training of a controller writes; the names of checkpoints begin with ``checkpoint``."""

TUNING_LOG = "tuning.csv"
TUNING_FILES = (GAINS_FILE, TUNING_LOG)  # files that the tuning of a controller writes
STANDSTILL_CASES = 16  # at which the tuned gains are searched for limit cycles
HEAD_FILES = (f"{HEAD_WEIGHTS}.*", HEAD_CHECKPOINTS, RESULT_FILES)


def train_controller(
    study: StudySettings,
    name: str,
    folder: Path,
    seed: int,
    base: Controller | None,
    display: ProgressDisplay,
    settings: Group | None = None,
) -> Controller:
    """Train one controller of a study, from the checkpoint in the folder on; write weights, checkpoints and log there.

    Args:
        study: the study.
        name: name of the controller.
        folder: for its files.
        seed: seed of all random numbers.
        base: the controller that it corrects.
        display: shows the progress.
        settings: settings of the training, instead of the study's.

    Raises:
        ConfigurationError: the settings are impossible, or the checkpoint is damaged or of other settings.
        KeyboardInterrupt: Ctrl-C; the trainer has written a checkpoint.
    """
    settings = settings if settings is not None else study.training_settings(name)
    trainer = study.controllers[name].trainer
    assert trainer is not None
    resume = any(folder.glob(CHECKPOINTS))
    last = [0.0, 0.0]

    def report(progress: Progress) -> None:
        passed, steps = progress.seconds - last[0], progress.steps - last[1]
        rate = f"{steps / passed:,.0f} steps/s" if passed > 0 and last[1] else ""
        last[:] = progress.seconds, progress.steps
        reward = "" if math.isnan(progress.mean_reward) else f"mean reward {progress.mean_reward:.4f}"
        note = ", ".join(part for part in (rate, reward) if part)
        display.update(f"train {name}", min(progress.steps, progress.total_steps), progress.total_steps, note)

    if not resume:
        display.update(f"train {name}", 0, getattr(settings, "total_steps", 0))
    controller = trainer.train(
        study.task, settings, seed=seed, folder=folder, resume=resume, base=base, progress=report
    )
    controller.save(folder / WEIGHTS)
    return controller


def tune_controller(study: StudySettings, name: str, folder: Path, seed: int, display: ProgressDisplay) -> Controller:
    """Tune one classical controller of a study, and write its gains into the folder; continues after an interruption.

    Args:
        study: the study.
        name: name of a controller with ``tune``.
        folder: for gains and log.
        seed: seed of the search.
        display: shows the progress.

    Raises:
        ConfigurationError: a log of other settings, or no candidate can control the axis.
        KeyboardInterrupt: Ctrl-C; the log keeps the finished generations.
    """
    entry = study.controllers[name]
    assert entry.tune is not None
    given = validate(CONTROLLERS[entry.kind][1], entry.settings, f"controllers.{name}")
    start = stable_start(study.task, given)
    if getattr(start, "proportional", None) != getattr(given, "proportional", None):
        display.say(f"{name}: its gains are unstable on this rig; the search starts from the figures of the rig")
    tuned = tune_gains(entry.kind, study.task, entry.tune, start, folder / GAINS_FILE, seed, display, name)
    return make_controller(entry.kind, study.task, tuned.gains.model_dump())


def tune_gains(
    kind: str,
    task: TaskConfig,
    budget: TuningSettings,
    start: Group | None,
    file: Path,
    seed: int,
    display: ProgressDisplay,
    name: str,
) -> Tuned:
    """Tune gains with progress on the console; the best gains so far are written after every generation.

    The costs of every candidate stand in ``tuning.csv`` beside the gains; a search continues from an earlier one there.
    The file of the final gains says in a comment whether an axis under them comes to rest without sensor noise.

    Args:
        kind: of the controller.
        task: the task.
        budget: objective, number of candidates and of training cases.
        start: gains where the search starts; default: those of their class.
        file: for the gains.
        seed: seed of the search.
        display: shows the progress.
        name: of the controller on the console.

    Raises:
        ConfigurationError: a log of other settings, or no candidate can control the axis.
        KeyboardInterrupt: Ctrl-C; the log keeps the finished generations.
    """
    phase, log = f"tune {name}", file.with_name(TUNING_LOG)

    def report(best: Tuned) -> None:
        note = f"mean {1e3 * best.cost.mean:.4f} mm, equal weights {1e3 * best.cost.equal:.4f} mm"
        display.update(phase, min(best.evaluations, budget.evaluations), budget.evaluations, note)
        write_text(file, gains_text(best.gains))

    display.update(phase, 0, budget.evaluations)
    search = Search(budget.objective, budget.evaluations, seed, budget.cases, start)
    tuned = tune(kind, task, search, log, resume=log.exists(), progress=report)
    made = make_controller(kind, task, tuned.gains.model_dump())
    found = counted_at_rest(made, task, STANDSTILLS, STANDSTILL_CASES)
    note = f"{rest_text(found)} (drawn plants and leaks, without sensor noise)"
    write_text(file, gains_text(tuned.gains, note[0].upper() + note[1:]))
    if not comes_to_rest(found):
        display.say(f"{kind}, tuned: {note}")
    return tuned


def read_curve(folder: Path) -> pd.DataFrame:
    """The log of a training; empty if there is none. Columns: see :mod:`hydro_agents.learning.progress`."""
    file = folder / PROGRESS_FILE
    return pd.DataFrame(read_progress(file) if file.exists() else [])


def train_leakage_head(
    study: StudySettings,
    folder: Path,
    seed: int,
    controllers: Sequence[Controller],
    display: ProgressDisplay,
) -> LeakageHead:
    """Train the leakage head on episodes under each controller, from the checkpoint in the folder on; write it there.

    Raises:
        ConfigurationError: the settings are impossible, or the rig lacks a sensor that the head reads.
    """
    settings = study.leakage_head or HeadTrainingSettings()
    settings.check(study.task)
    resume = any(folder.glob(HEAD_CHECKPOINTS))

    def report(phase: str, done: int, total: int, loss: float) -> None:
        display.update(f"leakage head, {phase}", done, total, "" if math.isnan(loss) else f"loss {loss:.4f}")

    head = train_head(study.task, controllers, settings, seed, report, folder=folder, resume=resume)
    head.save(folder / HEAD_WEIGHTS)
    return head
