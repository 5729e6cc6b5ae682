"""Calibrates a trained head on validation windows: thresholds, intervals, and the bound of "outside"."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.dataset import LEAKS, Windows
from hydro_agents.detection.features import CHANGE, LABELS, SPREAD, STILL
from hydro_agents.detection.head import SMALLEST_FLOW, HeadSettings, LeakageHead, probabilities, quantiles, standardised
from hydro_agents.detection.intervals import GROUPS, SIZES, WIDTHS, groups
from hydro_agents.detection.roc import threshold_at_false_alarm_rate
from hydro_env import TaskConfig

FALSE_ALARM_RATE = 0.01
COVERAGE = 0.9
"""Share of the intervals that contain the true size."""

CHANGING_SHARE = 0.15
"""Share of the windows that are treated as windows with a changing leak."""

LARGEST_SHIFT = 2.0
"""Largest size of the shift of a leak's logit at standstill."""

FEWEST, REACH = 40, 0.2
"""Smallest number of windows for a size, and for standstill; largest distance of a window from the size in decades."""

OUTSIDE_RATE = 0.01
"""Share of validation windows that are marked as unlike the training."""


def size_target(flow_lpm: NDArray[np.float64]) -> NDArray[np.float32]:
    """log10 of the flow, but of at least the smallest flow that counts."""
    return np.log10(np.maximum(flow_lpm, SMALLEST_FLOW)).astype(np.float32)


def distances(quantiles: NDArray[np.float64], size: NDArray[Any], chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """95 % quantile of the distance between truth and middle quantile, at each of SIZES and to each side.

    Args:
        quantiles: 5, 50 and 95 % of log10 of the size, (N, 3).
        size: log10 of the true size, (N,).
        chosen: windows of the group; if it has fewer than FEWEST of a size, all windows of that size are used.

    Returns:
        As a fraction of the distance of the outer quantiles, (SIZES, 2).
    """
    low, middle, high = quantiles.T
    off = np.column_stack([(middle - size) / (middle - low), (size - middle) / (high - middle)])
    found = np.ones((len(SIZES), 2))
    for number, place in enumerate(SIZES):
        near = np.abs(size - place) < REACH
        mine = near & chosen if (near & chosen).sum() >= FEWEST else near
        if mine.any():
            found[number] = np.quantile(off[mine], 0.5 * (1.0 + COVERAGE), axis=0)
    return np.maximum(found, 0.0)


def calibrated(
    tensors: dict[str, NDArray[Any]],
    config: TaskConfig,
    longest: int,
    windows: Windows,
    record: dict[str, Any],
) -> LeakageHead:
    """The head with thresholds, intervals and the bound of "outside" from validation windows.

    Thresholds and intervals come from the windows with the task's own sensors and a laminar leak. The threshold of a
    leak gives 1 % false alarms among healthy axes without other faults, both at standstill and in motion; the threshold
    of any other label gives 1 % among axes without it. Intervals: :mod:`hydro_agents.detection.intervals`.
    """
    inputs = standardised(windows.features, tensors["mean"], tensors["scale"])
    tensors["limit"][0] = np.quantile(np.sqrt(np.sum((inputs @ tensors["whitener"]) ** 2, axis=1)), 1.0 - OUTSIDE_RATE)
    usual = (windows.noise == 1.0) & (windows.leak != LEAKS.index("orifice"))
    windows, inputs = Windows(*(values[usual] for values in windows)), inputs[usual]
    plain = HeadSettings(config, config.steps, longest, 0.5, record)
    output = LeakageHead(tensors, plain).outputs(inputs)
    clean = (windows.fault < 0) & (windows.leak == LEAKS.index("constant")) & (windows.labels[:, 0] == 0.0)
    still = windows.features[:, SPREAD] < STILL
    if min((clean & still).sum(), (clean & ~still).sum()) >= FEWEST:
        logits = [threshold_at_false_alarm_rate(output[clean & here, 0], FALSE_ALARM_RATE) for here in (still, ~still)]
        tensors["still_shift"][0] = np.clip(logits[1] - logits[0], -LARGEST_SHIFT, LARGEST_SHIFT)
    probability = probabilities(output, windows.features, float(tensors["still_shift"][0]))
    for label in range(len(LABELS)):
        without = windows.labels[:, label] == 0.0 if label > 0 else clean
        tensors["thresholds"][label] = threshold_at_false_alarm_rate(probability[without, label], FALSE_ALARM_RATE)
    threshold = min(float(tensors["thresholds"][0]), 1.0)
    found, size = quantiles(output), size_target(windows.flow_lpm)
    tensors["widths"] = np.quantile(found[:, 2] - found[:, 0], np.arange(1, WIDTHS) / WIDTHS).astype(np.float32)
    tensors["changing"][0] = np.quantile(windows.features[:, CHANGE], 1.0 - CHANGING_SHARE)
    group = groups(found, windows.features[:, CHANGE], tensors["widths"], float(tensors["changing"][0]))
    for number in range(GROUPS):
        tensors["widening"][number] = distances(found, size, group == number)
    return LeakageHead(tensors, HeadSettings(config, config.steps, longest, threshold, record))
