"""Rates of rare events: from counted alarms, and from a fitted tail where the simulated hours are too short to count.

Alarms are counted as excursions: the evidence of an axis rises above zero, passes the threshold at its peak, and
returns. Where alarms can be counted, their rate has the exact Poisson interval (Garwood, *Fiducial limits for the
Poisson distribution*, Biometrika 28, 1936). Beyond the simulated hours a generalised Pareto distribution is fitted to
the highest peaks (Pickands, *Statistical inference using extreme order statistics*, Annals of Statistics 3, 1975). Its
shape is zero or positive: the peaks of a CUSUM have an exponential tail, shape 0, for each axis (Cramér and Lundberg),
and a mixture of different axes has a heavier one. The interval comes from resampling the axes, because alarms cluster
on a few of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import chi2

from hydro_agents.running.statistics import CONFIDENCE, Interval
from hydro_env import ConfigurationError

Floats = NDArray[np.float64]
RESAMPLES = 200


def poisson_interval(count: int, exposure: float, confidence: float = CONFIDENCE) -> Interval:
    """Rate of events per unit of exposure, with its exact interval (Garwood 1936).

    Raises:
        ConfigurationError: the exposure is not positive, or the count negative.
    """
    if not exposure > 0.0 or count < 0:
        raise ConfigurationError(f"rate: {count} events in {exposure:g}: exposure must be positive, count not negative")
    outside = 0.5 * (1.0 - confidence)
    low = 0.5 * float(chi2.ppf(outside, 2 * count)) if count else 0.0
    return Interval(count / exposure, low / exposure, 0.5 * float(chi2.ppf(1.0 - outside, 2 * count + 2)) / exposure)


def peaks(total: NDArray[Any]) -> list[Floats]:
    """Highest value of each excursion above zero, for each of N axes, from the evidence over time (N, L)."""
    result = []
    for row in np.asarray(total, dtype=np.float64):
        above = np.concatenate([[0], (row > 0.0).astype(np.int8), [0]])
        edges = np.flatnonzero(np.diff(above))
        starts, ends = edges[::2], edges[1::2]
        result.append(np.array([row[first:last].max() for first, last in zip(starts, ends, strict=True)]))
    return result


@dataclass(frozen=True)
class Tail:
    """Generalised Pareto tail of the peaks above ``start``."""

    start: float
    rate: float  # peaks above the start per hour
    scale: float
    shape: float  # 0: exponential

    def rate_above(self, threshold: float) -> float:
        """Peaks above a threshold (at least ``start``) per hour."""
        excess = max(threshold - self.start, 0.0) / self.scale
        return self.rate * float(
            np.exp(-excess) if self.shape < 1e-9 else (1.0 + self.shape * excess) ** (-1.0 / self.shape)
        )

    def threshold_at(self, rate: float) -> float:
        """Threshold that peaks exceed ``rate`` times per hour; at least ``start``."""
        ratio = self.rate / rate
        if ratio <= 1.0:
            return self.start
        gain = np.log(ratio) if self.shape < 1e-9 else (ratio**self.shape - 1.0) / self.shape
        return self.start + self.scale * float(gain)


def fit_tail(values: Floats, hours: float, highest: int = 100) -> Tail:
    """Tail of the ``highest`` peaks (all, if there are fewer) in ``hours``, by maximum likelihood.

    Raises:
        ConfigurationError: fewer than 10 peaks.
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64))[::-1]
    if len(ordered) < 10:
        raise ConfigurationError(
            f"alarms: {len(ordered)} peaks of evidence are too few for a tail: must be at least 10; simulate more hours"
        )
    kept = min(highest, len(ordered) - 1)
    start = float(ordered[kept])
    excess = ordered[:kept] - start
    mean = max(float(excess.mean()), 1e-12)

    def cost(parameters: Floats) -> float:
        scale, shape = mean * np.exp(parameters[0]), max(parameters[1], 0.0)
        if shape < 1e-9:
            return float(np.log(scale) + mean / scale)
        return float(np.log(scale) + (1.0 + 1.0 / shape) * np.mean(np.log1p(shape * excess / scale)))

    best = minimize(cost, np.array([-0.1, 0.1]), bounds=[(-5.0, 5.0), (0.0, 2.0)], method="L-BFGS-B")
    return Tail(start, kept / hours, mean * float(np.exp(best.x[0])), float(best.x[1]))


def rate_with_interval(
    per_axis: list[Floats], hours: float, threshold: float, highest: int = 100, seed: int = 0
) -> Interval:
    """Alarms per 100 h at a threshold, from the tail, with a 95 % interval from resampled axes."""
    generator = np.random.default_rng(seed)
    rates = []
    for number in range(RESAMPLES + 1):
        chosen = np.arange(len(per_axis)) if number == 0 else generator.integers(0, len(per_axis), len(per_axis))
        tail = fit_tail(np.concatenate([per_axis[axis] for axis in chosen]), hours, highest)
        rates.append(100.0 * tail.rate_above(threshold))
    low, high = np.quantile(rates[1:], [0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)])
    return Interval(rates[0], float(low), float(high))
