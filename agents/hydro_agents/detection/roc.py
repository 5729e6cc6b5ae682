"""Metrics of leak detection: ROC, precision and recall, detection at a false-alarm rate."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Curve(NamedTuple):
    """A curve over all thresholds."""

    x: Array
    y: Array
    threshold: Array


def _counts(scores: NDArray[Any], positive: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """True and false positives at each distinct threshold, in falling order; the first entry is zero."""
    order = np.argsort(-scores, kind="stable")
    sorted_scores = np.asarray(scores, dtype=np.float64)[order]
    last_of_each = np.append(np.flatnonzero(np.diff(sorted_scores)), len(scores) - 1)
    true = np.cumsum(positive[order])[last_of_each]
    false = 1 + last_of_each - true
    return (
        np.concatenate([[0.0], true]),
        np.concatenate([[0.0], false]),
        np.concatenate([[np.inf], sorted_scores[last_of_each]]),
    )


def roc_curve(scores: NDArray[Any], positive: NDArray[np.bool_]) -> Curve:
    """Detection rate (y) over false-alarm rate (x); scores at or above the threshold are flagged."""
    true, false, threshold = _counts(scores, positive)
    return Curve(false / max(false[-1], 1.0), true / max(true[-1], 1.0), threshold)


def area_under_roc(scores: NDArray[Any], positive: NDArray[np.bool_]) -> float:
    """Probability that a leak scores higher than a healthy seal (ties count half); NaN without both kinds."""
    if positive.all() or not positive.any():
        return float("nan")
    curve = roc_curve(scores, positive)
    return float(np.trapezoid(curve.y, curve.x))


def precision_recall_curve(scores: NDArray[Any], positive: NDArray[np.bool_]) -> Curve:
    """Precision (y) over recall (x)."""
    true, false, threshold = _counts(scores, positive)
    flagged = true + false
    precision = np.divide(true, flagged, out=np.ones_like(true), where=flagged > 0)
    return Curve(true / max(true[-1], 1.0), precision, threshold)


def average_precision(scores: NDArray[Any], positive: NDArray[np.bool_]) -> float:
    """Area under precision over recall as a sum of steps; NaN without positives."""
    if not positive.any():
        return float("nan")
    curve = precision_recall_curve(scores, positive)
    return float(np.sum(np.diff(curve.x) * curve.y[1:]))


def threshold_at_false_alarm_rate(healthy_scores: NDArray[Any], rate: float) -> float:
    """Lowest threshold that flags at most the share ``rate`` of the healthy scores."""
    ordered = np.sort(np.asarray(healthy_scores, dtype=np.float64))[::-1]
    allowed = int(np.floor(rate * len(ordered)))
    if allowed >= len(ordered):
        return 0.0
    return float(np.nextafter(ordered[allowed], np.inf))


def detection_rate(scores: NDArray[Any], threshold: float) -> float:
    """Share of scores at or above the threshold; NaN without scores."""
    return float(np.mean(np.asarray(scores) >= threshold)) if len(scores) else float("nan")
