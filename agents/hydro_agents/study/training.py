"""Tunes and trains the controllers and trains the leakage head of a study, with progress on the console."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import gains_text, make_controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.learning.progress import PROGRESS_FILE, Progress
from hydro_agents.learning.stable_gain import stable_start
from hydro_agents.learning.tuning import Search, Tuned, tune
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.limit_cycles import comes_to_rest, counted_at_rest, rest_text
from hydro_agents.running.seeds import SEED_MARK, STANDSTILLS
from hydro_agents.study.settings import StudySettings
from hydro_env.files import write_text

WEIGHTS = "policy"
HEAD_WEIGHTS = "leakage_head"
CHECKPOINTS = "checkpoint*"
TRAINING_FILES = (f"{WEIGHTS}.*", CHECKPOINTS, PROGRESS_FILE, "events.out.tfevents.*")
"""Files that the training of a controller writes; the names of checkpoints begin with ``checkpoint``."""

STANDSTILL_CASES = 16  # at which the tuned gains are searched for limit cycles


def train_controller(
    study: StudySettings, label: str, folder: Path, seed: int, base: Controller | None, display: ProgressDisplay
) -> Controller:
    """Train one controller of a study, from the checkpoint in the folder on; write weights, checkpoints and log there.

    Args:
        study: the study.
        label: name of the controller, or NAME#SEED.
        folder: for its files.
        seed: seed of all random numbers.
        base: the controller that it corrects.
        display: shows the progress.

    Raises:
        ConfigurationError: the settings are impossible, or the checkpoint is damaged or of other settings.
        KeyboardInterrupt: Ctrl-C; the trainer has written a checkpoint.
    """
    entry = study.controllers[label.partition(SEED_MARK)[0]]
    assert entry.trainer is not None
    resume = any(folder.glob(CHECKPOINTS))
    last = [0.0, 0.0]

    def report(progress: Progress) -> None:
        passed, steps = progress.seconds - last[0], progress.steps - last[1]
        notes = []
        if passed > 0 and last[1]:
            notes.append(f"{steps / passed:,.0f} steps/s")
        if not math.isnan(progress.mean_reward):
            notes.append(f"mean reward {progress.mean_reward:.4f}")
        last[:] = progress.seconds, progress.steps
        done = min(progress.steps, progress.total_steps)
        display.update(f"train {label}", done, progress.total_steps, ", ".join(notes))

    if not resume:
        display.update(f"train {label}", 0, getattr(entry.settings, "total_steps", 0))
    controller = entry.trainer.train(
        study.task, entry.settings, seed=seed, folder=folder, resume=resume, base=base, progress=report
    )
    controller.save(folder / WEIGHTS)
    return controller


def tune_controller(
    study: StudySettings, name: str, file: Path, folder: Path, seed: int, display: ProgressDisplay
) -> Controller:
    """Tune one classical controller of a study with progress on the console; continues after an interruption.

    The best gains so far are written after every generation. The file of the final gains says in a comment whether an
    axis under them comes to rest without sensor noise.

    Args:
        study: the study.
        name: name of a controller with ``tune``.
        file: for the gains.
        folder: keeps the finished generations.
        seed: seed of the search.
        display: shows the progress.

    Raises:
        ConfigurationError: no candidate can control the axis.
        KeyboardInterrupt: Ctrl-C.
    """
    entry = study.controllers[name]
    budget, given = entry.tune, entry.settings
    assert budget is not None
    start = stable_start(study.task, given)
    if getattr(start, "proportional", None) != getattr(given, "proportional", None):
        display.say(f"{name}: its gains are unstable on this rig; the search starts from the figures of the rig")

    def report(best: Tuned) -> None:
        done = min(best.evaluations, budget.evaluations)
        display.update(f"tune {name}", done, budget.evaluations, f"{1e3 * best.cost:.4f} mm")
        write_text(file, gains_text(best.gains))

    display.update(f"tune {name}", 0, budget.evaluations)
    search = Search(budget.evaluations, seed, budget.cases, start)
    tuned = tune(entry.kind, study.task, search, folder, report)
    made = make_controller(entry.kind, study.task, tuned.gains.model_dump())
    found = counted_at_rest(made, study.task, STANDSTILLS, STANDSTILL_CASES)
    note = f"{rest_text(found)} (drawn plants and leaks, without sensor noise)"
    write_text(file, gains_text(tuned.gains, note[0].upper() + note[1:]))
    display.say(
        f"{name}: {1e3 * tuned.cost:.4f} mm on training cases, geometric mean of the families, cost of command changes "
        "included"
    )
    if not comes_to_rest(found):
        display.say(f"{name}, tuned: {note}")
    return made


def train_leakage_head(
    study: StudySettings,
    folder: Path,
    seed: int,
    controllers: Sequence[Controller],
    display: ProgressDisplay,
) -> LeakageHead:
    """Train the leakage head on episodes under each controller; the folder keeps the runs and gets the head.

    Raises:
        ConfigurationError: the settings are impossible, or the rig lacks a sensor that the head reads.
    """
    from hydro_agents.detection.head_training import train_head  # loads torch

    def report(phase: str, done: int, total: int, loss: float) -> None:
        display.update(f"leakage head, {phase}", done, total, "" if math.isnan(loss) else f"loss {loss:.4f}")

    head = train_head(study.task, controllers, study.leakage_head, seed, report, folder)
    head.save(folder / HEAD_WEIGHTS)
    return head
