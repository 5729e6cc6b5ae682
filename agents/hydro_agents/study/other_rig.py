"""A study on another task or rig: gains that are tuned first, and controllers that need a sensor the rig lacks."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hydro_agents.controllers.base import ClassicalController
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_agents.study.settings import ControllerEntry, StudySettings, TuningSettings
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.folders import config_file
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SENSORS


def default_study(
    path: Path | None = None, task: str | Path | None = None, rig: str | Path | None = None
) -> StudySettings:
    """The study of a file or of ``make study``, optionally with another task or rig.

    Gains belong to a rig. On another rig every classical controller is therefore tuned first. Controllers that need
    absent sensors are left out, with one line each on standard error.

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
        changes["controllers"] = {
            name: entry.model_copy(update={"tune": entry.tune or TuningSettings()})
            if entry.kind in CONTROLLERS
            else entry
            for name, entry in study.controllers.items()
        }
    study, notes = without_absent_sensors(study.model_copy(update=changes))
    for note in notes:
        print(f"hydro: {note}", file=sys.stderr)
    study.check("study" if path is None else str(path))
    return study


def without_absent_sensors(study: StudySettings) -> tuple[StudySettings, list[str]]:
    """The part of a study that works with the sensors of its task.

    A classical controller that reads an absent sensor is left out. A policy that corrects such a controller corrects
    the last classical one before it instead. The leakage head needs all sensors.

    Args:
        study: the study.

    Returns:
        The study, and one line per change; the study itself if the rig lacks no sensor.

    Raises:
        ConfigurationError: no controller is left.
    """
    absent = [name for name in SENSORS if not getattr(study.task.sensors, name).fitted]
    if not absent:
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
            entry = _correcting(entry, others[-1], CONTROLLERS[kept[others[-1]].kind][0])
        kept[name] = entry
    if not kept:
        raise ConfigurationError(f"no controller works with the sensors of this rig: {notes[0]}")
    changes: dict[str, Any] = {"controllers": kept}
    if study.leakage_head is not None:
        notes.append(f"no leakage head: it reads {', '.join(absent)}, but this rig has no such sensor")
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
    estimates = entry.settings.get("see_estimates", False) and hasattr(controller, "estimate_names")
    settings = entry.settings | ({"see_estimates": estimates} if "see_estimates" in entry.settings else {})
    return entry.model_copy(update={"corrects": base, "settings": settings})
