"""The whole job of ``hydro trend``: reads the files that are new, writes table and page, and says what they tell."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from time import time
from typing import Any, NamedTuple

from joblib import Parallel, delayed

from hydro_agents.detection.sheet import leak_scale
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import write_text
from hydro_env.folders import config_file
from hydro_env.task.configuration import task_config
from hydro_rig.estimation.progress import tell
from hydro_rig.recordings.columns import ColumnMap, maps_of
from hydro_rig.watching.oil import Oil
from hydro_rig.watching.reading import row_of_file
from hydro_rig.watching.table import File, files_of, read_table, with_row
from hydro_rig.watching.trend import CODES, SERIOUS, AxisTrend, trend_of

USUAL_LIMIT = 0.3  # l/min at 100 bar and 40 °C, of the default rig


class Watched(NamedTuple):
    """What was done and found."""

    trends: list[AxisTrend]  # the most urgent first
    read: int  # files that were read now
    known: int  # files that were in the table already
    left_out: list[str]  # one line per file that cannot be read, and one on what else the folders hold

    @property
    def exit_code(self) -> int:
        """Of the most serious state of an axis."""
        return CODES[min((one.states[0] for one in self.trends), key=SERIOUS)]

    def facts(self) -> dict[str, Any]:
        """For another program."""
        axes = [one.facts() for one in self.trends]
        files = {"read": self.read, "known": self.known, "left_out": self.left_out}
        return {"exit_code": self.exit_code, "axes": axes, "files": files}


def watch(
    places: Sequence[Path],
    table_file: Path,
    maps: Sequence[str] = (),
    task: str | None = None,
    rigs: Sequence[str] = (),
    oil: str = "46",
    limit: float | None = None,
    jobs: int = 1,
) -> Watched:
    """Read the files that the table does not hold, and write the table.

    Args:
        places: folders and files.
        table_file: the table, a CSV file.
        maps: of the columns, ``[PATTERN=]FILE``.
        task: of all axes.
        rigs: ``[AXIS=]FILE``.
        oil: see :meth:`Oil.of`.
        limit: leak whose date is told, l/min at 100 bar and 40 °C; default: 0.3, scaled with the flow of the rig.
        jobs: files that are read side by side.

    Raises:
        ConfigurationError: a setting is impossible, no file can be read, or the table cannot be written.
        KeyboardInterrupt: Ctrl-C; the table holds the finished files.
    """
    filling = Oil.of(oil)
    files, others = files_of(places, table_file)
    table = read_table(table_file)
    maps_by_name = dict(zip(files, maps_of(maps, [file.path for file in files]), strict=True))
    configs = _configs(task, rigs, {file.axis for file in files} | set(table["axis"]))
    known = dict(zip(table["file"], table["bytes"], strict=True))
    new = [file for file in files if known.get(file.name) != file.size]
    reading = [delayed(_row_or_error)(file, configs[file.axis], maps_by_name[file], filling) for file in new]
    errors: dict[str, str] = {}
    for done, (file, row) in enumerate(zip(new, Parallel(jobs, return_as="generator")(reading), strict=True), 1):
        if isinstance(row, str):
            errors[file.name] = row
        else:
            table = with_row(table, file, row)
            write_text(table_file, table.to_csv(index=False, lineterminator="\n"))
        tell("files", done, len(new))
    if table.empty:
        raise ConfigurationError(errors[new[0].name])
    newest = {
        file.axis: errors.get(file.name, "") for file in sorted(files, key=lambda file: file.path.stat().st_mtime)
    }
    trends = []
    for axis in sorted(configs):
        own, error = limit or USUAL_LIMIT * leak_scale(configs[axis]), newest.get(axis, "")
        rows = table[table["axis"] == axis]
        if error or len(rows):
            trends.append(trend_of(axis, rows, own, filling, error, time()))
    trends.sort(key=lambda one: one.urgency)
    left_out = [*errors.values(), *filter(None, [others])]
    return Watched(trends, len(new) - len(errors), len(files) - len(new), left_out)


def _row_or_error(file: File, config: TaskConfig, columns: ColumnMap | None, oil: Oil) -> dict[str, Any] | str:
    """The row of a file, or why it cannot be read."""
    try:
        return row_of_file(file.path, config, columns, oil)
    except ConfigurationError as error:
        return str(error)


def _configs(task: str | None, rigs: Sequence[str], axes: Collection[str]) -> dict[str, TaskConfig]:
    """The task of each axis, with its own rig."""
    own = task_of(task, rigs)
    for text in rigs:
        axis = text.rpartition("=")[0]
        if axis and axis not in axes:
            raise ConfigurationError(f"--rig {text}: axis '{axis}': known: {', '.join(sorted(axes)[:20])}")
    return {axis: own(axis) for axis in axes}


def task_of(task: str | None, rigs: Sequence[str]) -> Callable[[str], TaskConfig]:
    """The task of an axis by its name, from ``[AXIS=]FILE``."""
    made: dict[str, TaskConfig] = {}
    for text in rigs:
        axis, _, file = text.rpartition("=")
        made[axis] = task_config(task, rig=config_file("rigs", Path(file)))
    usual = made.get("") or task_config(task)
    return lambda axis: made.get(axis, usual)
