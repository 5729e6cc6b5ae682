"""Runs the protocol: every detector under every condition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import Cause, Detector, threshold_at_false_alarm_rate
from hydro_agents.evaluation.leak_alarm_jobs import AlarmJob, alarm_table
from hydro_agents.evaluation.leak_bound_jobs import BoundJob, bound_plan
from hydro_agents.evaluation.leak_jobs import WindowJob, plan
from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.running.jobs import JobResult, Report, run_jobs
from hydro_env import ConfigurationError

FALSE_ALARM_RATE = 0.01


@dataclass(frozen=True)
class LeakRun:
    """Results of a protocol."""

    windows: pd.DataFrame  # one row per detector and window: truth, reading, verdict, flagged
    thresholds: pd.DataFrame  # one row per detector
    status: pd.DataFrame  # detector, condition, status, message
    alarms: pd.DataFrame  # false alarms per 100 h, delays and misses; empty without an alarm
    bound: pd.DataFrame  # condition, level, seed, sigma_lpm; empty without a bound
    reused: int  # jobs with results from an earlier run


def run_leak_protocol(
    protocol: LeakProtocol,
    detectors: dict[str, Detector],
    digests: dict[str, str],
    alarms: Sequence[AlarmJob] = (),
    folder: Path | None = None,
    jobs: int | None = None,
    progress: Report | None = None,
) -> LeakRun:
    """Run all jobs of a protocol; an interruption keeps the finished ones (:mod:`hydro_agents.running.jobs`).

    Args:
        protocol: the conditions.
        detectors: by their names in the protocol.
        digests: of the detectors' weights and settings, by name; an empty one keeps no result.
        alarms: jobs of the alarms (:func:`hydro_agents.evaluation.leak_alarm_jobs.alarm_plan`).
        folder: for the results of the jobs; ``None`` keeps none.
        jobs: number of jobs side by side; default: one per core.
        progress: called when a job finishes.

    Raises:
        ConfigurationError: no detector could read any window, or a file cannot be written.
    """
    planned = list(plan(protocol, detectors, digests))
    listed = {job.key: job for job in planned if isinstance(job, WindowJob)}
    refused = [text.split("|", 2) for text in planned if isinstance(text, str)]
    status = {(reader, name): ("not applicable", message) for reader, name, message in refused}
    lasting = {job.key: job for job in alarms}
    bounds = {job.key: job for job in bound_plan(protocol)}
    results, reused = run_jobs({**lasting, **bounds, **listed}, folder, jobs, progress)
    frames: list[pd.DataFrame] = []
    healthy: list[pd.DataFrame] = []
    for key, job in listed.items():
        result = results[key]
        if result.error:
            status[job.reader, job.condition] = ("failed", result.error)
            continue
        status.setdefault((job.reader, job.condition), ("done", ""))
        frame = pd.DataFrame({"detector": job.reader, "condition": job.condition, "level": job.level, **result.metrics})
        (healthy if job.validation else frames).append(frame)
    if not frames or not healthy:
        raise ConfigurationError(f"no detector read any window; the first reason: {next(iter(status.values()))[1]}")
    thresholds = _thresholds(pd.concat(healthy), detectors)
    without = thresholds.loc[thresholds["used"].isna(), "detector"]
    for name in without:  # otherwise it would appear to find nothing
        status[str(name), protocol.base] = ("failed", "no threshold: it read no healthy validation windows")
    read = pd.concat(frames, ignore_index=True)
    windows = judged(read[~read["detector"].isin(without)], thresholds, protocol.task.leakage.class_bounds[0])
    tables = [_alarm_table(reader, lasting, results, status) for reader in dict.fromkeys(job.reader for job in alarms)]
    for key, bound in bounds.items():
        if results[key].error:
            status["bound", bound.condition] = ("failed", results[key].error)
    rows = [(*pair, *entry) for pair, entry in status.items()]
    statuses = pd.DataFrame(rows, columns=["detector", "condition", "status", "message"])
    alarm_rows = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
    return LeakRun(windows, thresholds, statuses, alarm_rows, _bound_table(bounds, results), reused)


def _bound_table(jobs: dict[str, BoundJob], results: dict[str, JobResult]) -> pd.DataFrame:
    frames = [
        pd.DataFrame({"condition": job.condition, "level": job.level, **results[key].metrics})
        for key, job in jobs.items()
        if not results[key].error
    ]
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()


def _alarm_table(
    reader: str,
    jobs: dict[str, AlarmJob],
    results: dict[str, JobResult],
    status: dict[tuple[str, str], tuple[str, str]],
) -> pd.DataFrame:
    """The table of one alarm; a failure goes into ``status``."""
    found: dict[bool, list[JobResult]] = {False: [], True: []}
    for key, job in jobs.items():
        if job.reader == reader and results[key].error:
            status[reader, "alarm"] = ("failed", results[key].error)
        elif job.reader == reader:
            found[job.leaks].append(results[key])
    return alarm_table(reader, found)


def _thresholds(healthy: pd.DataFrame, detectors: dict[str, Detector]) -> pd.DataFrame:
    """For each detector: the threshold at 1 % false alarms on healthy validation windows, and the threshold in use."""
    rows = []
    for name, detector in detectors.items():
        score = healthy.loc[healthy["detector"] == name, "score"].to_numpy()
        found = np.nan  # a detector that cannot read these windows
        if len(score):
            found = threshold_at_false_alarm_rate(np.nan_to_num(score, nan=-np.inf), FALSE_ALARM_RATE)
        used = found if detector.threshold is None else detector.threshold
        rows.append({"detector": name, "at_1_percent": found, "used": used, "windows": len(score)})
    return pd.DataFrame(rows)


def judged(windows: pd.DataFrame, thresholds: pd.DataFrame, healthy_bound: float) -> pd.DataFrame:
    """The windows of runs that did not fail, with four additional columns.

    ``flagged`` (with the threshold in use), ``at_1_percent`` (with the threshold at 1 % false alarms), ``verdict`` (its
    number), and ``leaking`` (true leak above the bound of a healthy seal, l/min at 100 bar).
    """
    windows = windows[windows["failed"] == 0.0]
    known = thresholds.set_index("detector")
    score = windows["score"].to_numpy()
    flagged, at_1_percent = (
        score >= windows["detector"].map(known[column]).to_numpy()  # NaN is above nothing
        for column in ("used", "at_1_percent")
    )
    verdict = np.where(flagged, float(Cause.INTERNAL_LEAK), windows["otherwise"].to_numpy())
    verdict = np.where(np.isnan(score), float(Cause.UNKNOWN), verdict).astype(int)
    leaking = windows["leak_lpm"].to_numpy() > healthy_bound
    return windows.assign(flagged=flagged, at_1_percent=at_1_percent, verdict=verdict, leaking=leaking)
