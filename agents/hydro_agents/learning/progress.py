"""The log of a training (``progress.csv``, and TensorBoard if it is installed), and errors on validation plants."""

from __future__ import annotations

import csv
import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat, filter_excluded_keys

from hydro_agents.controllers.base import Controller
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import LEARNING_CURVE, SCALES
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import write_whole


def validation_cases(config: TaskConfig) -> Cases:
    """One plant for each family of references at three leaks: healthy, incipient, and the largest of the task."""
    leakage = config.leakage
    leaks = (math.sqrt(math.prod(leakage.healthy_range)), leakage.class_bounds[1], leakage.faulty_range[1])
    families = [name for name, weight in config.references.weights.items() if weight > 0.0]
    grid = [(leak, family) for leak in leaks for family in families]
    seeds = np.array(LEARNING_CURVE.take(len(grid)))
    return Cases(seeds, np.array([leak for leak, _ in grid]), np.array([family for _, family in grid]))


def validation_errors(config: TaskConfig, controller: Controller) -> tuple[float, float, int]:
    """Mean absolute tracking error over all cases (mm), that of the worst case (mm), and number of failed cases."""
    run = run_cases(config, controller, validation_cases(config))
    errors = 1e3 * np.abs(run.position - run.reference).mean(axis=1)
    return float(errors.mean()), float(errors.max()), int((run.failed_at >= 0).sum())


def family_errors(config: TaskConfig, controller: Controller, plants: int = 16) -> dict[str, float]:
    """Mean absolute tracking error (m) of a controller in each family of references, on training plants."""
    families = [name for name, weight in config.references.weights.items() if weight > 0.0]
    seeds = np.tile(np.array(SCALES.take(plants, SCALES.count - plants)), len(families))
    run = run_cases(config, controller, Cases(seeds, families=np.repeat(families, plants)))
    errors = np.abs(run.position - run.reference).mean(axis=1).reshape(len(families), plants).mean(axis=1)
    return dict(zip(families, errors.tolist(), strict=True))


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
        ConfigurationError: the file is damaged or cannot be written.
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

    Raises:
        ConfigurationError: the file cannot be read, or a row is damaged.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise ConfigurationError(f"{path}: cannot be read: {reason}") from None
    rows: list[Row] = []
    whole = [line for line in lines if line.endswith("\n")]
    columns = next(csv.reader(whole[:1]), [])
    if columns and (STEPS not in columns or len(set(columns)) < len(columns)):
        raise ConfigurationError(f"{path}: line 1: must name the columns of a training, {STEPS} among them")
    for number, line in enumerate(whole[1:], start=2):
        if rows and rows[-1][STEPS] >= steps:
            break
        try:
            fields = next(csv.reader([line]))
            row = {name: float(field or "nan") for name, field in zip(columns, fields, strict=True)}
        except (ValueError, StopIteration, csv.Error):
            raise ConfigurationError(
                f"{path}: line {number}: must hold {len(columns)} numbers: {line.strip()[:40]!r}"
            ) from None
        if not row[STEPS] <= steps:
            break
        rows.append(row)
    return rows


def training_logger(folder: Path | None, steps: int = 0) -> Logger:
    """A logger for ``model.set_logger`` that writes to a folder, or nowhere.

    Args:
        folder: for ``progress.csv`` and the event files of TensorBoard.
        steps: number of steps that a resumed training has already done.

    Raises:
        ConfigurationError: ``progress.csv`` is damaged or cannot be written.
    """
    writers: list[KVWriter] = []
    if folder is not None:
        writers.append(ProgressFile(folder / PROGRESS_FILE, steps))
        with suppress(AssertionError):  # TensorBoard may not be installed
            writers.append(TensorBoardOutputFormat(str(folder)))
    return Logger(None if folder is None else str(folder), writers)
