"""``hydro record``: a recording of a simulated axis with the signals of a rig."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import measured_run
from hydro_agents.running.cases import Cases
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import write_text
from hydro_env.types import Array, Floats
from hydro_rig.recordings.columns import MEASURED, factor

WRITTEN_UNITS = {
    "time": "s",
    "position": "mm",
    "pressure_a": "bar",
    "pressure_b": "bar",
    "spool_position": "%",
    "command": "V",
}

_FORMAT = "%.7g"  # digits for the 16-bit steps of every sensor
LONGEST_RECORDING = 3600.0  # s


class Recorded(NamedTuple):
    """Summary of a recording."""

    rows: int
    duration: float  # s
    leakage_flow_lpm: float  # at the end
    failed_at: float | None  # s, time of the failure, where the recording ends; None: no failure


def record_axis(
    path: Path,
    config: TaskConfig,
    controller: Controller,
    seed: int,
    leakage_flow_lpm: float | None = None,
    family: str | None = None,
    faults: Mapping[str, float] | None = None,
    note: str = "",
) -> Recorded:
    """Run one episode and write its measured signals as CSV, one row per control period.

    The command of a row acts when the row is measured. ``episode_duration`` of the task is that of the recording, the
    seed that of plant, reference and noise. The leak, l/min at 100 bar, and the ``family`` of the reference are drawn
    if they are ``None``; ``faults``: magnitude by name (:data:`hydro_env.task.faults.FAULTS`). An old file is replaced;
    its first line is the ``note``.

    Raises:
        ConfigurationError: an option is impossible, or the file cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_rig.recordings.simulated import record_axis
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig(episode_duration=1.0)
        >>> record_axis(Path("axis.csv"), task, shipped("pid", task), seed=1, leakage_flow_lpm=0.5)
        Recorded(rows=200, duration=1.0, leakage_flow_lpm=0.5, failed_at=None)
    """
    if config.episode_duration > LONGEST_RECORDING:
        raise ConfigurationError(f"--duration = {config.episode_duration:g} s: must be at most {LONGEST_RECORDING:g} s")
    cases = Cases(
        np.array([seed]),
        None if leakage_flow_lpm is None else np.array([leakage_flow_lpm]),
        None if family is None else np.array([family]),
        faults={name: np.array([size]) for name, size in (faults or {}).items()},
    )
    signals, run = measured_run(config, controller, cases)
    failed = run.failed_at[0] >= 0
    rows = run.failed_at[0] + 1 if failed else config.steps
    duration = rows * config.control_period
    write_text(path, recording_csv(np.arange(rows) * config.control_period, signals[0, :, :rows], note))
    return Recorded(rows, duration, float(run.leakage_flow_lpm[0]), duration if failed else None)


def recording_csv(time: Array, signals: Floats, note: str = "") -> str:
    """A recording as CSV text; ``time`` (n,), s; ``signals`` (5, n), SI, in the order of MEASURED; NaN: absent."""
    table = pd.DataFrame({heading("time"): np.round(time, 6)})
    for name, values in zip(MEASURED, signals, strict=True):
        if np.isfinite(values).any():
            table[heading(name)] = values / factor(name, WRITTEN_UNITS[name], name)
    comment = f"# {' '.join(note.split())}\n" if note else ""
    return comment + table.to_csv(index=False, float_format=_FORMAT, lineterminator="\n")


def heading(signal: str) -> str:
    """Heading of a column: ``position [mm]``."""
    return f"{signal} [{WRITTEN_UNITS[signal]}]"
