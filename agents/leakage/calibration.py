"""What a trained head learns from validation windows: thresholds, intervals, and the bound of its training."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.leakage.dataset import Windows
from agents.leakage.features import LABELS, MOTION
from agents.leakage.head import (
    GROUPS,
    SMALLEST_FLOW,
    HeadSettings,
    LeakageHead,
    groups,
    quantiles,
    standardised,
)
from agents.leakage.metrics import threshold_at_false_alarm_rate
from hydro_env import TaskConfig

FALSE_ALARM_RATE = 0.01
COVERAGE = 0.9
"""Share of the intervals that hold the true size."""

OUTSIDE_RATE = 0.01
"""Share of validation windows that count as unlike the training."""


def size_target(flow_lpm: NDArray[np.float64]) -> NDArray[np.float32]:
    """log10 of the flow, at least that of the smallest flow that counts."""
    return np.log10(np.maximum(flow_lpm, SMALLEST_FLOW)).astype(np.float32)


def calibrated(
    tensors: dict[str, NDArray[Any]],
    config: TaskConfig,
    longest: int,
    windows: Windows,
    record: dict[str, Any],
) -> LeakageHead:
    """The head with thresholds, intervals and the bound of "outside" from validation windows.

    A leak is flagged at 1 % false alarms among healthy axes without other faults, any other label at 1 % among axes
    that do not have it. The intervals are widened by conformal factors, one for each end and group of windows (Romano,
    Patterson & Candès 2019, *Conformalized Quantile Regression*).
    """
    inputs = standardised(windows.features, tensors["mean"], tensors["scale"])
    tensors["limit"][0] = np.quantile(np.sqrt(np.sum((inputs @ tensors["whitener"]) ** 2, axis=1)), 1.0 - OUTSIDE_RATE)
    tensors["motion"][0] = np.median(windows.features[:, MOTION])
    plain = HeadSettings(config, config.steps, longest, 0.5, record)
    output = LeakageHead(tensors, plain).outputs(inputs)
    probability = 1.0 / (1.0 + np.exp(-output[:, : len(LABELS)]))
    clean, threshold = windows.fault < 0, 1.0
    for label in range(len(LABELS)):
        without = (windows.labels[:, label] == 0.0) & (clean if label == 0 else True)
        found = threshold_at_false_alarm_rate(probability[without, label], FALSE_ALARM_RATE)
        tensors["thresholds"][label] = found
        threshold = min(found, 1.0) if label == 0 else threshold
    low, middle, high = quantiles(output).T
    size = size_target(windows.flow_lpm)
    group = groups(windows.features, probability[:, 0], threshold, float(tensors["motion"][0]))
    tail = 0.5 * (1.0 + COVERAGE)
    for number in range(GROUPS):
        mine = group == number
        if mine.sum() >= 20:
            tensors["widening"][number] = (
                np.quantile(((middle - size) / (middle - low))[mine], tail),
                np.quantile(((size - middle) / (high - middle))[mine], tail),
            )
    tensors["widening"] = np.maximum(tensors["widening"], 0.1)
    return LeakageHead(tensors, HeadSettings(config, config.steps, longest, threshold, record))
