"""The axes of a fleet: the rig, the map of the columns, the oil and the limit of each, from one YAML file.

``hydro trend`` and ``hydro watch`` read the same file; ``hydro new-rig --table`` writes one beside its rigs.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self

from pydantic import Field

from hydro_agents.detection.sheet import leak_scale
from hydro_env import ConfigurationError, TaskConfig, task_config
from hydro_env.errors import at
from hydro_env.files import Group, read_yaml, validate
from hydro_env.folders import config_file
from hydro_rig.diagnosis.oil import Oil
from hydro_rig.recordings.columns import ColumnMap, read_map

USUAL_LIMIT = 0.3  # l/min at 100 bar and 40 °C, of the default rig


class AxisSettings(Group):
    """One axis; paths are relative to the file that names it."""

    task: str | None = None  # name in `configs/tasks`, or a file
    rig: str | None = None  # name in `configs/rigs`, or a file; default: the paper's
    map: str | None = None  # file that maps the columns
    oil: str | float = "46"  # ISO VG grade, or mm²/s at 40 and 100 °C such as 46/8.1
    # Leak that is too much, l/min at 100 bar and 40 °C; default: by the rig
    limit: float | None = Field(None, ge=1e-3, le=100.0)


class FleetSettings(AxisSettings):
    """All axes; what stands beside ``axes`` holds for those that do not say otherwise."""

    axes: dict[str, AxisSettings] = Field(min_length=1)  # by name


class Axis(NamedTuple):
    """What is known about an axis before its first reading."""

    task: TaskConfig  # on its rig
    columns: ColumnMap | None  # None: the names that ``hydro record`` writes
    oil: Oil
    limit: float  # l/min at 100 bar and 40 °C

    @classmethod
    def of(cls, settings: AxisSettings, folder: Path = Path()) -> Self:
        """From its settings; ConfigurationError: a file is missing or wrong, or the oil is impossible."""
        rig = None if settings.rig is None else config_file("rigs", settings.rig, folder)
        task = task_config(settings.task, rig=rig, folder=folder)
        columns = None if settings.map is None else read_map(folder / settings.map)
        oil = settings.oil if isinstance(settings.oil, str) else f"{settings.oil:g}"
        return cls(task, columns, Oil.of(oil), settings.limit or USUAL_LIMIT * leak_scale(task))


class Fleet(NamedTuple):
    """The axes by name."""

    usual: Axis  # of an axis without a name here
    named: Mapping[str, Axis] = {}
    source: str = ""  # the file that names them; empty: every axis is the usual one

    @classmethod
    def load(cls, path: Path) -> Self:
        """From a file; ConfigurationError: the file, or one that it names, is missing or wrong."""
        settings = validate(FleetSettings, read_yaml(path), path)
        usual = settings.model_dump(exclude={"axes"}, exclude_unset=True)
        axes = {}
        for name, own in settings.axes.items():
            whole = usual | own.model_dump(exclude_unset=True)
            with at(f"{path}: axes.{name}"):
                axes[name] = Axis.of(AxisSettings(**whole), path.parent)
        return cls(next(iter(axes.values())), axes, str(path))

    @classmethod
    def of(cls, file: Path | None, **settings: Any) -> Self:
        """From a file, or without one from the settings of all axes.

        Raises:
            ConfigurationError: both are given, or one is wrong.
        """
        given = {
            name: str(value) if isinstance(value, Path) else value
            for name, value in settings.items()
            if value is not None
        }
        if not file:
            return cls(Axis.of(AxisSettings(**given)))
        if given:
            raise ConfigurationError(f"--fleet {file}: holds {', '.join(given)} itself; leave the options out")
        return cls.load(file)

    def missing(self, name: str) -> str:
        """Why an axis cannot be read: the file does not name it; empty: it can."""
        if name in self.named or not self.source:
            return ""
        return f"axis '{name[:60]}' is not in {self.source}, which names {', '.join(list(self.named)[:20])}"

    def axis(self, name: str) -> Axis:
        """An axis by its name."""
        return self.named.get(name, self.usual)
