"""The log of a training: stable-baselines3's logger to ``progress.csv``, and to TensorBoard if it is installed."""

from __future__ import annotations

import csv
import math
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat, filter_excluded_keys

from hydro_env.files import write_whole

PROGRESS_FILE = "progress.csv"
STEPS = "time/total_timesteps"
Row = dict[str, float]


@dataclass(frozen=True)
class Progress:
    """Progress of a training."""

    steps: int
    total_steps: int
    seconds: float  # duration of training, all sessions together
    mean_reward: float  # per control period, over the last episodes; NaN before the first one has ended


class ProgressFile(KVWriter):
    """``progress.csv``: one row per update, written immediately; a resumed training continues the file.

    Args:
        path: path of the file.
        steps: number of steps at the checkpoint; later rows are dropped, because they come from a training that was
            killed before its next checkpoint.

    Raises:
        ConfigurationError: the file cannot be written.
    """

    def __init__(self, path: Path, steps: int = 0) -> None:
        self._path = path
        self._rows = read_progress(path, steps) if steps > 0 and path.exists() else []
        self._columns: list[str] = list(self._rows[0]) if self._rows else []
        self._rewrite()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append a row."""
        values = filter_excluded_keys(key_values, key_excluded, "csv")
        row = {STEPS: float(step), **{key: float(values[key]) for key in sorted(values) if key != STEPS}}
        self._rows.append(row)
        new = [key for key in row if key not in self._columns]
        if new:
            self._columns += new
            self._rewrite()
            return
        with self._path.open("a", encoding="utf-8", newline="") as file:
            file.write(self._line(row))

    def close(self) -> None:
        """Do nothing: the file is closed after each row."""

    def _line(self, row: Row) -> str:
        return ",".join(_text(row.get(key, math.nan)) for key in self._columns) + "\n"

    def _rewrite(self) -> None:
        lines = [",".join(self._columns) + "\n", *map(self._line, self._rows)] if self._columns else []
        write_whole(self._path, "".join(lines).encode())


def _text(value: float) -> str:
    return "" if math.isnan(value) else str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


def read_progress(path: str | Path, steps: float = math.inf) -> list[Row]:
    """The rows of ``progress.csv`` up to a number of steps; an empty field is NaN, an incomplete last line is skipped.

    A damaged line is left out with a warning: no result depends on the log.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, UnicodeDecodeError) as error:
        warnings.warn(f"{path}: {getattr(error, 'strerror', None) or 'not a text file'}: left out", stacklevel=2)
        return []
    rows: list[Row] = []
    whole = [line for line in lines if line.endswith("\n")]
    columns = next(csv.reader(whole[:1]), [])
    if columns and (STEPS not in columns or len(set(columns)) < len(columns)):
        warnings.warn(f"{path}: line 1 does not name the columns of a training: left out", stacklevel=2)
        return []
    for number, line in enumerate(whole[1:], start=2):
        if rows and rows[-1][STEPS] >= steps:
            break
        try:
            fields = next(csv.reader([line]))
            row = {name: float(field or "nan") for name, field in zip(columns, fields, strict=True)}
        except (ValueError, StopIteration, csv.Error):
            warnings.warn(f"{path}: line {number} does not hold {len(columns)} numbers: left out", stacklevel=2)
            continue
        if not row[STEPS] <= steps:
            break
        rows.append(row)
    return rows


def training_logger(folder: Path | None, steps: int = 0) -> Logger:
    """A logger for ``model.set_logger`` that writes to a folder, or nowhere; ``steps`` of a resumed training are done.

    Raises:
        ConfigurationError: ``progress.csv`` cannot be written.
    """
    writers: list[KVWriter] = []
    if folder is not None:
        writers.append(ProgressFile(folder / PROGRESS_FILE, steps))
        with suppress(AssertionError):  # TensorBoard may not be installed
            writers.append(TensorBoardOutputFormat(str(folder)))
    return Logger(None if folder is None else str(folder), writers)
