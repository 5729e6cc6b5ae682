"""Runs a study: tune and train its controllers, then compare all of them.

The output folder gets the result of each phase, and meanwhile its finished jobs; an interrupted study can therefore
resume. A study with several training seeds trains each learned controller once per seed, as ``NAME#0``, ``NAME#1``, …:
the seeds share its rows in the tables, whose intervals include them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from hydro_agents.controllers.base import ClassicalController, Controller
from hydro_agents.controllers.registry import GAINS_FILE, make_controller
from hydro_agents.evaluation.conditions import at
from hydro_agents.evaluation.participants import participants
from hydro_agents.evaluation.runner import Results, run
from hydro_agents.learning.loading import load_controller
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import RESULT_FILES
from hydro_agents.running.seeds import SEED_MARK, TRIAL_RUN
from hydro_agents.study.settings import StudySettings
from hydro_agents.study.training import (
    TRAINING_FILES,
    WEIGHTS,
    train_controller,
    tune_controller,
)
from hydro_env import ConfigurationError
from hydro_env.files import read_yaml, write_yaml

CONFIG_FILE = "study.yaml"
TUNED_FILE = "tuned_study.yaml"
"""The study with the tuned gains, for `hydro evaluate --config` and `hydro train --config`."""

TRAINED_BY = ("seed", "task", "controllers")
"""Settings on which trained weights depend; the others may change when a study resumes."""


def labels_of(study: StudySettings, name: str, seeds: range) -> dict[str, int]:
    """Names under which a controller takes part, with the training seed of each."""
    if name in study.trained and len(seeds) > 1:
        return {f"{name}{SEED_MARK}{seed}": seed for seed in seeds}
    return {name: seeds[0]}


def claimed(
    study: StudySettings, folder: Path, seeds: range, files: Sequence[str], resume: bool, overwrite: bool
) -> AbstractContextManager[Path]:
    """The folder of a study, for its files and ``files``; see :func:`~hydro_agents.running.folders.output_folder`."""
    writes = [CONFIG_FILE, TUNED_FILE, RESULT_FILES, *files]
    for name in study.trained:
        for label in labels_of(study, name, seeds):
            writes += [f"controllers/{label}/{file}" for file in TRAINING_FILES]
    for name in study.tuned:
        writes.append(f"controllers/{name}/{GAINS_FILE}")
    return output_folder(folder, "study", writes, resume=resume, overwrite=overwrite)


def run_study(
    study: StudySettings,
    folder: Path,
    seeds: range,
    display: ProgressDisplay,
    facts: Sequence[tuple[str, str]] = (),
) -> Results:
    """Run all phases that are not finished in the folder (:func:`claimed`).

    Args:
        study: the study, checked.
        folder: for its files.
        seeds: of the trainings; the first one is that of the tuning.
        display: shows the progress.
        facts: more rows of the table ``protocol``: key and value.

    Raises:
        ConfigurationError: settings contradict each other, or the folder holds results of other settings.
        KeyboardInterrupt: Ctrl-C; the finished work remains and the study can be resumed.
    """
    _write_settings(study, folder, seeds[0])
    try_out(study)
    known: dict[str, Controller] = {}
    tuned = (folder / TUNED_FILE).exists()
    for name, entry in study.controllers.items():
        gains = folder / "controllers" / name / GAINS_FILE
        if name in study.tuned and tuned:
            known[name] = make_controller(entry.kind, study.task, read_yaml(gains))
        elif name in study.tuned:
            known[name] = tune_controller(study, name, gains, folder, seeds[0], display)
        elif entry.trainer is None:
            known[name] = study.make(name)
    if study.tuned:
        write_yaml(folder / TUNED_FILE, _with_gains(study, known))
    for name in study.trained:
        for label, seed in labels_of(study, name, seeds).items():
            known[label] = _trained(study, label, folder, seed, known, display)
    controllers = {label: known[label] for name in study.controllers for label in labels_of(study, name, seeds)}
    protocol = study.evaluation.protocol(study.task, study.title)
    chosen = replace(participants(controllers, protocol), corrects=study.corrects)
    return run(protocol, chosen, folder, None, display.update, facts)


def _write_settings(study: StudySettings, folder: Path, seed: int) -> None:
    """Write the settings into the folder; its earlier results must have the same settings."""
    described = json.loads(json.dumps({**study.model_dump(mode="json"), "seed": seed}))
    file = folder / CONFIG_FILE
    if file.exists():
        before = read_yaml(file)
        changed = next((key for key in TRAINED_BY if before.get(key) != described[key]), None)
        if changed is not None:
            raise ConfigurationError(
                f"{file}: was made with another seed or other settings ('{changed}' differs); --overwrite begins anew"
            )
    write_yaml(file, described)


def _with_gains(study: StudySettings, controllers: Mapping[str, Controller]) -> dict[str, Any]:
    """The settings of a study with the gains of its tuned controllers, which then need no tuning."""
    settings: dict[str, Any] = study.model_dump(mode="json")
    for name in study.tuned:
        gains = cast(ClassicalController, controllers[name]).gains
        settings["controllers"][name] |= {"settings": gains.model_dump(mode="json"), "tune": None}
    return settings


def try_out(study: StudySettings) -> None:
    """Run each controller that needs no training for two episodes, before hours of training.

    Raises:
        ConfigurationError: a controller fails; the message names it.
    """
    cases = Cases(np.array(TRIAL_RUN.take(2)))
    for name, entry in study.controllers.items():
        if entry.trainer is None:
            with at(f"controllers.{name}"):
                run_cases(study.task, study.make(name), cases, states=False)


def _trained(
    study: StudySettings,
    label: str,
    folder: Path,
    seed: int,
    known: Mapping[str, Controller],
    display: ProgressDisplay,
) -> Controller:
    """A controller after its training with one seed; it corrects that of the same seed, if that one is trained too."""
    name, own = label.partition(SEED_MARK)[0], folder / "controllers" / label
    entry = study.controllers[name]
    assert entry.trainer is not None
    if any(own.glob(f"{WEIGHTS}.*")):
        display.say(f"{label}: already trained")
        return load_controller(entry.trainer.load(own / WEIGHTS), study.task, label)
    base = None
    if entry.corrects is not None:
        base = known.get(f"{entry.corrects}{SEED_MARK}{seed}") or known[entry.corrects]
    return train_controller(study, label, own, seed, base, display)
