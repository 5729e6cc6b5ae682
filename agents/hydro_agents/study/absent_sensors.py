"""A study on a rig without some sensors: controllers that need them are left out, with the reason."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hydro_agents.controllers.base import ClassicalController
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.task.sensors import SENSORS

if TYPE_CHECKING:
    from hydro_agents.study.settings import ControllerEntry, StudySettings


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
