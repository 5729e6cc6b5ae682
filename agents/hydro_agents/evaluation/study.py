"""A study as data: task, controllers to tune and train, the size of their comparison; and the leakage head's training.

A file is validated once, in whole: the settings of a controller too become gains or settings of a training. On another
rig gains are tuned first, and controllers that need a sensor that the rig lacks are left out.
"""

import sys
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, SerializeAsAny, StringConstraints, ValidationInfo, field_validator

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_agents.detection.training_settings import HeadTrainingSettings
from hydro_agents.evaluation.evaluate import ProtocolSettings
from hydro_agents.evaluation.robustness_protocol import split_name
from hydro_agents.learning.loading import SHIPPED_WEIGHTS, load_controller, shipped, ships, usual_gains
from hydro_agents.learning.rig_gains import searched_gains
from hydro_agents.learning.trainers import TRAINERS, Trainer, trainer
from hydro_agents.running.tasks import mappings, read_task, timed_task
from hydro_agents.running.text import NAME_RULE
from hydro_env import ConfigurationError, PlantParameters, TaskConfig, task_config
from hydro_env.errors import at
from hydro_env.files import Group, read_yaml, validate, whole_group
from hydro_env.folders import config_file
from hydro_env.mistakes import Kept, did_you_mean, kept, refuse, unknown

Name = Annotated[str, StringConstraints(pattern=NAME_RULE)]


class TuningSettings(Group):
    """Tuning of a classical controller (:func:`hydro_agents.learning.tuning.tune`) before it takes part in a study."""

    evaluations: int = Field(840, ge=1, le=10_000_000)  # total number of candidates
    cases: int = Field(42, ge=1, le=100_000)  # training cases per candidate


class ControllerEntry(Group):
    """One controller of a study."""

    kind: str  # pid, ppo, or module:attribute for your own controller or trainer
    # Settings of the controller or its training; or the path of a YAML file
    settings: SerializeAsAny[Any] = Field({}, validate_default=True)
    corrects: str | None = None  # name of the controller whose command a trained one corrects
    # For a classical controller: tune its gains first, beginning with its settings; --rig always does
    tune: TuningSettings | None = None

    @field_validator("kind")
    @classmethod
    def _known_kind(cls, kind: str) -> str:
        if ":" not in kind and kind not in (*CONTROLLERS, *TRAINERS):
            raise ValueError(f"{unknown(kind, (*CONTROLLERS, *TRAINERS))}, or 'module:attribute'")
        return kind

    @field_validator("settings")
    @classmethod
    def _of_its_kind(cls, given: Any, info: ValidationInfo) -> Any:
        """Gains of a classical controller, settings of a training; those of a controller of your own as they are."""
        kind = info.data.get("kind")
        if kind is None:
            return given
        if kind in CONTROLLERS:
            return CONTROLLERS[kind][1].model_validate(given)
        try:
            training = trainer(kind)
        except ConfigurationError as error:
            raise ValueError(str(error)) from None
        return training.settings.model_validate(given) if training else given

    @cached_property
    def trainer(self) -> Trainer | None:
        """Its trainer; ``None`` for a controller that needs no training."""
        return trainer(self.kind)


class StudySettings(Group):
    """A study: task, controllers, training and evaluation. ``configs/studies`` holds examples."""

    seed: int = Field(0, ge=0, le=2**32 - 1)  # seed of all random numbers; --seed overrides it
    title: str = "Controllers of a servo axis that leaks"
    task: TaskConfig = TaskConfig()
    controllers: dict[Name, ControllerEntry] = Field(min_length=1)  # by name; the first is the baseline
    # For hydro train head, with task and controllers of the study
    leakage_head: HeadTrainingSettings = Field(default_factory=HeadTrainingSettings)
    evaluation: ProtocolSettings = ProtocolSettings()

    @whole_group
    def _corrections(self) -> "StudySettings":
        earlier: list[str] = []
        for name, entry in self.controllers.items():
            if entry.corrects is not None and entry.corrects not in earlier:
                must = f"must be a controller before it ({', '.join(earlier) or 'none'})"
                guess = did_you_mean(entry.corrects, earlier)
                raise ValueError(f"controllers.{name}: corrects = '{entry.corrects}': {must}{guess}")
            earlier.append(name)
        return self

    @classmethod
    def from_yaml(cls, path: str | Path) -> "StudySettings":
        """Read a study; a group, and the settings of a controller, may be the path of another YAML file.

        Such a path is relative to the study's file. The task may be a name in ``configs/tasks``.

        Raises:
            ConfigurationError: unreadable file, unknown key or impossible value.
        """
        values, file = read_yaml(path), Path(path)
        errors: Kept = []
        with kept(errors):
            if "task" in values:
                values["task"] = read_task(values.pop("task"), file)
        files = [(values, "leakage_head"), (values, "evaluation")]
        files += [(entry, "settings") for entry in mappings(values.get("controllers")).values()]
        for group, key in files:
            if isinstance(group.get(key), str):
                with kept(errors):
                    group[key] = read_yaml(file.parent / group.pop(key))
        with kept(errors):
            study = validate(cls, values, path)
        refuse(errors, path)
        study.check(path)
        return study

    def check(self, source: object = "study") -> None:
        """Check everything that would otherwise fail after hours of work; messages name the ``source``.

        Raises:
            ConfigurationError: a controller cannot be made, or settings contradict each other.
        """
        errors: Kept = []
        for name in self.controllers:
            with kept(errors), at(f"{source}: controllers.{name}"):
                self._check_controller(name)
        refuse(errors, source)

    def _check_controller(self, name: str) -> None:
        entry, wrong = self.controllers[name], ""
        if not entry.trainer:
            load_controller(self.make(name), self.task, name)
            if entry.corrects:
                wrong = "corrects: only a trained one can correct"
            elif entry.tune and entry.kind not in CONTROLLERS:
                wrong = f"tune: only {', '.join(CONTROLLERS)} can be tuned"
        elif entry.tune:
            wrong = "tune: a trained one cannot be tuned"
        elif getattr(entry.settings, "residual", False) and not entry.corrects:
            wrong = "is trained as a correction (residual: true): give 'corrects: NAME' of what it corrects"
        if wrong:
            raise ConfigurationError(wrong)
        task_config(self.task, **getattr(entry.settings, "practice", {}))

    def make(self, name: str) -> Controller:
        """A controller of the study that needs no training."""
        entry = self.controllers[name]
        return make_controller(entry.kind, self.task, dict(entry.settings))

    @property
    def trained(self) -> list[str]:
        """Names of the controllers that are trained."""
        return [name for name, entry in self.controllers.items() if entry.trainer]

    @property
    def tuned(self) -> list[str]:
        """Names of the classical controllers that are tuned before they take part."""
        return [name for name, entry in self.controllers.items() if entry.tune]

    @property
    def corrects(self) -> dict[str, str]:
        """Names of the controllers that correct another one, and of that one."""
        return {name: entry.corrects for name, entry in self.controllers.items() if entry.corrects}

    def with_weights(self, agents: Mapping[str, str], leave_out: bool = False) -> dict[str, Controller]:
        """All controllers ready to act, without any training.

        Args:
            agents: additional controllers, or replacements of those of the study, as texts for
                :func:`~hydro_agents.learning.loading.load_controller`. ``NAME#0``, ``NAME#1``, … are training
                seeds, which replace a controller NAME of the study. Any other trained controller takes the shipped
                weights.
            leave_out: leave out, with a line on standard error, what has no weights or needs other observations.

        Raises:
            ConfigurationError: a controller cannot be made or has no weights.
        """
        controllers = {}
        for name, entry in self.controllers.items():
            own = [agent for agent in agents if split_name(agent)[0] == name]
            for agent in own:
                controllers[agent] = load_controller(agents[agent], self.task, agent, entry.trainer)
            if own:
                continue
            try:
                controllers[name] = self._ready(name)
            except ConfigurationError as error:
                if not entry.trainer or not leave_out:
                    raise
                tell_left_out(error)
        for name, what in agents.items():
            if name not in controllers:
                controllers[name] = load_controller(what, self.task, name)
        return controllers

    def _ready(self, name: str) -> Controller:
        """A controller that needs no training, or the shipped weights, which correct flow linearisation."""
        entry = self.controllers[name]
        if not entry.trainer:
            return load_controller(self.make(name), self.task, name)
        corrected = self.controllers.get(entry.corrects or "")
        ships = entry.kind in SHIPPED_WEIGHTS and corrected and corrected.kind == "flow_linearising"
        if ships and (entry.settings.law or not entry.settings.lstm_cells):  # those for one rig have no memory
            return load_controller(entry.kind, self.task, name)
        raise ConfigurationError(f"{name}: no weights of this kind are shipped; give --agent {name}=PATH")

    def with_gains_of_rig(self) -> "StudySettings":
        """The study on its rig: gains that ship give way to those that serve or come from this one.

        What then equals an earlier controller is left out, and so is one without gains, with a line on standard error.
        """
        if self.task.plant == PlantParameters():
            return self
        controllers: dict[str, ControllerEntry] = {}
        for name, entry in self.controllers.items():
            if entry.kind in CONTROLLERS and ships(entry.kind, entry.settings):
                try:
                    own: Any = shipped(entry.kind, self.task, searched_gains)
                except ConfigurationError as error:
                    tell_left_out(f"{name}: {error}")
                    continue
                entry = entry.changed(settings=own.gains, tune=None)
                if entry in controllers.values():
                    continue
            controllers[name] = entry
        return self.changed(controllers=controllers)

    def with_its_sensors(self) -> "StudySettings":
        """The study without the classical controllers that read an absent sensor, and without what corrects them.

        A line on standard error names each.

        Raises:
            ConfigurationError: no controller is left.
        """
        if all(sensor.fitted for sensor in self.task.sensors.in_order):
            return self
        controllers = {}
        for name, entry in self.controllers.items():
            try:
                if entry.kind in CONTROLLERS:
                    self.make(name)
                elif entry.corrects and entry.corrects not in controllers:
                    raise ConfigurationError(f"corrects {entry.corrects}")
                controllers[name] = entry
            except ConfigurationError as error:
                tell_left_out(f"{name}: {error}")
        if not controllers:
            raise ConfigurationError("no controller works with the sensors of this rig")
        return self.changed(controllers=controllers)


def tell_left_out(what: object) -> None:
    """Name on standard error a controller that takes no part, and why."""
    print(f"hydro: left out: {what}", file=sys.stderr)


def default_study(
    path: Path | None = None,
    task: TaskConfig | str | Path | None = None,
    rig: str | Path | None = None,
    period: str | None = None,
    latency: str | None = None,
) -> StudySettings:
    """The study of a name in ``configs/studies`` or of a file, optionally with another task, rig, period or latency.

    Gains belong to a rig. On another rig every classical controller is therefore tuned first; flow linearisation begins
    with its gains for any rig. Controllers that need absent sensors are left out
    (:meth:`StudySettings.with_its_sensors`).

    Raises:
        ConfigurationError: a file is wrong, or settings contradict each other.
    """
    study = StudySettings.from_yaml(config_file("studies", path or "default"))
    if (task, rig, period, latency) == (None,) * 4:
        return study
    given = study.task if task is None else task
    changes: dict[str, Any] = {"task": timed_task(given, rig, period, latency, "study")}
    if rig is not None:
        changes["title"] = f"{study.title} (rig: {Path(rig).stem})"
        changes["controllers"] = {name: _begun(entry) for name, entry in study.controllers.items()}
    study = study.changed(**changes).with_its_sensors()
    study.check(path or "study")
    return study


def _begun(entry: ControllerEntry) -> ControllerEntry:
    """The entry of a controller for another rig, which tunes it; gains of the paper's rig give way to those for any."""
    if entry.kind not in CONTROLLERS:
        return entry
    gains = CONTROLLERS[entry.kind][1]
    usual = entry.kind != "pid" and entry.settings == gains.model_validate(usual_gains(entry.kind))
    return entry.changed(tune=entry.tune or TuningSettings(), settings=gains() if usual else entry.settings)
