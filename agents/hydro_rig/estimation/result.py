"""The result of an estimate: values of the unknowns, their uncertainty, and the errors of the readings."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from hydro_env import ConfigurationError
from hydro_env.types import Floats, Indices, Mask


@dataclass(frozen=True)
class Estimate:
    """Estimates of B windows with P unknowns; values in the units of :mod:`hydro_rig.estimation.unknowns`.

    ``deviations`` are valid where ``holds`` is true. Elsewhere the model does not explain the
    readings, or the search ended in a local minimum; the values are then unreliable.

    ``white``, ``slow``, ``spikes``, ``latency`` and ``rise_time`` are those of the data sheet, unless the readings
    contradict it.
    """

    names: tuple[str, ...]
    values: Floats  # (B, P), most probable values
    deviations: Floats  # (B, P), standard deviations
    remaining: Floats  # (B, P), standard deviation over the prior's, both of the scaled unknown
    chi2_per_sample: Floats  # (B,), about 1 if readings and model differ only by noise
    misfit: Floats  # (B,), standard deviations by which chi2, of samples or of block means, exceeds its expectation
    holds: Mask  # (B,), whether the model explains the readings
    scaled: Floats  # (B, P), the values in standard deviations of the prior from its mean
    white: Floats  # (B, channels), standard deviation of the white noise, over that of the data sheet
    slow: Floats  # (B, channels), the same of the slow error of the model and the sensors
    memory: Floats  # (B, channels), correlation time of the slow error, samples
    spikes: Floats  # (B, channels), share of the readings that are spikes, and were left out
    latency: Floats  # (B,), of the command, s
    rise_time: Floats  # (B,), of the pressure transducers, s
    of_model: Mask  # (B,), whether the slow errors are those of a wrong model
    parts: NDArray[np.object_]  # (B,), names of the parts that the window shows and its rig's file does not tell
    unlikelihood: Floats  # (B,), twice the negative log-likelihood of the readings with their errors; chi2 without

    def __len__(self) -> int:
        return len(self.values)

    def value(self, name: str) -> Floats:
        """Values of one unknown, (B,)."""
        return self.values[:, self._place(name)]

    def deviation(self, name: str) -> Floats:
        """Standard deviations of one unknown, (B,)."""
        return self.deviations[:, self._place(name)]

    def interval(self, name: str, coverage: float = 0.9) -> tuple[Floats, Floats]:
        """Lower and upper end, (B,) each, of the interval that covers the true value with probability ``coverage``."""
        reach = ndtri(0.5 + 0.5 * coverage) * self.deviation(name)
        return self.value(name) - reach, self.value(name) + reach

    def widen(self, scaled: Floats, scale: Floats) -> None:
        """Add a difference of scaled values, (B, P), to the uncertainty; ``scale``: value per scaled value, (B, P)."""
        self.deviations[:] = np.hypot(self.deviations, scaled * scale)
        self.remaining[:] = np.hypot(self.remaining, scaled)

    def part(self, windows: Indices) -> Self:
        """Some of the windows."""
        return replace(self, **{name: getattr(self, name)[windows] for name in _PER_WINDOW})

    def take(self, windows: Indices, by: Self, better: Mask) -> Indices:
        """Replace windows, (C,), by those of another estimate that are ``better``, (C,); returns the replaced ones.

        Further unknowns of the other estimate, behind those of this one, are left out.
        """
        for name in _PER_WINDOW:
            own, other = getattr(self, name), getattr(by, name)[better]
            own[windows[better]] = other[(slice(None), *map(slice, own.shape[1:]))]
        return windows[better]

    def _place(self, name: str) -> int:
        if name not in self.names:
            raise ConfigurationError(f"estimate: '{name}' was not among the unknowns: {', '.join(self.names)}")
        return self.names.index(name)


_PER_WINDOW = tuple(field.name for field in fields(Estimate) if field.name != "names")


def join(parts: Sequence[Estimate]) -> Estimate:
    """The windows of several estimates with the same unknowns, one after another."""
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _PER_WINDOW}
    return Estimate(names=parts[0].names, **joined)
