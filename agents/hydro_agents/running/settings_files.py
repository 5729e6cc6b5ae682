"""Parts of a YAML file that are separate files: its task, and the settings of its controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import read_yaml
from hydro_env.mistakes import kept, refuse
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import task_from


def read_task(given: Any, file: Path) -> Any:
    """The task of a YAML file: a name in ``configs/tasks``, a path, or a group whose ``plant`` names a rig.

    Paths are relative to the file. Anything else is returned unchanged.

    Raises:
        ConfigurationError: the task or rig does not exist, the file is unreadable, a key is unknown, or a value is
            impossible.
    """
    if isinstance(given, str):
        return task_config(given, folder=file.parent)
    if isinstance(given, dict) and isinstance(given.get("plant"), str):
        return task_from(TaskConfig, given, str(file), file.parent, within="task")
    return given


def read_settings(controllers: Any, file: Path) -> dict[str, str]:
    """Replace each controller's ``settings`` by the content of a YAML file, if they are its path relative to ``file``.

    Returns:
        The files that were read, by the controller's name.

    Raises:
        ConfigurationError: a file cannot be read.
    """
    sources = {}
    errors: list[ConfigurationError] = []
    for name, entry in controllers.items() if isinstance(controllers, dict) else ():
        if isinstance(entry, dict) and isinstance(entry.get("settings"), str):
            sources[name] = str(file.parent / entry.pop("settings"))
            with kept(errors):
                entry["settings"] = read_yaml(sources[name])
    refuse(errors, str(file))
    return sources
