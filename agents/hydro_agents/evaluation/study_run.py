"""Runs a study: tunes and trains its controllers with progress on the console, then compares all of them.

The output folder gets the result of each phase, and meanwhile its finished jobs; an interrupted study can therefore
resume. A study with several training seeds trains each learned controller once per seed, as ``NAME#0``, ``NAME#1``, …:
the seeds share its rows in the tables, whose intervals include them.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hydro_agents.controllers.base import ClassicalController, Controller
from hydro_agents.controllers.registry import CONTROLLERS, GAINS_FILE, gains_text
from hydro_agents.evaluation.robustness_protocol import participants
from hydro_agents.evaluation.runner import Facts, Results, run
from hydro_agents.evaluation.study import StudySettings
from hydro_agents.learning.loading import load_controller
from hydro_agents.learning.progress import PROGRESS_FILE, Progress
from hydro_agents.learning.stable_gain import stable_start
from hydro_agents.learning.tuning import Search, Tuned, tune
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.limit_cycles import comes_to_rest, counted_at_rest, rest_text
from hydro_agents.running.seeds import SEED_MARK, STANDSTILLS, TRIAL_RUN
from hydro_agents.running.text import capitalised
from hydro_env import ConfigurationError
from hydro_env.errors import at
from hydro_env.files import read_yaml, write_text, write_yaml

CONFIG_FILE = "study.yaml"
TUNED_FILE = "tuned_study.yaml"  # the study with the tuned gains, for hydro evaluate --config and hydro train --config

WEIGHTS = "policy"
CHECKPOINTS = "checkpoint*"
TRAINING_FILES = (f"{WEIGHTS}.*", CHECKPOINTS, PROGRESS_FILE, "events.out.tfevents.*")  # of one controller
STANDSTILL_CASES = 16  # at which the tuned gains are searched for limit cycles

TRAINED_BY = ("seed", "task", "controllers")  # what weights depend on; the rest may change when a study resumes


def labels_of(study: StudySettings, name: str, seeds: range) -> dict[str, int]:
    """Names under which a controller takes part, with the training seed of each."""
    if name in study.trained and len(seeds) > 1:
        return {f"{name}{SEED_MARK}{seed}": seed for seed in seeds}
    return {name: seeds[0]}


def files_of(study: StudySettings, seeds: range) -> list[str]:
    """Names of the files that :func:`run_study` may write."""
    files = [CONFIG_FILE, TUNED_FILE]
    for name in study.trained:
        for label in labels_of(study, name, seeds):
            files += [f"controllers/{label}/{file}" for file in TRAINING_FILES]
    return files + [f"controllers/{name}/{GAINS_FILE}" for name in study.tuned]


def run_study(study: StudySettings, folder: Path, seeds: range, display: ProgressDisplay, facts: Facts = ()) -> Results:
    """Run all phases of a checked study that are not finished in the folder, which gets :func:`files_of`.

    The first of the seeds of the trainings is that of the tuning; ``facts`` are more rows of the table ``protocol``.

    Raises:
        ConfigurationError: settings contradict each other, or the folder holds results of other settings.
        KeyboardInterrupt: Ctrl-C; the finished work remains and the study can be resumed.
    """
    _write_settings(study, folder, seeds[0])
    try_out(study)
    if study.tuned:
        study = _with_gains(study, folder, seeds[0], display)
    known = {name: study.make(name) for name in study.controllers if name not in study.trained}
    for name in study.trained:
        for label, seed in labels_of(study, name, seeds).items():
            known[label] = _trained(study, label, folder, seed, known, display)
    controllers = {label: known[label] for name in study.controllers for label in labels_of(study, name, seeds)}
    protocol = study.evaluation.protocol(study.task, study.title)
    return run(protocol, participants(controllers, protocol, study.corrects), folder, display.update, facts)


def _write_settings(study: StudySettings, folder: Path, seed: int) -> None:
    """Write the settings into the folder; its earlier results must have the same settings."""
    described = json.loads(json.dumps({**study.model_dump(mode="json"), "seed": seed}))
    file = folder / CONFIG_FILE
    if file.exists():
        before = read_yaml(file)
        changed = next((key for key in TRAINED_BY if before.get(key) != described[key]), None)
        if changed:
            made = f"was made with another seed or other settings ('{changed}' differs)"
            raise ConfigurationError(f"{file}: {made}; --overwrite begins anew")
    write_yaml(file, described)


def _with_gains(study: StudySettings, folder: Path, seed: int, display: ProgressDisplay) -> StudySettings:
    """The study with gains in place of the tuning of its controllers; those of the folder, if it has them."""
    file = folder / TUNED_FILE
    if file.exists():
        return study.changed(controllers=StudySettings.from_yaml(file).controllers)
    controllers = dict(study.controllers)
    for name in study.tuned:
        gains = tune_controller(study, name, folder / "controllers" / name / GAINS_FILE, folder, seed, display).gains
        controllers[name] = controllers[name].changed(settings=gains, tune=None)
    study = study.changed(controllers=controllers)
    write_yaml(file, study.model_dump(mode="json"))
    return study


def try_out(study: StudySettings) -> None:
    """Run each controller that needs no training for two episodes, before hours of training.

    Raises:
        ConfigurationError: a controller fails; the message names it.
    """
    cases = Cases(np.array(TRIAL_RUN.take(2)))
    for name, entry in study.controllers.items():
        if not entry.trainer:
            with at(f"controllers.{name}"):
                run_cases(study.task, study.make(name), cases)


def _trained(
    study: StudySettings, label: str, folder: Path, seed: int, known: Mapping[str, Controller], display: ProgressDisplay
) -> Controller:
    """A controller after its training with one seed; it corrects that of the same seed, if that one is trained too."""
    name, own = label.partition(SEED_MARK)[0], folder / "controllers" / label
    entry = study.controllers[name]
    assert entry.trainer
    if any(own.glob(f"{WEIGHTS}.*")):
        display.say(f"{label}: already trained")
        return load_controller(entry.trainer.load(own / WEIGHTS), study.task, label)
    base = None
    if entry.corrects:
        base = known.get(f"{entry.corrects}{SEED_MARK}{seed}") or known[entry.corrects]
    return train_controller(study, label, own, seed, base, display)


def train_controller(
    study: StudySettings, label: str, folder: Path, seed: int, base: Controller | None, display: ProgressDisplay
) -> Controller:
    """Train one controller of a study, from the checkpoint in the folder on; write weights, checkpoints and log there.

    ``label`` is its name, or NAME#SEED; ``base`` is the controller that it corrects.

    Raises:
        ConfigurationError: the settings are impossible, or the checkpoint is damaged or of other settings.
        KeyboardInterrupt: Ctrl-C; the trainer has written a checkpoint.
    """
    entry = study.controllers[label.partition(SEED_MARK)[0]]
    assert entry.trainer
    resume = any(folder.glob(CHECKPOINTS))

    def report(progress: Progress) -> None:
        reward = "" if math.isnan(progress.mean_reward) else f"mean reward {progress.mean_reward:.4f}"
        display.update(f"train {label}", min(progress.steps, progress.total_steps), progress.total_steps, reward)

    if not resume:
        display.update(f"train {label}", 0, getattr(entry.settings, "total_steps", 0))
    controller = entry.trainer.train(
        study.task, entry.settings, seed=seed, folder=folder, resume=resume, base=base, progress=report
    )
    controller.save(folder / WEIGHTS)
    return controller


def tune_controller(
    study: StudySettings, name: str, file: Path, folder: Path, seed: int, display: ProgressDisplay
) -> ClassicalController:
    """Tune one classical controller of a study with progress on the console; continues after an interruption.

    The best gains so far are written after every generation. The file of the final gains says in a comment whether an
    axis under them comes to rest without sensor noise; the folder keeps the finished generations.

    Raises:
        ConfigurationError: no candidate can control the axis.
        KeyboardInterrupt: Ctrl-C.
    """
    entry = study.controllers[name]
    budget, given = entry.tune, entry.settings
    assert budget
    start = stable_start(study.task, given)
    if getattr(start, "proportional", None) != getattr(given, "proportional", None):
        display.say(f"{name}: its gains are unstable on this rig; the search starts from the figures of the rig")

    def report(best: Tuned) -> None:
        done = min(best.evaluations, budget.evaluations)
        display.update(f"tune {name}", done, budget.evaluations, f"{1e3 * best.cost:.4f} mm")
        write_text(file, gains_text(best.gains))

    display.update(f"tune {name}", 0, budget.evaluations)
    tuned = tune(entry.kind, [study.task], Search(start, budget.evaluations, seed, budget.cases), folder, report)
    made = CONTROLLERS[entry.kind][0](tuned.gains, study.task)
    found = counted_at_rest(made, study.task, STANDSTILLS, STANDSTILL_CASES)
    note = f"{rest_text(found)} (drawn plants and leaks, without sensor noise)"
    write_text(file, gains_text(tuned.gains, capitalised(note)))
    cost = f"{1e3 * tuned.cost:.4f} mm on training cases, geometric mean of the families"
    display.say(f"{name}: {cost}, cost of command changes included")
    if not comes_to_rest(found):
        display.say(f"{name}, tuned: {note}")
    return made
