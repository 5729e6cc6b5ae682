"""``hydro diagnose``: from a recording to the readings of both detectors and the verdict."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.controllers.registry import imported
from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.detector import NO_COMMANDS, Cause, Detector, Reading, Windows
from hydro_agents.detection.detectors import KINDS, DetectorChoice, make_detector
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.looks import looks_at, window_of
from hydro_agents.detection.monitor import HEAD_FILE, HeadDetector
from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.diagnosis.pipeline import Read, flow_blocks, judged, volume_leak
from hydro_rig.diagnosis.verdict import EXIT_CODES, UNREAD, Limits, Verdict
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.result import Estimate, join
from hydro_rig.recordings.columns import BESIDE, ColumnMap
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.parts import lively
from hydro_rig.recordings.quality import Checked, check_recording
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import Sampled, cut

Progress = Callable[[str, int, int], None]

FIRST_WINDOWS = 2  # liveliest windows, which show whether the model describes the rig at all

MOST_GAPS = 20
"""Longest duration of a recording including gaps, as a multiple of its sampled time; a longer one is not continuous."""


class Watched(NamedTuple):
    """Result of the alarm."""

    at: float | None  # s, of the alarm; None: there was none
    rate: float | None  # false alarms per 100 h for which it was set
    note: str  # why it did not watch; empty if it watched

    def line(self) -> str:
        """The alarm in one sentence."""
        if self.note:
            return f"The alarm did not watch: {self.note}."
        rate = f", set for a rate of {self.rate:g} per 100 h in healthy axes," if self.rate is not None else ""
        when = f"rose at {self.at:.1f} s" if self.at is not None else "stayed silent"
        return f"The alarm{rate} {when}."


def watch(samples: Sampled, detector: Detector, task: TaskConfig, settings: AlarmSettings) -> Watched:
    """Run an alarm over a recording, as if the axis had been switched on at its start.

    Raises:
        ConfigurationError: the detector cannot read the task.
    """
    rate, count = settings.false_alarms_per_100_h, int(samples.place[-1]) + 1 if len(samples.place) else 0
    if count < window_of(detector, task):
        return Watched(None, rate, "the recording is shorter than a window of the detector")
    if count > MOST_GAPS * len(samples.place):
        return Watched(None, rate, "most of the time between the first and the last sample was not recorded")
    signals = np.full((1, len(samples.signals), count), np.nan)
    signals[0, :, samples.place] = samples.signals.T
    looks = looks_at(signals, task, detector, settings.interval)
    raised = LeakAlarm(settings).follow(looks)[0].alarm[0]
    return Watched(float(looks.time[raised.argmax()]) if raised.any() else None, rate, "")


def detector_of(settings: AlarmSettings, given: LeakageHead | Detector, weights: str = HEAD_FILE) -> Detector:
    """The detector that an alarm was set for, from the one that is given; the estimator is always there.

    Raises:
        ConfigurationError: it was set for another detector.
    """
    kind, _, file = settings.detector.partition(" ")
    if kind == "estimator":
        return make_detector(DetectorChoice(kind=kind))
    if isinstance(given, LeakageHead):
        name = f"head {Path(weights).name}"
        if kind in ("", *KINDS) and Path(file or weights).stem == Path(weights).stem:
            return make_detector(DetectorChoice(kind=kind or "head"), given)
    else:
        name = f"{type(given).__module__}:{type(given).__qualname__}"
        if not kind or (":" in kind and imported(kind) in (given, type(given))):
            return given
    raise ConfigurationError(f"it was set for the detector '{settings.detector}', and '{name}' is given")


def _watched(
    checked: Checked, given: LeakageHead | Detector, weights: str, task: TaskConfig, settings: AlarmSettings
) -> Watched:
    """The result of an alarm, or why it did not watch."""
    try:
        if checked.severe:
            raise ConfigurationError(checked.severe[0].line())
        return watch(checked.samples, detector_of(settings, given, weights), task, settings)
    except ConfigurationError as error:
        return Watched(None, settings.false_alarms_per_100_h, str(error).removeprefix("alarm: "))


class Diagnosis(NamedTuple):
    """All results for a recording."""

    recording: Recording
    task: TaskConfig  # that was assumed
    checked: Checked
    windows: Windows
    estimator: Reading | None
    head: Reading | None
    limits: Limits
    verdict: Verdict
    alarm: Watched | None  # None: no settings of an alarm were given
    note: str  # why the head was not used; empty if it was
    fitted: Estimate | None  # of the windows with commands; None: none was read


def diagnose(
    path: Path,
    config: TaskConfig,
    head: LeakageHead | Detector,
    columns: ColumnMap | None = None,
    window: float = 2.0,
    alarm: AlarmSettings | None = None,
    progress: Progress | None = None,
    weights: str = HEAD_FILE,
) -> Diagnosis:
    """Read a recording, check it, let both detectors read it, and judge.

    Args:
        path: the recording, CSV.
        config: the task whose rig was recorded.
        head: the leakage head, or another detector, that reads beside the estimator.
        columns: the signal of each column; default: the names that ``hydro record`` writes.
        window: s, of the windows that the estimator reads; the head has its own.
        alarm: settings of an alarm that watches the recording.
        progress: called with phase, done, total.
        weights: file of the head, by which an alarm names it.

    Raises:
        ConfigurationError: the recording cannot be read at all.

    Example:
        >>> from pathlib import Path
        >>> from hydro_agents.detection.monitor import load_head
        >>> from hydro_agents.learning.opponents import shipped
        >>> from hydro_rig.recordings.simulated import record_axis
        >>> from hydro_rig.diagnosis.diagnose import diagnose
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig(episode_duration=2.0)
        >>> recorded = record_axis(Path("axis.csv"), task, shipped("pid", task), 1, 1.0, "multi_sine")
        >>> verdict = diagnose(Path("axis.csv"), task, load_head(None, task)).verdict
        >>> verdict.kind.value, round(verdict.leak.value, 1)
        ('internal leak', 1.0)
    """
    second = HeadDetector(head) if isinstance(head, LeakageHead) else head
    recording = read_recording(path, columns)
    checked = check_recording(recording, config)
    checked = Checked(checked.samples, [*checked.findings, *_about_beside(recording)])
    length = max(round(window / config.control_period), 2)
    note, limits = second.refuses(config, length), Limits.of(config)

    def read(windows: Windows) -> Read:
        chosen = np.flatnonzero(windows.commanded)
        fits = 2 * len(chosen)

        def done(finished: int) -> None:
            if progress is not None and fits:
                progress("estimator", finished, fits)

        if not len(windows):
            return Read()
        done(0)
        estimator, fitted = read_windows(windows, config, done)
        if note:
            return Read(estimator, None, fitted)
        reading = second.read(windows.part(chosen), config).among(chosen, len(windows), NO_COMMANDS)
        return Read(estimator, reading, fitted)

    balance = volume_leak(flow_blocks(recording))
    found = judged(checked, config, lambda samples: cut(samples, length), read, limits, window, balance, [recording])
    watched = None if alarm is None else _watched(found.checked, head, weights, config, alarm)
    estimator, reading, fitted, _ = found.read
    checked, windows, verdict = found.checked, found.windows, found.verdict
    return Diagnosis(recording, config, checked, windows, estimator, reading, limits, verdict, watched, note, fitted)


def read_windows(
    windows: Windows, config: TaskConfig, progress: Callable[[int], None] | None = None, threads: int | None = None
) -> tuple[Reading, Estimate | None]:
    """Read all windows with the estimator; if the model explains none of the liveliest, the others are not tried.

    ``threads`` is that of :class:`~hydro_rig.estimation.estimator.EstimatorDetector`.
    """
    detector, count = EstimatorDetector(threads=threads), len(windows)
    commanded = np.flatnonzero(windows.commanded)
    first = commanded[lively(windows.part(commanded), FIRST_WINDOWS)]
    if not len(first):
        return detector.read_and_fit(windows, config)
    hasty = EstimatorDetector(threads=threads, restarts=1)
    reading, fitted = hasty.read_and_fit(windows.part(first), config, progress)
    others = np.setdiff1d(np.arange(count), first)
    if not len(others):
        return reading, fitted
    if fitted is None or not fitted.holds.any():
        unread = Reading.of(np.full(len(others), np.nan), Cause.UNKNOWN, why=UNREAD)
        return reading.followed_by(unread).among(np.concatenate([first, others]), count, ""), fitted
    later = None if progress is None else lambda done: progress(2 * len(first) + done)
    rest, more = detector.read_and_fit(windows.part(others), config, later)
    whole = reading.followed_by(rest).among(np.concatenate([first, others]), count, "")
    return whole, fitted if more is None else join([fitted, more])


def _about_beside(recording: Recording) -> list[Finding]:
    """What the further signals of a recording say, but for the flow."""
    found: list[Finding] = []
    if recording.beside is None:
        return found
    for name, values in zip(BESIDE, recording.beside, strict=True):
        if np.isfinite(values).any() and name != "flow":
            size, unit = (1.0, "°C") if name == "oil_temperature" else (1e-5, "bar")
            low, high = size * np.nanquantile(values, [0.01, 0.99])
            more = "a leak past the seal grows as the oil thins" if unit == "°C" else "the model follows it"
            found.append(Finding(name, f"is {low:.4g} to {high:.4g} {unit}; {more}", Weight.NOTE))
    return found


def leak_table(diagnosis: Diagnosis) -> pd.DataFrame:
    """The readings of both detectors, one row per window; leaks in l/min at 100 bar."""
    columns: dict[str, object] = {
        "begin_s": np.round(diagnosis.windows.begin, 6),
        "end_s": np.round(diagnosis.windows.end, 6),
    }
    for name, reading in (("estimator", diagnosis.estimator), ("head", diagnosis.head)):
        if reading is not None:
            columns |= {
                f"{name}_leak": np.round(reading.flow_lpm, 5),
                f"{name}_low": np.round(reading.low_lpm, 5),
                f"{name}_high": np.round(reading.high_lpm, 5),
                f"{name}_counts": reading.answers,
                f"{name}_fault": reading.fault,
                f"{name}_remark": reading.why,
            }
    return pd.DataFrame(columns)


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
        "findings": [finding.line() for finding in diagnosis.checked.findings],
    }


def findings_table(findings: list[Finding]) -> str:
    """The findings as CSV."""
    table = pd.DataFrame(findings, columns=list(Finding._fields))
    text: str = table.to_csv(index=False, lineterminator="\n", float_format="%.6g")
    return text
