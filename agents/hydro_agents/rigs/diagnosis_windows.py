"""Cuts a recording into windows for the detectors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.recordings.columns import COMMAND
from hydro_agents.recordings.sampling import Sampled

Floats = NDArray[np.float64]


class Windows(NamedTuple):
    """B windows of L samples, one after the other; a sample that is missing is NaN."""

    begin: Floats  # (B,), s
    end: Floats  # (B,), s
    signals: Floats  # (B, 5, L), SI

    @property
    def commanded(self) -> NDArray[np.bool_]:
        """Windows whose commands are all known, (B,): a simulation needs every command."""
        return np.asarray(np.isfinite(self.signals[:, COMMAND]).all(axis=1))

    @property
    def whole(self) -> NDArray[np.bool_]:
        """Windows without a missing reading, (B,)."""
        return np.asarray(np.isfinite(self.signals).all(axis=(1, 2)))

    def part(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> Windows:
        """Some of the windows."""
        return Windows(*(values[chosen] for values in self))


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
    return Windows(begin, begin + length * samples.period, signals)
