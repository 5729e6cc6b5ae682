"""Settings of a study: task, controllers, training of the leakage head, size of the evaluation.

On another task or rig gains are tuned first, and controllers that need a sensor that the rig lacks are left out.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from hydro_agents.controllers.base import ClassicalController, Controller
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_agents.detection.training_settings import HeadTrainingSettings
from hydro_agents.evaluation.evaluate import ProtocolSettings
from hydro_agents.evaluation.participants import split_name
from hydro_agents.learning.loading import (
    ANY_RIG,
    SHIPPED_WEIGHTS,
    gains_file,
    load_controller,
    shipped,
    ships,
    usual_gains,
)
from hydro_agents.learning.rig_gains import searched_gains
from hydro_agents.running.tasks import read_settings, read_task
from hydro_agents.running.text import correction_name
from hydro_agents.study.entries import ControllerEntry, Name, TuningSettings, following, refuse_later
from hydro_env import ConfigurationError, PlantParameters, TaskConfig
from hydro_env.files import Group, read_yaml, validate
from hydro_env.folders import config_file
from hydro_env.mistakes import kept, refuse
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SENSORS


class StudySettings(Group):
    """A study: task, controllers, training and evaluation. ``configs/studies`` holds examples."""

    seed: int = Field(0, ge=0, le=2**32 - 1, description="seed of all random numbers; --seed overrides it")
    title: str = "Controllers of a servo axis that leaks"
    task: TaskConfig = Field(default_factory=TaskConfig)
    controllers: dict[Name, ControllerEntry] = Field(
        min_length=1, description="by name; the first one is the baseline of the comparison"
    )
    training: dict[str, Any] = Field(
        default_factory=dict,
        exclude=True,
        description="settings of every training, unless its controller says otherwise",
    )
    leakage_head: HeadTrainingSettings | None = Field(
        default_factory=HeadTrainingSettings, description="null: the study trains no leakage head"
    )
    evaluation: ProtocolSettings = Field(default_factory=ProtocolSettings)

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Give each entry what it takes over from the one that it comes ``after``, and from ``training``."""
        if not isinstance(values.get("controllers"), dict):
            return values
        entries: dict[str, Any] = {}
        for name, entry in values["controllers"].items():
            if isinstance(entry, dict):
                refuse_later(name, "after", entry.get("after"), entries)
                entry = following(entry, entries.get(str(entry.get("after"))), values.get("training"))
            entries[name] = entry
        return {**values, "controllers": entries, "training": {}}

    @model_validator(mode="after")
    def _corrections(self) -> StudySettings:
        earlier: list[str] = []
        for name, entry in self.controllers.items():
            refuse_later(name, "corrects", entry.corrects, earlier)
            earlier.append(name)
        return self

    @classmethod
    def from_yaml(cls, path: str | Path) -> StudySettings:
        """Read a study; a group, and the settings of a controller, may be the path of another YAML file.

        Such a path is relative to the study's file. The task may be a name in ``configs/tasks``.

        Raises:
            ConfigurationError: unreadable file, unknown key or impossible value.
        """
        values = read_yaml(path)
        errors: list[ConfigurationError] = []
        with kept(errors):
            if "task" in values:
                values["task"] = read_task(values.pop("task"), Path(path))
        groups: dict[str, type[Group]] = {"leakage_head": HeadTrainingSettings, "evaluation": ProtocolSettings}
        for key, group in groups.items():
            if isinstance(values.get(key), str):
                file = Path(path).parent / values.pop(key)
                with kept(errors):
                    values[key] = validate(group, read_yaml(file), str(file))
        with kept(errors):
            sources = read_settings(values.get("controllers"), Path(path))
        with kept(errors):
            study = validate(cls, values, str(path))
        refuse(errors, str(path))
        study.check(str(path), sources)
        return study

    def check(self, source: str = "study", sources: Mapping[str, str] | None = None) -> None:
        """Check everything that would otherwise fail after hours of work.

        Args:
            source: for messages.
            sources: files with the settings of controllers, by name.

        Raises:
            ConfigurationError: a controller cannot be made, settings contradict each other, or the episodes are too
                short for the leakage head.
        """
        errors: list[ConfigurationError] = []
        for name in self.controllers:
            with kept(errors):
                self._check_controller(name, source, (sources or {}).get(name))
        with kept(errors):
            try:
                if self.leakage_head is not None:
                    self.leakage_head.check(self.task)
            except ConfigurationError as error:
                raise ConfigurationError(f"{source}: {error}") from None
        refuse(errors, source)

    def _check_controller(self, name: str, source: str, file: str | None) -> None:
        """Check one controller; ``file`` holds its settings if they have a file of their own."""
        entry, here = self.controllers[name], f"{source}: controllers.{name}"
        settings_at = (file, "") if file is not None else (source, f"controllers.{name}.settings")
        try:
            trainer = entry.trainer
        except ConfigurationError as error:
            raise ConfigurationError(f"{here}: {error}") from error
        if trainer is None:
            if entry.kind in CONTROLLERS:
                validate(CONTROLLERS[entry.kind][1], entry.settings, *settings_at)
            try:
                load_controller(make_controller(entry.kind, self.task, entry.settings), self.task, name)
            except ConfigurationError as error:
                raise ConfigurationError(f"{file or here}: {error}") from error
            if entry.corrects is not None:
                raise ConfigurationError(f"{here}: corrects: only a trained one can correct")
            if entry.tune is not None and entry.kind not in CONTROLLERS:
                raise ConfigurationError(f"{here}: tune: only {', '.join(CONTROLLERS)} can be tuned")
        else:
            if entry.tune is not None:
                raise ConfigurationError(f"{here}: tune: a trained one cannot be tuned")
            settings = validate(trainer.settings, entry.settings, *settings_at)
            if getattr(settings, "residual", False) and entry.corrects is None:
                raise ConfigurationError(
                    f"{here}: is trained as a correction (residual: true): give 'corrects: NAME' of the controller "
                    "that it corrects"
                )
            task_config(self.task, **getattr(settings, "practice", {}))

    def make(self, name: str) -> Controller:
        """A controller of the study that needs no training."""
        entry = self.controllers[name]
        return make_controller(entry.kind, self.task, entry.settings)

    def training_settings(self, name: str) -> Group:
        """Settings of the training of a controller.

        Raises:
            ConfigurationError: the controller needs no training, or its settings are wrong.
        """
        trainer = self.controllers[name].trainer
        if trainer is None:
            raise ConfigurationError(f"controllers.{name}: is not trained")
        return validate(trainer.settings, self.controllers[name].settings, f"controllers.{name}")

    @property
    def trained(self) -> list[str]:
        """Names of the controllers that are trained."""
        return [name for name, entry in self.controllers.items() if entry.trainer is not None]

    @property
    def tuned(self) -> list[str]:
        """Names of the classical controllers that are tuned before they take part."""
        return [name for name, entry in self.controllers.items() if entry.tune is not None]

    def with_weights(self, agents: Mapping[str, str]) -> dict[str, Controller]:
        """All controllers ready to act, without any training.

        Args:
            agents: additional controllers, or replacements of those of the study, as texts for
                :func:`~hydro_agents.learning.loading.load_controller`. ``NAME#0``, ``NAME#1``, … are training
                seeds, which replace a controller NAME of the study. Any other trained controller takes the shipped
                weights.

        Raises:
            ConfigurationError: a controller cannot be made or has no weights.
        """
        controllers: dict[str, Controller] = {}
        for name, entry in self.controllers.items():
            if seeds := [agent for agent in agents if split_name(agent)[0] == name]:
                controllers |= {seed: load_controller(agents[seed], self.task, seed, entry.trainer) for seed in seeds}
            elif entry.trainer is None:
                controllers[name] = load_controller(self.make(name), self.task, name)
            else:
                controllers[name] = self._shipped(name)
        for name, what in agents.items():
            if name not in controllers:
                controllers[name] = load_controller(what, self.task, name)
        return controllers

    def _shipped(self, name: str) -> Controller:
        """The shipped weights, which correct flow linearisation; only those for any axis have a memory."""
        entry = self.controllers[name]
        if entry.kind in SHIPPED_WEIGHTS and entry.corrects and self.controllers[entry.corrects].kind in ANY_RIG:
            settings: Any = self.training_settings(name)
            if settings.law or not settings.lstm_cells:
                return load_controller(entry.kind, self.task, name)
        raise ConfigurationError(f"{name}: no weights of this kind are shipped; give --agent {name}=PATH")

    def with_gains_of_rig(self) -> StudySettings:
        """The study on its rig: gains that ship for another one give way to those that ship for or come from this one.

        A controller for which there are none is left out, with a line on standard error.
        """
        controllers = dict(self.controllers)
        for name, entry in self.controllers.items():
            if self.task.plant == PlantParameters() or not ships(entry.kind, entry.settings):
                continue
            if entry.kind in ANY_RIG and gains_file(entry.kind, self.task) is None:
                continue
            try:
                own: Any = shipped(entry.kind, self.task, searched_gains)
            except ConfigurationError as error:
                print(f"hydro: left out: {name}: {error}", file=sys.stderr)
                del controllers[name]
            else:
                settings = own.gains.model_dump(mode="json")
                controllers[name] = entry.model_copy(update={"settings": settings, "tune": None})
        return self.model_copy(update={"controllers": controllers})

    def fitting(self, agents: Mapping[str, str]) -> tuple[dict[str, Controller], list[str]]:
        """Like :meth:`with_weights`, but weights that need other observations are left out, with the reason."""
        reasons = []
        study, given = self, {split_name(agent)[0] for agent in agents}
        for name, entry in self.controllers.items():
            if entry.trainer is not None and name not in given:
                try:
                    self._shipped(name)
                except ConfigurationError as error:
                    reasons.append(str(error))
                    others = {key: value for key, value in study.controllers.items() if key != name}
                    study = study.model_copy(update={"controllers": others})
        return study.with_weights(agents), reasons


def default_study(
    path: Path | None = None, task: str | Path | None = None, rig: str | Path | None = None
) -> StudySettings:
    """The study of a file or of ``make study``, optionally with another task or rig.

    Gains belong to a rig. On another rig every classical controller is therefore tuned first; flow linearisation begins
    with its gains for any rig. Controllers that need absent sensors are left out, with one line each on standard error.

    Args:
        path: name in ``configs/studies`` or YAML file of the study; default: ``default``.
        task: name or file of the task, instead of the study's.
        rig: name or file of another rig for the task.

    Raises:
        ConfigurationError: a file is wrong, or settings contradict each other.
    """
    study = StudySettings.from_yaml(config_file("studies", path or "default"))
    if task is None and rig is None:
        return study
    changes: dict[str, Any] = {"task": task_config(study.task if task is None else task, rig=rig)}
    if rig is not None:
        changes["title"] = f"{study.title} (rig: {Path(rig).stem})"
        changes["controllers"] = {name: _begun(entry) for name, entry in study.controllers.items()}
    study, notes = without_absent_sensors(study.model_copy(update=changes))
    for note in notes:
        print(f"hydro: {note}", file=sys.stderr)
    study.check("study" if path is None else str(path))
    return study


def _begun(entry: ControllerEntry) -> ControllerEntry:
    """The entry of a controller for another rig, which tunes it; gains of the paper's rig give way to those for any."""
    if entry.kind not in CONTROLLERS:
        return entry
    usual = entry.kind in ANY_RIG and entry.settings == read_yaml(usual_gains(entry.kind))
    settings = CONTROLLERS[entry.kind][1]().model_dump(mode="json") if usual else entry.settings
    return entry.model_copy(update={"tune": entry.tune or TuningSettings(), "settings": settings})


def without_absent_sensors(study: StudySettings) -> tuple[StudySettings, list[str]]:
    """The part of a study that works with the sensors of its task.

    A classical controller that reads an absent sensor is left out. A policy that corrects such a controller corrects
    the last classical one before it instead, also by name. The leakage head needs all sensors.

    Returns:
        The study, and one line per change; the study itself if the rig lacks no sensor.

    Raises:
        ConfigurationError: no controller is left.
    """
    if not (absent := [name for name in SENSORS if not getattr(study.task.sensors, name).fitted]):
        return study, []
    kept: dict[str, ControllerEntry] = {}
    notes = []
    for name, entry in study.controllers.items():
        if entry.kind in CONTROLLERS and (reason := _refusal(entry, study.task)):
            notes.append(f"{name} is left out: {reason}")
            continue
        if entry.corrects is not None and entry.corrects not in kept:
            others = [other for other, one in kept.items() if one.kind in CONTROLLERS]
            if not others:
                notes.append(f"{name} is left out: it corrects {entry.corrects}")
                continue
            notes.append(f"{name} corrects {others[-1]} instead of {entry.corrects}")
            if name.endswith(before := correction_name("", entry.corrects)):
                name = name.removesuffix(before) + correction_name("", others[-1])
            entry = _correcting(entry, others[-1], CONTROLLERS[kept[others[-1]].kind][0])
        kept[name] = entry
    if not kept:
        raise ConfigurationError(f"no controller works with the sensors of this rig: {notes[0]}")
    changes: dict[str, Any] = {"controllers": kept}
    if study.leakage_head is not None:
        notes.append(f"trains no leakage head: it would read {', '.join(absent)}, but this rig has no such sensor")
        changes["leakage_head"] = None
    return study.model_copy(update=changes), notes


def _refusal(entry: ControllerEntry, task: TaskConfig) -> str:
    try:
        make_controller(entry.kind, task, entry.settings)
    except ConfigurationError as error:
        return str(error)
    return ""


def _correcting(entry: ControllerEntry, base: str, controller: type[ClassicalController]) -> ControllerEntry:
    """The entry of a policy that corrects another controller, whose estimates it sees only if there are any."""
    estimates = entry.settings.get("see_estimates", False) and bool(controller.estimate_names)
    seen = {"see_estimates": estimates} if "see_estimates" in entry.settings else {}
    return entry.model_copy(update={"corrects": base, "settings": entry.settings | seen})
