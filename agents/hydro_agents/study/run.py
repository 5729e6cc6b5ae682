"""Runs a study: train the controllers and the leakage head, compare the controllers, write the report.

Each phase writes its result into the output folder; an interrupted study can therefore resume.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from itertools import chain
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import ClassicalController, Controller
from hydro_agents.controllers.registry import GAINS_FILE, make_controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.head_training import simulations
from hydro_agents.evaluation.evaluate import Evaluation, study_protocol
from hydro_agents.evaluation.participants import participants
from hydro_agents.evaluation.runner import plan
from hydro_agents.learning.loading import load_controller
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import JOBS_FOLDER, Job, beside
from hydro_agents.running.seeds import TRIAL_RUN
from hydro_agents.study.results import REPORT_FILE, REPORT_FILES, STATE_FILE, Phases, evaluate_study, print_summary
from hydro_agents.study.settings import StudySettings
from hydro_agents.study.training import (
    HEAD_FILES,
    HEAD_WEIGHTS,
    TRAINING_FILES,
    TUNING_FILES,
    WEIGHTS,
    read_curve,
    train_controller,
    train_leakage_head,
    tune_controller,
)
from hydro_env import ConfigurationError
from hydro_env.files import read_yaml, write_yaml

CONFIG_FILE = "study.yaml"
HEAD_PHASE = "train leakage head"
TUNED_FILE = "tuned_study.yaml"
"""The study with the tuned gains, for `hydro evaluate --config` and `hydro train --config`."""

TRAINED_BY = ("seed", "task", "controllers", "leakage_head")
"""Settings on which trained weights depend; the others may change when a study resumes."""


def run_study(
    study: StudySettings,
    folder: Path,
    seed: int,
    resume: bool = False,
    overwrite: bool = False,
    command: str = "hydro study",
) -> Evaluation:
    """Run all phases; ``resume`` skips those that are finished.

    Raises:
        ConfigurationError: settings contradict each other, the folder cannot be used, or its results have other
            settings.
        KeyboardInterrupt: Ctrl-C; the finished work remains and the study can be resumed.
    """
    study.check()
    with claimed(study, folder, resume, overwrite), ProgressDisplay() as display:
        _write_settings(study, folder, seed)
        try_out(study)
        phases = Phases(folder)
        known = {
            name: _tuned(study, name, folder, seed, phases, display)
            for name, entry in study.controllers.items()
            if entry.trainer is None
        }
        with beside(_early_jobs(study, known, seed, phases), folder):
            for name in study.trained:
                known[name] = _trained(study, name, folder, seed, known, phases, display)
        controllers = {name: known[name] for name in study.controllers}
        curves = [read_curve(folder / "controllers" / name).assign(controller=name) for name in study.trained]
        if study.tuned:
            write_yaml(folder / TUNED_FILE, _with_gains(study, controllers))
        head = _head(study, folder, seed, controllers, phases, display)
        evaluation = evaluate_study(
            study,
            controllers,
            head,
            folder,
            display,
            configuration=(folder / CONFIG_FILE).read_text(encoding="utf-8"),
            command=command,
            seed=seed,
            phases=phases,
            training_curve=pd.concat(curves, ignore_index=True) if curves else pd.DataFrame(),
        )
        shutil.rmtree(folder / JOBS_FOLDER, ignore_errors=True)
    print_summary(evaluation, display)
    display.say("times: " + ", ".join(f"{phase} {seconds:.0f} s" for phase, seconds in phases.seconds.items()))
    display.say(f"report: {(folder / REPORT_FILE).resolve()}")
    return evaluation


def _early_jobs(study: StudySettings, known: Mapping[str, Controller], seed: int, phases: Phases) -> Iterator[Job]:
    """What can be done while the policies train: evaluating the others, and most runs of the head's training."""
    if not known or all(f"train {name}" in phases.done for name in study.trained):
        return
    protocol = study_protocol(study.task, study.evaluation)
    yield from (job for each in plan(protocol, participants(known, protocol)) for _, job in each.jobs)
    if study.leakage_head is not None:
        acting = [known.get(name) for name in study.controllers]
        yield from chain(
            *(jobs.values() for jobs in simulations(study.task, acting, study.leakage_head, seed).values())
        )


def claimed(study: StudySettings, folder: Path, resume: bool, overwrite: bool) -> AbstractContextManager[Path]:
    """The folder of a study for its files; see :func:`~hydro_agents.running.folders.output_folder`."""
    below = [f"controllers/{name}/{file}" for name in study.trained for file in TRAINING_FILES]
    below += [f"controllers/{name}/{file}" for name in study.tuned for file in TUNING_FILES]
    writes = [CONFIG_FILE, TUNED_FILE, STATE_FILE, *HEAD_FILES, *below, *REPORT_FILES]
    return output_folder(folder, "study", writes, resume=resume, overwrite=overwrite)


def is_finished(study: StudySettings, folder: Path, seed: int) -> bool:
    """Whether a folder holds the whole study with these settings and this seed, so that nothing is left to do."""
    file = folder / CONFIG_FILE
    if not file.exists() or not (folder / REPORT_FILE).exists():
        return False
    return bool(read_yaml(file) == _described(study, seed)) and "evaluate" in Phases(folder).done


def _described(study: StudySettings, seed: int) -> dict[str, Any]:
    """The settings as its file holds them."""
    described: dict[str, Any] = json.loads(json.dumps({**study.model_dump(mode="json"), "seed": seed}))
    return described


def _write_settings(study: StudySettings, folder: Path, seed: int) -> None:
    """Write the settings into the folder; its earlier results must have the same settings."""
    described = _described(study, seed)
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
    for name in [name for name, entry in study.controllers.items() if entry.trainer is None]:
        try:
            run_cases(study.task, study.make(name), cases, states=False)
        except ConfigurationError as error:
            raise ConfigurationError(f"controllers.{name}: {error}") from error


def _tuned(
    study: StudySettings, name: str, folder: Path, seed: int, phases: Phases, display: ProgressDisplay
) -> Controller:
    """A controller that needs no training, tuned first if the study requires it."""
    if name not in study.tuned:
        return study.make(name)
    own = folder / "controllers" / name
    if f"tune {name}" in phases.done:
        display.say(f"{name}: already tuned")
        return make_controller(study.controllers[name].kind, study.task, read_yaml(own / GAINS_FILE))
    return phases.run(f"tune {name}", lambda: tune_controller(study, name, own, seed, display))


def _trained(
    study: StudySettings,
    name: str,
    folder: Path,
    seed: int,
    controllers: dict[str, Controller],
    phases: Phases,
    display: ProgressDisplay,
) -> Controller:
    own, entry = folder / "controllers" / name, study.controllers[name]
    assert entry.trainer is not None
    if f"train {name}" in phases.done:
        display.say(f"{name}: already trained")
        return load_controller(entry.trainer.load(own / WEIGHTS), study.task, name)
    base = controllers[entry.corrects] if entry.corrects is not None else None
    return phases.run(f"train {name}", lambda: train_controller(study, name, own, seed, base, display))


def _head(
    study: StudySettings,
    folder: Path,
    seed: int,
    controllers: dict[str, Controller],
    phases: Phases,
    display: ProgressDisplay,
) -> LeakageHead | None:
    if study.leakage_head is None:
        return None
    if HEAD_PHASE in phases.done:
        display.say("leakage head: already trained")
        return LeakageHead.load(folder / HEAD_WEIGHTS)
    acting = list(controllers.values())
    return phases.run(HEAD_PHASE, lambda: train_leakage_head(study, folder, seed, acting, display))
