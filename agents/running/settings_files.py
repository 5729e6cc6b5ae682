"""Parts of a YAML file that stand in files of their own: its task, and the settings of its controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydro_env import TaskConfig
from hydro_env.files import read_yaml
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import task_from


def read_task(given: Any, file: Path) -> Any:
    """The task that a YAML file gives: a name in ``configs/tasks``, a path, or a group whose ``plant`` is a rig's.

    Paths are relative to the file. Anything else is returned as it is.

    Raises:
        ConfigurationError: no such task or rig, unreadable file, unknown key or impossible value.
    """
    if isinstance(given, str):
        return task_config(given, folder=file.parent)
    if isinstance(given, dict) and isinstance(given.get("plant"), str):
        return task_from(TaskConfig, given, f"{file}: task", file.parent)
    return given


def read_settings(controllers: Any, file: Path) -> dict[str, str]:
    """Replace each controller's ``settings`` that are the path of a YAML file, relative to ``file``, by its content.

    Returns:
        The files that were read, by the controller's name.

    Raises:
        ConfigurationError: a file cannot be read.
    """
    sources = {}
    for name, entry in controllers.items() if isinstance(controllers, dict) else ():
        if isinstance(entry, dict) and isinstance(entry.get("settings"), str):
            sources[name] = str(file.parent / entry["settings"])
            entry["settings"] = read_yaml(sources[name])
    return sources
