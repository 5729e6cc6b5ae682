"""The whole job of ``hydro trend``: reads the files that are new, writes table and page, and says what they tell."""

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import monotonic, time
from typing import NamedTuple

from joblib import Parallel, delayed

from hydro_agents.detection.detector import Windows
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.types import ByName
from hydro_rig.diagnosis.diagnose import diagnosed, read_windows
from hydro_rig.diagnosis.oil import Oil
from hydro_rig.diagnosis.verdict import NO_LEAK
from hydro_rig.estimation.solver import tell, told_to
from hydro_rig.recordings.findings import Weight, lines_of
from hydro_rig.recordings.parts import liveliest
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import Sampled, cut
from hydro_rig.watching.fleet import Axis, Fleet
from hydro_rig.watching.table import SIZES, File, files_of, read_table, with_row, write_table
from hydro_rig.watching.trend import CODES, SERIOUS, AxisTrend, trend_of

MOST_WINDOWS = 12  # of a reading; more take longer and add little
WINDOW = 2.0  # s
SECTION = 300.0  # s of a recording, which gives one of them
FIRST_DATE, LAST_DATE = 1e9, 4e9  # s since 1970 that a stamp is taken for: the years 2001 to 2096
_DATE = re.compile(r"(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)(?:[T_ -]?(\d\d)[-_:.]?(\d\d)(?:[-_:.]?(\d\d))?)?(?!\d)")
WRITE_EVERY = 5.0  # s; a killed call reads at most the files of so long a time again


def row_of_file(path: Path, axis: Axis) -> ByName:
    """The row of a file: its first and last stamp (s since 1970), and what :func:`row_of` reads.

    Raises:
        ConfigurationError: the file cannot be read, or holds no rows.
    """
    rows = read_recording(path, axis.columns)
    clock = 0.0 if FIRST_DATE <= rows.begin <= LAST_DATE else _began(path) - rows.begin
    last = rows.begin + rows.time[-1]
    return {"time": clock + rows.begin, "until": clock + last, **row_of(rows, axis.task, axis.oil)}


def _began(path: Path) -> float:
    """s since 1970 by the name of a file, or by its age."""
    found = _DATE.search(path.name)
    if found:
        with suppress(ValueError):  # the 45th of a month
            return datetime(*(int(part or 0) for part in found.groups()), tzinfo=UTC).timestamp()  # type: ignore[arg-type,misc]
    return path.stat().st_mtime


def row_of(recording: Recording, config: TaskConfig, oil: Oil, most: int = MOST_WINDOWS) -> ByName:
    """Verdict, leak at 40 °C and oil temperature of a recording, from its liveliest windows and a measured flow."""

    def choose(samples: Sampled) -> Windows:
        windows = cut(samples, round(WINDOW / samples.period))
        return windows.part(liveliest(windows, most, SECTION))

    with told_to(None):  # a file is one step of the progress
        found = diagnosed(recording, config, choose, partial(read_windows, threads=1), oil)
    verdict = found.verdict
    told = [one for one in found.checked.findings if one.weight is Weight.FAULT or one.signal == "oil_temperature"]
    return {
        "verdict": verdict.kind.value,
        "reason": "; ".join(dict.fromkeys(filter(None, [verdict.why, *lines_of(told)]))),
        "temperature": found.temperature,
        **dict(zip(SIZES, verdict.leak or NO_LEAK, strict=True)),
    }


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

    def facts(self) -> ByName:
        """For another program."""
        axes = [one.facts() for one in self.trends]
        files = {"read": self.read, "known": self.known, "left_out": self.left_out}
        return {"exit_code": self.exit_code, "axes": axes, "files": files}


def watch(places: Sequence[Path], table_file: Path, fleet: Fleet, jobs: int = 1) -> Watched:
    """Read the files of folders that the table does not hold, ``jobs`` side by side, and write the table.

    Without places the table alone tells, as ``hydro watch`` writes it. A file of an axis that the fleet does not name
    is left out; an axis that it names is never left out.

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
    files.sort(key=lambda file: file.path.stat().st_mtime)
    newest = {file.axis: errors.get(file.name, "") for file in files}
    trends = [
        trend_of(name, table[table["axis"] == name], fleet.axis(name), newest.get(name, ""), time())
        for name in {*newest, *table["axis"], *fleet.named}
    ]
    trends.sort(key=lambda one: (*one.urgency, one.axis))
    left_out = [*dict.fromkeys(errors.values()), *filter(None, [others])]
    return Watched(trends, len(new) - len(errors), len(files) - len(new), left_out)


def _row_or_error(file: File, axis: Axis) -> ByName | str:
    try:
        return row_of_file(file.path, axis)
    except ConfigurationError as error:
        return str(error)
