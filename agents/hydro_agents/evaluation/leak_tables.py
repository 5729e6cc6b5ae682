"""The tables of a leakage protocol: thresholds, windows, detection, sizes and intervals.

docs/leakage.md describes their columns.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import Cause, threshold_at_false_alarm_rate
from hydro_agents.evaluation.leak_protocol import HEALTHY
from hydro_agents.evaluation.runner import Results, Rows, table
from hydro_agents.running.statistics import Interval, share_interval
from hydro_env.types import ByName

FALSE_ALARM_RATE = 0.01

SMALLEST_SIZE = 1e-3  # l/min; lower limit of estimates in logarithms

SECONDS_PER_HOUR = 3600.0


@table("thresholds")
def thresholds(results: Results) -> Rows:
    """For each detector: the threshold at 1 % false alarms on healthy validation windows, and the threshold in use."""
    read = results.part("windows")
    for name, detector in results.participants.items():
        score = read.loc[read["validation"] & (read["detector"] == name), "score"].to_numpy()
        found = np.nan  # a detector that cannot read these windows
        if len(score):
            found = threshold_at_false_alarm_rate(np.nan_to_num(score, nan=-np.inf), FALSE_ALARM_RATE)
        used = found if detector.threshold is None else detector.threshold
        yield {"detector": name, "at_1_percent": found, "used": used, "windows": len(score)}


@table("windows")
def windows(results: Results) -> pd.DataFrame:
    """The windows of all detectors with a threshold, without those of the validation; see :func:`judged`."""
    read = results.part("windows")
    known = results.table("thresholds")
    chosen = ~read["validation"] & read["detector"].isin(known.loc[known["used"].notna(), "detector"])
    return judged(read[chosen].drop(columns="validation"), known)


def judged(windows: pd.DataFrame, thresholds: pd.DataFrame) -> pd.DataFrame:
    """The windows of runs that did not fail, with three additional columns.

    ``flagged`` (with the threshold in use), ``at_1_percent`` (with the threshold at 1 % false alarms) and ``verdict``
    (its number).
    """
    windows = windows[windows["failed"] == 0.0]
    score, thresholds = windows["score"].to_numpy(), thresholds.set_index("detector").loc[windows["detector"]]
    flagged = score >= thresholds["used"].to_numpy()  # NaN is above nothing
    at_1_percent = score >= thresholds["at_1_percent"].to_numpy()
    verdict = np.where(flagged, Cause.INTERNAL_LEAK, windows["otherwise"].to_numpy())
    verdict = np.where(np.isnan(score), Cause.UNKNOWN, verdict).astype(int)
    return windows.assign(flagged=flagged, at_1_percent=at_1_percent, verdict=verdict)


def share(values: Any) -> Interval:
    """Share of true values with its 95 % interval."""
    array = np.asarray(values, bool)
    return share_interval(array.sum(), len(array))


_CELL = ["detector", "condition", "level"]


def _cells(results: Results) -> Iterator[tuple[ByName, pd.DataFrame]]:
    found = results.table("windows")
    if len(found):
        for key, frame in found.groupby(_CELL, sort=False):
            yield dict(zip(_CELL, key, strict=True)), frame


@table("detection")
def detection(results: Results) -> Rows:
    """Share of windows reported as a leak past the piston, with the detector's threshold and with the one at 1 %.

    ``per_hour``: for consecutive windows without overlap.
    """
    for cell, frame in _cells(results):
        flagged = share(frame["flagged"])
        windows_per_hour = SECONDS_PER_HOUR / results.protocol.conditions[cell["condition"]].duration
        yield {
            **cell,
            **flagged.named("flagged"),
            **share(frame["at_1_percent"]).named("at_1_percent"),
            "cannot_tell": (frame["verdict"] == Cause.UNKNOWN).mean(),
            "per_hour": flagged.value * windows_per_hour,
            "windows": len(frame),
        }


@table("sizes")
def sizes(results: Results) -> Rows:
    """Errors of the size and coverage of the 90 % intervals, over windows in which the detector gives an answer."""
    bounds = {}
    if len(bound := results.part("bound")):
        bounds = bound.groupby(["condition", "level"])["sigma_lpm"].median().to_dict()
    for cell, frame in _cells(results):
        level = cell["level"]
        row = cell | _errors_of_size(frame, level)
        row["bound_lpm"] = bounds.get((cell["condition"], level), np.nan)
        row["bound_rms_log10"] = np.nan
        if level > 0.0:
            row["bound_rms_log10"] = row["bound_lpm"] / level / np.log(10.0)
        row["ratio_to_bound"] = row["rms_log10"] / row["bound_rms_log10"]
        yield row


def _errors_of_size(frame: pd.DataFrame, level: float) -> ByName:
    """Windows of one cell: errors of their sizes, and how often the interval holds the truth."""
    told = frame[frame["flow_lpm"].notna()]
    truth, estimate, low, high = told[["leak_lpm", "flow_lpm", "low_lpm", "high_lpm"]].to_numpy().T
    row = {"windows": len(frame), "told": len(told), "rms_log10": np.nan, "median_error_lpm": np.nan}
    if len(told):
        decades = np.log10(np.maximum(estimate, SMALLEST_SIZE) / truth)
        row["median_error_lpm"] = np.median(np.abs(estimate - truth))
        if level != HEALTHY:
            row["rms_log10"] = np.sqrt(np.mean(decades**2))
    row |= share(((low <= truth) & (truth <= high))[~np.isnan(low)]).named("coverage")
    return row
