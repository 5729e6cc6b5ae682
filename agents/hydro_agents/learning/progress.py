"""The log of a training: stable-baselines3's logger to ``progress.csv``, and to TensorBoard if it is installed."""

from __future__ import annotations

import math
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat, filter_excluded_keys

from hydro_env.files import write_text

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
        self._write()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        """Append a row."""
        values = filter_excluded_keys(key_values, key_excluded, "csv")
        self._rows.append({STEPS: step, **{key: float(values[key]) for key in sorted(values) if key != STEPS}})
        self._write()

    def close(self) -> None:
        """Do nothing: the file is closed after each row."""

    def _write(self) -> None:
        table = pd.DataFrame(self._rows).convert_dtypes()  # whole numbers without a decimal point
        write_text(self._path, table.to_csv(index=False, lineterminator="\n") if self._rows else "")


def read_progress(path: str | Path, steps: float = math.inf) -> list[Row]:
    """The rows of ``progress.csv`` up to a number of steps; an empty field is NaN.

    A damaged file is left out with a warning: no result depends on the log.
    """
    try:
        table = pd.read_csv(path, index_col=False, dtype=str).astype(float)
        rows: list[Row] = table[table[STEPS] <= steps].to_dict("records")
    except pd.errors.EmptyDataError:
        return []
    except (OSError, ValueError, KeyError) as error:
        warnings.warn(f"{path}: is no log of a training ({type(error).__name__}): left out", stacklevel=2)
        return []
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
