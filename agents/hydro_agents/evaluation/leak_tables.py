"""The tables of the protocol: detection, verdicts, sizes and intervals, reliability, masking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import VERDICTS, Cause
from hydro_agents.evaluation.leak_protocol import DRAWN, HEALTHY, LeakProtocol
from hydro_agents.evaluation.leak_running import LeakRun
from hydro_agents.running.statistics import Interval, share_interval
from hydro_env.files import write_whole

BINS = np.linspace(0.0, 1.0, 11)
"""Edges of the bins of the reliability curve."""

SMALLEST_SIZE = 1e-3
"""l/min; lower limit of estimates in logarithms."""

FAR = 6.0
"""Error of an unflagged estimate that counts as a local minimum, in standard deviations."""

SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True)
class LeakTables:
    """Every table of a protocol; docs/leakage.md describes their columns."""

    detection: pd.DataFrame
    verdicts: pd.DataFrame
    sizes: pd.DataFrame
    reliability: pd.DataFrame
    masking: pd.DataFrame
    thresholds: pd.DataFrame
    conditions: pd.DataFrame
    status: pd.DataFrame
    windows: pd.DataFrame
    protocol: pd.DataFrame
    bound: pd.DataFrame = field(default_factory=pd.DataFrame)
    alarms: pd.DataFrame = field(default_factory=pd.DataFrame)

    def write(self, folder: Path) -> None:
        """Write every table that is not empty as CSV.

        Raises:
            ConfigurationError: a file cannot be written.
        """
        for name, table in self.by_name().items():
            if not table.empty:
                write_whole(folder / f"{name}.csv", table.to_csv(index=False).encode())

    def by_name(self) -> dict[str, pd.DataFrame]:
        """The tables by the names of their files."""
        return {part.name: getattr(self, part.name) for part in fields(self)}


def share(values: Any) -> Interval:
    """Share of true values with its 95 % interval."""
    array = np.asarray(values, dtype=bool)
    return share_interval(int(array.sum()), len(array))


def _columns(name: str, interval: Interval) -> dict[str, float]:
    return {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}


_CELL = ["detector", "condition", "level"]


def detection_table(run: LeakRun, protocol: LeakProtocol) -> pd.DataFrame:
    """Share of windows reported as a leak past the piston, with the detector's threshold and with the one at 1 %.

    ``per_hour``: for consecutive windows without overlap.
    """
    rows = []
    for key, frame in run.windows.groupby(_CELL, sort=False):
        cell = dict(zip(_CELL, key, strict=True))
        flagged = share(frame["flagged"])
        windows_per_hour = SECONDS_PER_HOUR / protocol.conditions[cell["condition"]].duration
        rows.append(
            cell
            | _columns("flagged", flagged)
            | _columns("at_1_percent", share(frame["at_1_percent"]))
            | {
                "cannot_tell": float((frame["verdict"] == Cause.UNKNOWN).mean()),
                "per_hour": flagged.value * windows_per_hour,
                "windows": len(frame),
            }
        )
    return pd.DataFrame(rows)


def verdict_table(run: LeakRun) -> pd.DataFrame:
    """The confusion table: share of each verdict by detector, condition and leak level."""
    rows = []
    for key, frame in run.windows.groupby(_CELL, sort=False):
        counts = np.bincount(frame["verdict"], minlength=len(VERDICTS)) / len(frame)
        rows.append(dict(zip(_CELL, key, strict=True)) | dict(zip(VERDICTS, counts, strict=True)))
    return pd.DataFrame(rows)


def size_table(run: LeakRun) -> pd.DataFrame:
    """Errors of the size and coverage of the 90 % intervals, over windows in which the detector gives an answer."""
    sigma = _bound_of(run.bound)
    rows = []
    for key, frame in run.windows.groupby(_CELL, sort=False):
        cell = dict(zip(_CELL, key, strict=True))
        told = frame[frame["flow_lpm"].notna()]
        truth = told["leak_lpm"].to_numpy()
        estimate = told["flow_lpm"].to_numpy()
        low, high = told["low_lpm"].to_numpy(), told["high_lpm"].to_numpy()
        has = ~np.isnan(low)
        row: dict[str, Any] = cell | {"windows": len(frame), "told": len(told)}
        row["rms_log10"] = row["median_error_lpm"] = np.nan
        if len(told):
            decades = np.log10(np.maximum(estimate, SMALLEST_SIZE) / truth)
            row["rms_log10"] = float(np.sqrt(np.mean(decades**2))) if cell["level"] != HEALTHY else np.nan
            row["median_error_lpm"] = float(np.median(np.abs(estimate - truth)))
        row |= _columns("coverage", share(((low <= truth) & (truth <= high))[has]))
        deviation = (high - low) / (2.0 * 1.645)
        far = np.abs(estimate - truth) > FAR * np.maximum(deviation, 1e-4)
        row["unnoticed_minimum"] = float(far[has].mean()) if has.any() else np.nan
        row["bound_lpm"] = sigma.get((cell["condition"], cell["level"]), np.nan)
        row["bound_rms_log10"] = np.nan
        if cell["level"] > 0.0:
            row["bound_rms_log10"] = row["bound_lpm"] / cell["level"] / np.log(10.0)
        row["ratio_to_bound"] = row["rms_log10"] / row["bound_rms_log10"]
        rows.append(row)
    return pd.DataFrame(rows)


def _bound_of(bound: pd.DataFrame) -> dict[tuple[str, float], float]:
    """Median bound of each condition and level."""
    if bound.empty:
        return {}
    found = bound.groupby(["condition", "level"])["sigma_lpm"].median()
    return {(str(condition), float(level)): float(value) for (condition, level), value in found.items()}


def reliability_table(run: LeakRun) -> pd.DataFrame:
    """Probability against frequency of a leak, by detector and condition with drawn leaks, half of them healthy.

    ``error`` is the calibration error of the whole curve: the mean distance of probability and frequency, weighted by
    the number of windows.
    """
    rows = []
    drawn = run.windows[(run.windows["level"] == DRAWN) & run.windows["probability"].notna()]
    for (detector, condition), frame in drawn.groupby(["detector", "condition"], sort=False):
        probability = frame["probability"].to_numpy()
        leaking = frame["leaking"].to_numpy(dtype=bool)
        place = np.clip(np.digitize(probability, BINS) - 1, 0, len(BINS) - 2)
        parts = []
        for number in np.unique(place):
            here = place == number
            found = share(leaking[here])
            parts.append(
                {"detector": detector, "condition": condition, "probability": float(probability[here].mean())}
                | _columns("frequency", found)
                | {"windows": int(here.sum())}
            )
        distance = sum(abs(p["probability"] - p["frequency"]) * p["windows"] for p in parts) / len(frame)
        rows += [part | {"error": distance} for part in parts]
    return pd.DataFrame(rows)


def masking_table(run: LeakRun, protocol: LeakProtocol) -> pd.DataFrame:
    """Detection and position error by controller of the axes: does better control hide the leak?"""
    sigma = _bound_of(run.bound)
    rows = []
    for (detector, condition, level), frame in run.windows.groupby(_CELL, sort=False):
        chosen = protocol.conditions[str(condition)]
        if chosen.group not in ("levels", "controller") or level <= 0.0:
            continue
        rows.append(
            {"detector": detector, "condition": condition, "acting": chosen.acting, "level": level}
            | {"error_mm": float(frame["error_mm"].mean())}
            | _columns("at_1_percent", share(frame["at_1_percent"]))
            | {"bound_lpm": sigma.get((str(condition), float(level)), np.nan), "windows": len(frame)}
        )
    return pd.DataFrame(rows)


def make_tables(protocol: LeakProtocol, run: LeakRun, facts: Sequence[tuple[str, str]] = ()) -> LeakTables:
    """All tables of a run.

    Args:
        protocol: the protocol.
        run: its results.
        facts: keys and values of the table ``protocol``, in addition to title and hash.
    """
    known = [("title", protocol.title), ("sha256", protocol.sha256), ("windows", str(len(run.windows))), *facts]
    return LeakTables(
        detection=detection_table(run, protocol),
        verdicts=verdict_table(run),
        sizes=size_table(run),
        reliability=reliability_table(run),
        masking=masking_table(run, protocol),
        thresholds=run.thresholds,
        conditions=protocol.table(),
        status=run.status,
        windows=run.windows,
        protocol=pd.DataFrame(known, columns=["key", "value"]),
        alarms=run.alarms,
        bound=run.bound,
    )
