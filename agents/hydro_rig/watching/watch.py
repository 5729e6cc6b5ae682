"""The whole job of ``hydro trend``: reads the files that are new, writes table and page, and says what they tell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from time import monotonic, time
from typing import Any, NamedTuple

from joblib import Parallel, delayed

from hydro_env import ConfigurationError
from hydro_rig.estimation.progress import tell
from hydro_rig.watching.fleet import Axis, Fleet
from hydro_rig.watching.reading import row_of_file
from hydro_rig.watching.table import File, files_of, read_table, with_row, write_table
from hydro_rig.watching.trend import CODES, SERIOUS, AxisTrend, trend_of

WRITE_EVERY = 5.0  # s; a killed call reads at most the files of so long a time again


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


def watch(places: Sequence[Path], table_file: Path, fleet: Fleet, jobs: int = 1) -> Watched:
    """Read the files that the table does not hold, and write the table.

    Args:
        places: folders and files; none: the table alone tells, as ``hydro watch`` writes it.
        table_file: the table, a CSV file.
        fleet: the axes. A file of one that it does not name is left out; one that it names is never left out.
        jobs: files that are read side by side.

    Raises:
        ConfigurationError: no file can be read, nothing was ever read, or the table cannot be written.
        KeyboardInterrupt: Ctrl-C; the table holds the finished files.
    """
    files, others = files_of(places, table_file)
    table = read_table(table_file)
    known = dict(zip(table["file"], table["bytes"], strict=True))
    new = [file for file in files if known.get(file.name) != file.size]
    errors = {file.name: why for file in new if (why := fleet.missing(file.axis))}
    readable = [file for file in new if file.name not in errors]
    rows = Parallel(jobs, return_as="generator")(
        delayed(_row_or_error)(file, fleet.axis(file.axis)) for file in readable
    )
    stored, written = table, monotonic()
    try:
        for done, (file, row) in enumerate(zip(readable, rows, strict=True), 1):
            if isinstance(row, str):
                errors[file.name] = row
            else:
                table = with_row(table, file, row)
            if monotonic() - written > WRITE_EVERY:
                write_table(table_file, table)
                stored, written = table, monotonic()
            tell("files", done, len(readable))
    finally:
        if table is not stored:
            write_table(table_file, table)
    if table.empty:
        raise ConfigurationError(next(iter(errors.values()), f"{table_file}: holds no reading"))
    newest = {
        file.axis: errors.get(file.name, "") for file in sorted(files, key=lambda file: file.path.stat().st_mtime)
    }
    trends = []
    for name in {*newest, *table["axis"], *fleet.named}:
        error = newest.get(name, "")
        trends.append(trend_of(name, table[table["axis"] == name], fleet.axis(name), error, time()))
    trends.sort(key=lambda one: (*one.urgency, one.axis))
    left_out = [*dict.fromkeys(errors.values()), *filter(None, [others])]
    return Watched(trends, len(new) - len(errors), len(files) - len(new), left_out)


def _row_or_error(file: File, axis: Axis) -> dict[str, Any] | str:
    """The row of a file, or why it cannot be read."""
    try:
        return row_of_file(file.path, axis)
    except ConfigurationError as error:
        return str(error)
