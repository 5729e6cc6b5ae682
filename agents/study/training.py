"""Trains the controllers and the leakage head of a study, with progress on the console and a training curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from agents.controllers.base import Controller
from agents.leakage.head import LeakageHead
from agents.leakage.training import train_head
from agents.learning.training import Progress
from agents.running.console import ProgressDisplay
from agents.study.settings import StudySettings
from hydro_env import ConfigurationError
from hydro_env.files import Group, write_whole

WEIGHTS = "policy"
HEAD_WEIGHTS = "leakage_head"
CHECKPOINTS = "checkpoint*"
HEAD_CHECKPOINT = "head_checkpoint"
CURVE_FILE = "training_curve.csv"
CURVE_COLUMNS = ("steps", "seconds", "mean_reward")
TRAINING_FILES = (f"{WEIGHTS}.*", CHECKPOINTS, "progress.csv", "events.out.tfevents.*", CURVE_FILE)
"""What the training of a controller writes; the checkpoints of a trainer begin with ``checkpoint``."""

HEAD_FILES = (f"{HEAD_WEIGHTS}.*", f"{HEAD_CHECKPOINT}.*")


def train_controller(
    study: StudySettings,
    name: str,
    folder: Path,
    seed: int,
    resume: bool,
    base: Controller | None,
    display: ProgressDisplay,
    settings: Group | None = None,
) -> Controller:
    """Train one controller of a study; weights, checkpoints and curve go into the folder.

    Args:
        study: the study.
        name: of the controller.
        folder: for its files.
        seed: of everything that is drawn.
        resume: go on from the checkpoint in the folder.
        base: the controller that it corrects.
        display: for the progress.
        settings: of the training, instead of the study's.

    Raises:
        ConfigurationError: impossible settings, or a checkpoint that is missing, damaged or of other settings.
        KeyboardInterrupt: Ctrl-C; the trainer has kept a checkpoint.
    """
    settings = settings if settings is not None else study.training_settings(name)
    trainer = study.controllers[name].trainer
    assert trainer is not None
    rows = read_curve(folder).to_dict("records") if resume else []
    before, began_at = (rows[-1]["seconds"], len(rows)) if rows else (0.0, 0)
    last = [0.0, 0.0]

    def report(progress: Progress) -> None:
        if len(rows) == began_at:  # what came after the checkpoint is done again
            rows[:] = [row for row in rows if row["steps"] < progress.steps]
        passed, steps = progress.seconds - last[0], progress.steps - last[1]
        rate = f"{steps / passed:,.0f} steps/s" if passed > 0 and last[1] else ""
        last[:] = progress.seconds, progress.steps
        rows.append(
            {"steps": progress.steps, "seconds": before + progress.seconds, "mean_reward": progress.mean_reward}
        )
        reward = "" if math.isnan(progress.mean_reward) else f"mean reward {progress.mean_reward:.4f}"
        note = ", ".join(part for part in (rate, reward) if part)
        display.update(f"train {name}", min(progress.steps, progress.total_steps), progress.total_steps, note)

    try:
        controller = trainer.train(
            study.task, settings, seed=seed, folder=folder, resume=resume, base=base, progress=report
        )
    finally:
        if rows:
            write_whole(folder / CURVE_FILE, pd.DataFrame(rows, columns=CURVE_COLUMNS).to_csv(index=False).encode())
    controller.save(folder / WEIGHTS)
    return controller


def read_curve(folder: Path) -> pd.DataFrame:
    """The training curve in a folder; empty where there is none.

    Raises:
        ConfigurationError: the file is damaged.
    """
    file = folder / CURVE_FILE
    if not file.exists():
        return pd.DataFrame(columns=CURVE_COLUMNS, dtype=float)
    try:
        return pd.read_csv(file)[list(CURVE_COLUMNS)].astype(float)
    except (OSError, ValueError, KeyError):
        raise ConfigurationError(f"{file}: is no training curve with the columns {', '.join(CURVE_COLUMNS)}") from None


def train_leakage_head(
    study: StudySettings,
    folder: Path,
    seed: int,
    resume: bool,
    controllers: Sequence[Controller],
    display: ProgressDisplay,
) -> LeakageHead:
    """Train the leakage head on episodes under each controller; its weights go into the folder."""

    def report(phase: str, done: int, total: int, loss: float) -> None:
        display.update(f"leakage head, {phase}", done, total, "" if math.isnan(loss) else f"loss {loss:.4f}")

    head = train_head(study.task, controllers, study.leakage_head, seed, report, folder=folder, resume=resume)
    head.save(folder / HEAD_WEIGHTS)
    return head
