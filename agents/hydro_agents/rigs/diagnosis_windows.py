"""Cuts a recording into windows for the detectors."""

from __future__ import annotations

import numpy as np

from hydro_agents.detection.detector import Windows
from hydro_agents.recordings.sampling import Sampled


def cut(samples: Sampled, length: int) -> Windows:
    """Windows of ``length`` samples; a shorter remainder and windows without any sample are left out."""
    window, place = samples.place // length, samples.place % length
    chosen = np.unique(window)
    if len(samples.place):
        chosen = chosen[(chosen + 1) * length <= samples.place[-1] + 1]
    signals = np.full((len(chosen), len(samples.signals), length), np.nan)
    number = np.searchsorted(chosen, window)
    inside = np.isin(window, chosen)
    signals[number[inside], :, place[inside]] = samples.signals[:, inside].T
    begin = np.asarray(chosen * length * samples.period, dtype=np.float64)
    return Windows(signals, begin, begin + length * samples.period)
