"""Settling time of an oscillation that rides on a slow drift, from clean and from noisy accelerations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, hilbert, sosfiltfilt

Array = NDArray[np.float64]

SETTLED = 0.1
"""m/s²; the paper calls the axis settled below this (ε_a)."""


def drift(values: Array, sample_time: float, frequency: float) -> Array:
    """The mean over one period of the oscillation (``frequency`` in rad/s): what is not oscillation."""
    width = max(round(2 * np.pi / frequency / sample_time), 1)
    before = width // 2
    padded = np.pad(values, (before, width - 1 - before), mode="edge")
    sums = np.cumsum(np.concatenate([[0.0], padded]))
    mean: Array = (sums[width:] - sums[:-width]) / width
    return mean


def envelope(time: Array, values: Array) -> Array:
    """|values| interpolated in the logarithm between its peaks; equal to the last peak's decay beyond it."""
    size = np.abs(values)
    peaks = np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:])) + 1
    if len(peaks) == 0:
        return size
    outline: Array = np.exp(np.interp(time, time[peaks], np.log(size[peaks] + 1e-12)))
    return outline


def swing_envelope(time: Array, values: Array, frequency: float) -> Array:
    """Envelope of what oscillates in ``values`` at about ``frequency`` (rad/s), the drift taken off."""
    sample_time = float(time[1] - time[0])
    return envelope(time, values - drift(values, sample_time, frequency))


def last_above(time: Array, values: Array, level: float = SETTLED) -> float:
    """Last time at which ``values`` exceeds ``level``; 0 where it never does."""
    above = np.flatnonzero(values > level)
    return float(time[above[-1]]) if len(above) else 0.0


def band_envelope(values: Array, sample_time: float, frequency: float, width: float = 0.3) -> Array:
    """Envelope of the part of a noisy signal within ``frequency`` (rad/s) × (1 ± width).

    A band-pass of second order run forwards and backwards (no delay), then the size of the analytic signal. White
    noise loses the share of its power that lies outside the band.
    """
    hertz = frequency / (2 * np.pi)
    band: Any = butter(2, [hertz * (1 - width), hertz * (1 + width)], "bandpass", fs=1 / sample_time, output="sos")
    size: Array = np.abs(hilbert(sosfiltfilt(band, values)))
    return size
