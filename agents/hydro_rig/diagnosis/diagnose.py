"""``hydro diagnose``: from a recording to the readings of the estimator and the verdict."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import Cause, Reading, Why, Windows
from hydro_env import TaskConfig
from hydro_rig.diagnosis.pipeline import Diagnosis, Read, diagnosed
from hydro_rig.diagnosis.verdict import EXIT_CODES
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.progress import tell
from hydro_rig.estimation.result import join
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.findings import Finding, Weight, lines_of
from hydro_rig.recordings.parts import liveliest
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import Sampled, cut

FIRST_WINDOWS = 2  # liveliest windows, which show whether the model describes the rig at all
MOST_WINDOWS = 60  # of a recording; more take longer and add little


def diagnose(
    path: Path,
    config: TaskConfig,
    columns: ColumnMap | None = None,
    window: float = 2.0,
    most: int = MOST_WINDOWS,
) -> Diagnosis:
    """Read a recording, check it, let the estimator read it, and judge.

    Args:
        path: the recording, CSV.
        config: the task whose rig was recorded.
        columns: the signal of each column; default: the names that ``hydro record`` writes.
        window: s, of the windows that are read.
        most: windows that are read; those of a longer recording are a sample (:func:`spread`).

    Raises:
        ConfigurationError: the recording cannot be read at all.

    Example:
        >>> from pathlib import Path
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_rig.recordings.simulated import record_axis
        >>> from hydro_rig.diagnosis.diagnose import diagnose
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig(episode_duration=2.0)
        >>> recorded = record_axis(Path("axis.csv"), task, shipped("pid", task), 1, 1.0, "multi_sine")
        >>> verdict = diagnose(Path("axis.csv"), task).verdict
        >>> verdict.kind.value, round(verdict.leak.value, 1)
        ('internal leak', 1.0)
    """
    left_out: list[Finding] = []

    def choose(samples: Sampled) -> Windows:
        windows = cut(samples, max(round(window / samples.period), 2))
        chosen = spread(windows, most)
        if len(chosen) < len(windows):
            what = f"{len(chosen)} of {len(windows)} are read, spread over the recording (--windows)"
            left_out.append(Finding("windows", what, Weight.NOTE))
        tell(f"windows of {len(samples.time)} samples at {1.0 / samples.period:.4g} Hz", len(chosen), len(windows))
        return chosen

    found = diagnosed(read_recording(path, columns), config, choose, read_windows, window)
    found.checked.findings.extend(left_out)
    return found


def spread(windows: Windows, most: int) -> Windows:
    """Of each of ``most`` sections of a recording, the window that moves most; few are all kept."""
    if len(windows) <= most:
        return windows
    return windows.part(liveliest(windows, most, float(windows.end[-1] - windows.begin[0]) / most))


def read_windows(windows: Windows, config: TaskConfig, threads: int | None = None) -> Read:
    """Read all windows with the estimator; if the model explains none of the liveliest, the others are not tried.

    ``threads`` is that of :class:`~hydro_rig.estimation.estimator.EstimatorDetector`.
    """
    commanded = np.flatnonzero(windows.commanded)
    first = commanded[liveliest(windows.part(commanded), FIRST_WINDOWS)]
    others = np.setdiff1d(np.arange(len(windows)), first)
    detector = EstimatorDetector(threads=threads)
    if not len(first):
        return Read(*detector.read_and_fit(windows, config))
    tell("estimator", 0, len(commanded))
    hasty = EstimatorDetector(threads=threads, restarts=1)
    reading, fitted = hasty.read_and_fit(windows.part(first), config)
    tell("estimator", len(first), len(commanded))
    unread = Reading.of(np.full(len(windows), np.nan), Cause.UNKNOWN, why=Why.NOT_READ)
    reading = unread.replaced(first, reading)
    if len(others) and fitted is not None and fitted.holds.any():
        usual = Counter(parts for parts in fitted.parts if parts).most_common(1)
        rest, more = detector.read_and_fit(windows.part(others), config, usual[0][0] if usual else ())
        tell("estimator", len(commanded), len(commanded))
        reading = reading.replaced(others, rest)
        if more is not None:
            fitted = join([fitted, more])
    return Read(reading, fitted)


def leak_table(diagnosis: Diagnosis) -> pd.DataFrame:
    """The reading of each window, one row each; leaks in l/min at 100 bar."""
    windows, reading = diagnosis.windows, diagnosis.reading
    times = pd.DataFrame({"begin_s": windows.begin, "end_s": windows.end})
    sizes = pd.DataFrame({"leak": reading.flow_lpm, "low": reading.low_lpm, "high": reading.high_lpm}).round(5)
    read = sizes.assign(counts=reading.answers, fault=reading.fault, remark=reading.remarks)
    return pd.concat([times.round(6), read], axis=1)


def in_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """Verdict and findings for another program; leaks in l/min at 100 bar, ``None``: unknown."""
    verdict = diagnosis.verdict
    return {
        "recording": diagnosis.recording.source,
        "verdict": verdict.kind.value,
        "exit_code": EXIT_CODES[verdict.kind],
        "reason": verdict.why,
        "leak": None if verdict.leak is None else verdict.leak._asdict(),
        "windows": len(diagnosis.windows),
        "findings": lines_of(diagnosis.checked.findings),
    }


def findings_table(findings: list[Finding]) -> str:
    """The findings as CSV."""
    table = pd.DataFrame(findings, columns=Finding._fields)
    text: str = table.to_csv(index=False, lineterminator="\n", float_format="%.6g")
    return text
