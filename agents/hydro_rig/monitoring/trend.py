"""``hydro trend``: one reading of a recording.

A reading is that of ``hydro diagnose`` with the estimator alone, of the dozen liveliest windows
(:mod:`~hydro_rig.recordings.liveliest`), and the leak is also given at one temperature of the oil
(:mod:`~hydro_rig.monitoring.oil`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.detector import Reading, Windows
from hydro_env import TaskConfig
from hydro_env.types import Floats
from hydro_rig.diagnosis.diagnose import read_windows
from hydro_rig.diagnosis.pipeline import Read, flow_blocks, judged
from hydro_rig.diagnosis.verdict import BALANCE, Kind, Leak, Verdict, combined
from hydro_rig.diagnosis.volume_balance import Blocks, VolumeLeak, leak_of_blocks
from hydro_rig.monitoring.oil import Oil, referred
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.files import read_columns
from hydro_rig.recordings.findings import Weight
from hydro_rig.recordings.liveliest import Lively, liveliest, sampled_windows
from hydro_rig.recordings.quality import check_samples
from hydro_rig.recordings.recording import recording_of
from hydro_rig.recordings.sampling import Sampled, cut, on_grid

MOST_WINDOWS = 12  # of a reading; more take longer and add little
WINDOW = 2.0  # s
FIRST_DATE, LAST_DATE = 1e9, 4e9  # s since 1970 that a stamp is taken for: the years 2001 to 2096
OIL, NOTHING = "oil_temperature", np.zeros(0)  # the signal of its temperature; readings of a signal without any

_DATE = re.compile(r"(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)(?:[T_ -]?(\d\d)[-_:.]?(\d\d)(?:[-_:.]?(\d\d))?)?(?!\d)")


class Settings(NamedTuple):
    """How files are read."""

    oil: Oil
    between: tuple[float, float]  # °C, of an oil whose temperature was not recorded
    windows: int = MOST_WINDOWS  # of a reading


class Row(NamedTuple):
    """One reading of an axis; leaks in l/min at 100 bar with their 90 % intervals, NaN: no size."""

    time: float  # s since 1970, first and last stamp
    until: float
    axis: str
    verdict: str
    size: float  # as measured
    low: float
    high: float
    moving: float  # share of the time in motion
    temperature: float  # °C, of the oil; NaN: not recorded
    size_40: float  # at 40 °C
    low_40: float
    high_40: float
    reason: str
    clock_back: float  # s, by which the clock ran back in it; 0: never


def read_row(_: object, path: str, *arguments: Any) -> dict[str, NDArray[Any]]:
    """The row of :func:`row_of_file` as columns, for a :class:`~hydro_agents.running.jobs.Job`."""
    row = row_of_file(Path(path), *arguments)
    return {name: np.array([value]) for name, value in row._asdict().items()}


def row_of_file(path: Path, axis: str, config: TaskConfig, columns: ColumnMap | None, how: Settings) -> Row:
    """Read a file.

    Args:
        path: CSV, Parquet, MDF4, TDMS or MAT.
        axis: its name.
        config: the task whose rig was recorded.
        columns: the signal of each column; default: the names that ``hydro record`` writes.
        how: settings.

    Raises:
        ConfigurationError: the file cannot be read, or holds no rows.
    """
    rows = recording_of(read_columns(path), str(path), columns)
    live = liveliest(rows, WINDOW, config, how.windows)
    return row_of(axis, live, config, how, _clock(path, rows.begin), list(flow_blocks(rows)))


def _clock(path: Path, first: float) -> float:
    """What is added to the stamps of a file to give s since 1970: dates in it, its name, or its age."""
    if FIRST_DATE <= first <= LAST_DATE:
        return 0.0
    begin, found = None, _DATE.search(path.name)
    if found is not None:
        try:
            begin = datetime(*(int(part or 0) for part in found.groups()), tzinfo=UTC).timestamp()  # type: ignore[arg-type,misc]
        except ValueError:  # the 45th of a month
            begin = None
    return (path.stat().st_mtime if begin is None else begin) - first


def row_of(
    axis: str,
    live: Lively,
    config: TaskConfig,
    how: Settings,
    clock: float = 0.0,
    blocks: Sequence[Blocks] = (),
) -> Row:
    """The row of what was read: the best windows, and the blocks of a measured flow."""
    leak = at_40 = Leak(np.nan, np.nan, np.nan)
    candidates, findings, temperature = live.windows, live.findings, np.nan
    verdict = Verdict(Kind.UNKNOWN, "the recording is shorter than one window", None, "")
    if candidates:
        rows = [candidate.rows for candidate in candidates]
        temperature = _mean(np.array([_mean(one.auxiliary.get(OIL, NOTHING)) for one in rows]))
        volume, samples = leak_of_blocks(blocks), sampled_windows(candidates, WINDOW, config)
        config = on_grid(config, samples.period)

        def choose(samples: Sampled) -> Windows:
            windows = cut(samples, round(WINDOW / config.control_period))
            commanded = np.isfinite(windows.signal("previous_command")).mean(axis=1)
            return windows.part(commanded > 0.5)  # without the margins

        def read(windows: Windows) -> Read:
            nonlocal leak
            if not len(windows):
                return Read()
            measured, fitted = read_windows(windows, config, threads=1)
            leak, _ = combined(measured)
            warm = np.array([_mean(values) for values in windows.auxiliary_signal(OIL)])
            return Read(referred(measured, how.oil, warm, how.between), fitted=fitted)

        found = judged(
            check_samples(samples, live.findings, config),
            config,
            choose=choose,
            read=read,
            rows=rows,
            balance=None if volume is None else _referred_leak(volume, how, temperature),
            window=WINDOW,
        )
        findings, verdict = found.checked.findings, found.verdict
        if volume is not None and verdict.detector == BALANCE:
            leak, at_40 = Leak(volume.value, volume.low, volume.high), verdict.leak or at_40
        elif found.read.estimator is not None:
            at_40, _ = combined(found.read.estimator)
    notes = [finding.line() for finding in findings if finding.weight is Weight.FAULT]
    notes += [finding.line() for finding in findings if finding.signal == "clock"]
    return Row(
        clock + live.first,
        clock + live.last,
        axis,
        verdict.kind.value,
        *leak,
        live.moving,
        temperature,
        *at_40,
        reason="; ".join(dict.fromkeys(part for part in (verdict.why, *notes) if part)),
        clock_back=live.clock_back,
    )


def _mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def _referred_leak(found: VolumeLeak, how: Settings, temperature: float) -> VolumeLeak:
    """The leak by the balance of volumes at the reference temperature."""
    one = Reading.of([0.0], flow_lpm=found.value, low_lpm=found.low, high_lpm=found.high)
    warm = referred(one, how.oil, np.array([temperature]), how.between)
    return found._replace(value=float(warm.flow_lpm[0]), low=float(warm.low_lpm[0]), high=float(warm.high_lpm[0]))
