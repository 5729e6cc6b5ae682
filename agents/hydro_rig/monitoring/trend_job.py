"""The whole job of ``hydro trend``: which files are new, their rows, table and page, and the lines for the user."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from time import time
from typing import Any, NamedTuple

import pandas as pd

from hydro_agents.detection.sheet import leak_scale
from hydro_agents.report.page import FIGURE_FILES
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import Job, Report, answers_of
from hydro_agents.running.machine import Origin
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.folders import config_file
from hydro_env.task.configuration import task_config
from hydro_rig.monitoring.oil import Oil, temperature_range
from hydro_rig.monitoring.trend import Settings, read_row
from hydro_rig.monitoring.trend_page import render_trend
from hydro_rig.monitoring.trend_summary import AxisTrend, exit_code, trends_of
from hydro_rig.monitoring.trend_table import File, files_of, read_table, unread, with_rows, write_table
from hydro_rig.recordings.columns import maps_of
from hydro_rig.recordings.files import read_columns
from hydro_rig.recordings.recording import map_for

USUAL_LIMIT = 0.3  # l/min at 100 bar and 40 °C, of the default rig


class Watch(NamedTuple):
    """What the user asks for; texts as on the command line."""

    table: Path
    maps: Sequence[str] = ()
    task: str | None = None
    rigs: Sequence[str] = ()  # [AXIS=]FILE
    oil: str = "46"
    temperature: str = "20..60"
    limit: float | None = None


class Watched(NamedTuple):
    """What was done and found."""

    trends: list[AxisTrend]  # the most urgent first
    read: int  # files that were read now
    known: int  # files that were in the table already
    left_out: list[str]  # one line per file that cannot be read
    ignored: str  # what else the folders hold; empty: nothing
    notes: list[str]  # about clocks
    table: Path
    page: Path

    @property
    def exit_code(self) -> int:
        """Of the most serious state of an axis."""
        return exit_code([one.state for one in self.trends])

    def lines(self) -> list[str]:
        """For a person."""
        done = f"{self.read} files read, {self.known} known, {len(self.left_out)} left out"
        return [*self.notes, *(one.line() for one in self.trends), f"{self.table}: {done}", str(self.page)]

    def json(self) -> dict[str, Any]:
        """For another program."""
        return {
            "exit_code": self.exit_code,
            "axes": [one.json() for one in sorted(self.trends, key=lambda one: one.axis)],
            "files": {name: getattr(self, name) for name in ("read", "known", "left_out", "ignored")},
            "notes": self.notes,
            "table": str(self.table),
            "page": str(self.page),
        }


def watch(places: Sequence[Path], how: Watch, command: str = "", progress: Report | None = None) -> Watched:
    """Read the files that the table does not hold, and write table and page.

    Args:
        places: folders and files.
        how: settings.
        command: for the page.
        progress: called when a file is finished.

    Raises:
        ConfigurationError: a setting is impossible, no file can be read, or the folder cannot be written.
        KeyboardInterrupt: Ctrl-C; the table holds the finished files.
    """
    settings = Settings(Oil.of(how.oil), temperature_range(how.temperature))
    folder = how.table.parent
    files, ignored = files_of(places, how.table)
    table = read_table(how.table)
    maps = dict(zip(files, maps_of(how.maps, [file.path for file in files]), strict=True))
    configs = _configs(how, {file.axis for file in files} | set(table["axis"]))
    new = {file.name: file for file in unread(files, table)}
    page, left_out = folder / f"{how.table.stem}.html", dict[str, str]()
    with output_folder(folder, "trend", (page.name, FIGURE_FILES), resume=True):
        jobs = {
            name: Job(read_row, None, (str(file.path.absolute()), file.axis, configs[file.axis], maps[file], settings))
            for name, file in new.items()
        }
        report = progress or (lambda phase, done, total: None)
        if new:
            report("files", 0, len(new))
        with closing(answers_of(jobs, None)) as answers:
            for done, (name, result) in enumerate(answers, 1):
                if result.error:
                    left_out[name] = result.error
                else:
                    table = with_rows(table, new[name], result.metrics, settings.oil)
                    write_table(how.table, table)
                report("files", done, len(new))
        if table.empty:
            first = next(iter(new.values()))
            _tell_why(first, maps[first] is None, [*left_out.values()])
        newest = {file.axis: file.name for file in sorted(files, key=lambda file: file.changed)}
        errors = {axis: left_out[name] for axis, name in newest.items() if name in left_out}
        limits = {axis: how.limit or USUAL_LIMIT * leak_scale(config) for axis, config in configs.items()}
        found = trends_of(table, limits, settings.oil, settings.between, errors, time())
        trends, lines = sorted(found, key=lambda one: one.urgency), [*left_out.values()]
        shown = [*filter(None, [*lines, ignored])]
        render_trend(trends, how.table.name, shown, Origin.now(command)).write(page)
    read, known = len(new) - len(lines), len(files) - len(new)
    return Watched(trends, read, known, lines, ignored, _clocks(table), how.table, page)


def _configs(how: Watch, axes: set[str]) -> dict[str, TaskConfig]:
    """The task of each axis, with its own rig."""
    own: dict[str, Path] = {}
    for text in how.rigs:
        axis, _, file = text.rpartition("=")
        if axis and axis not in axes:
            raise ConfigurationError(f"--rig {text}: axis '{axis}': known: {', '.join(sorted(axes)[:20])}")
        own[axis] = config_file("rigs", Path(file))
    made = {name: task_config(how.task, rig=path) for name, path in own.items()}
    usual = made.get("") or task_config(how.task)
    return {axis: made.get(axis, usual) for axis in axes}


def _tell_why(first: File, guessed: bool, left_out: Sequence[str]) -> None:
    """No file could be read: the error of the first, with a guessed map if its headings are unknown."""
    if guessed:
        map_for(read_columns(first.path), os.fspath(first.path))
    more = f" (and {len(left_out) - 1} more files)" if len(left_out) > 1 else ""
    raise ConfigurationError(f"{left_out[0]}{more}")


def _clocks(table: pd.DataFrame) -> list[str]:
    """A line for each recording that begins before the end of the one before it, by the clock of the machine."""
    lines = []
    for axis, rows in table.groupby("axis", sort=True):
        rows = rows.sort_values("time", kind="stable")
        early = rows["time"] < rows["until"].cummax().shift(fill_value="")
        lines += [
            f"{axis}: {row['file']} begins at {row['time']}, before the file before it ends: a clock ran back"
            for row in rows[early].to_dict("records")
        ]
    jumped = table[table["clock_back"] > 0.0]
    return lines + [f"{row['axis']}: {row['file']}: {row['reason']}" for row in jumped.to_dict("records")]
