"""``hydro diagnose``: from a recording to the readings of both detectors and the verdict."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import Cause, Detector, Reading, Why, Windows
from hydro_agents.detection.detectors import DetectorChoice, make_detector
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import HeadDetector
from hydro_env import TaskConfig
from hydro_rig.diagnosis.pipeline import Judged, Read, flow_blocks, judged
from hydro_rig.diagnosis.verdict import EXIT_CODES
from hydro_rig.diagnosis.volume_balance import leak_of_blocks
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.progress import tell
from hydro_rig.estimation.result import Estimate, join
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.findings import Finding, Weight, lines_of
from hydro_rig.recordings.parts import liveliest
from hydro_rig.recordings.quality import check_recording
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import Sampled, cut, on_grid

HEAD = "leakage head"  # in sentences
FIRST_WINDOWS = 2  # liveliest windows, which show whether the model describes the rig at all
MOST_WINDOWS = 60  # of a recording; more take longer and add little


class NamedReading(NamedTuple):
    """What a detector has read, and its names."""

    name: str
    column: str
    reading: Reading
    own: bool = False  # neither the estimator nor the leakage head: its score is shown as well


def companion_of(text: str | None) -> Detector:
    """The detector of ``module:attribute``, or a head from its weights; default: the shipped head.

    Raises:
        ConfigurationError: it cannot be loaded, or is no detector.
    """
    if text is not None and ":" in text and not Path(f"{text}.json").exists():
        return make_detector(DetectorChoice(kind=text))
    return HeadDetector.load(text)


def name_of(detector: Detector) -> str:
    """The name of a detector in sentences: that of its class, unless it is a leakage head."""
    return HEAD if isinstance(detector, HeadDetector) else type(detector).__name__


@dataclass(frozen=True)
class Diagnosis(Judged):
    """All results for a recording."""

    recording: Recording
    companion: Detector | None = None  # that reads beside the estimator
    note: str = ""  # why the companion was not used; empty if it was

    @property
    def readings(self) -> list[NamedReading]:
        """What was read in each window, by detector; a leak test with few windows reads none."""
        found = []
        if self.read.estimator is not None and len(self.read.estimator.score) == len(self.windows):
            found.append(NamedReading("estimator", "estimator", self.read.estimator))
        if self.companion is not None and self.read.companion is not None:
            name = name_of(self.companion)
            own = name != HEAD
            found.append(NamedReading(name, name if own else "head", self.read.companion, own))
        return found


def diagnose(
    path: Path,
    config: TaskConfig,
    detector: LeakageHead | Detector,
    columns: ColumnMap | None = None,
    window: float = 2.0,
    most: int = MOST_WINDOWS,
) -> Diagnosis:
    """Read a recording, check it, let the estimator and another detector read it, and judge.

    Args:
        path: the recording, CSV.
        config: the task whose rig was recorded.
        detector: the leakage head, or another detector, that reads beside the estimator.
        columns: the signal of each column; default: the names that ``hydro record`` writes.
        window: s, of the windows that the estimator reads; a head has its own.
        most: windows that are read; those of a longer recording are a sample (:func:`spread`).

    Raises:
        ConfigurationError: the recording cannot be read at all.

    Example:
        >>> from pathlib import Path
        >>> from hydro_agents.detection.monitor import load_head
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_rig.recordings.simulated import record_axis
        >>> from hydro_rig.diagnosis.diagnose import diagnose
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig(episode_duration=2.0)
        >>> recorded = record_axis(Path("axis.csv"), task, shipped("pid", task), 1, 1.0, "multi_sine")
        >>> verdict = diagnose(Path("axis.csv"), task, load_head(None, task)).verdict
        >>> verdict.kind.value, round(verdict.leak.value, 1)
        ('internal leak', 1.0)
    """
    companion: Detector = HeadDetector(detector) if isinstance(detector, LeakageHead) else detector
    recording = read_recording(path, columns)
    checked = check_recording(recording, config)
    config = on_grid(config, checked.samples.period)
    length = max(round(window / config.control_period), 2)
    note = companion.refuses(config, length)

    left_out: list[Finding] = []

    def choose(samples: Sampled) -> Windows:
        windows = cut(samples, length)
        chosen = spread(windows, most)
        if len(chosen) < len(windows):
            what = f"{len(chosen)} of {len(windows)} are read, spread over the recording (--windows)"
            left_out.append(Finding("windows", what, Weight.NOTE))
        tell(f"windows of {len(samples.time)} samples at {1.0 / samples.period:.4g} Hz", len(chosen), len(windows))
        return chosen

    def read(windows: Windows) -> Read:
        if not len(windows):
            return Read()
        estimator, fitted = read_windows(windows, config)
        if note:
            return Read(estimator, None, fitted, left_out)
        commanded = np.flatnonzero(windows.commanded)
        reading = companion.read(windows.part(commanded), config)
        companion_reading = reading.among(commanded, len(windows), Why.NO_COMMANDS)
        return Read(estimator, companion_reading, fitted, left_out)

    result = judged(
        checked,
        config,
        choose=choose,
        read=read,
        recording=recording,
        balance=leak_of_blocks(flow_blocks(recording)),
        window=window,
        companion=name_of(companion),
    )
    return Diagnosis(**vars(result), recording=recording, companion=companion, note=note)


def spread(windows: Windows, most: int) -> Windows:
    """Of each of ``most`` sections of a recording, the window that moves most; few are all kept."""
    if len(windows) <= most:
        return windows
    return windows.part(liveliest(windows, most, float(windows.end[-1] - windows.begin[0]) / most))


def read_windows(windows: Windows, config: TaskConfig, threads: int | None = None) -> tuple[Reading, Estimate | None]:
    """Read all windows with the estimator; if the model explains none of the liveliest, the others are not tried.

    ``threads`` is that of :class:`~hydro_rig.estimation.estimator.EstimatorDetector`.
    """
    commanded = np.flatnonzero(windows.commanded)
    first = commanded[liveliest(windows.part(commanded), FIRST_WINDOWS)]
    others = np.setdiff1d(np.arange(len(windows)), first)
    detector = EstimatorDetector(threads=threads)
    if not len(first):
        return detector.read_and_fit(windows, config)
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
    return reading, fitted


def leak_table(diagnosis: Diagnosis) -> pd.DataFrame:
    """The readings of all detectors, one row per window; leaks in l/min at 100 bar."""
    windows = diagnosis.windows
    tables = [pd.DataFrame({"begin_s": windows.begin, "end_s": windows.end}).round(6)]
    for _, column, reading, own in diagnosis.readings:
        sizes = {"leak": reading.flow_lpm, "low": reading.low_lpm, "high": reading.high_lpm}
        table = pd.DataFrame(sizes).round(5)
        table = table.assign(counts=reading.answers, fault=reading.fault, remark=reading.remarks)
        if own:
            table.insert(0, "score", reading.score)
        tables.append(table.add_prefix(f"{column}_"))
    return pd.concat(tables, axis=1)


def in_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """Verdict and findings for another program; leaks in l/min at 100 bar, ``None``: unknown."""
    verdict = diagnosis.verdict
    leak = None if verdict.leak is None else verdict.leak._asdict()
    return {
        "recording": diagnosis.recording.source,
        "verdict": verdict.kind.value,
        "exit_code": EXIT_CODES[verdict.kind],
        "reason": verdict.why,
        "leak": leak,
        "detector": verdict.detector,
        "windows": len(diagnosis.windows),
        "findings": lines_of(diagnosis.checked.findings),
    }


def findings_table(findings: list[Finding]) -> str:
    """The findings as CSV."""
    table = pd.DataFrame(findings, columns=Finding._fields)
    text: str = table.drop(columns="absent").to_csv(index=False, lineterminator="\n", float_format="%.6g")
    return text
