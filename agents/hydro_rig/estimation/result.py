"""The result of an estimate: values of the unknowns, their uncertainty, and the errors of the readings.

The residuals of a fit show what the data sheet of the sensors does not say: a channel that scatters more, and a model
that is slightly wrong. The slow error of a channel is a first-order Gauss–Markov process, x(k+1) = φ x(k) + w(k) with
the correlation φ = exp(−1 / memory) from sample to sample. A Kalman filter of this process (Brown and Hwang,
*Introduction to Random Signals and Applied Kalman Filtering*, 2012) turns residuals into independent ones of unit
variance: the least squares of :mod:`hydro_rig.estimation.solver` then weigh them rightly.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from hydro_env import ConfigurationError
from hydro_env.compiling import SOURCES, compiled
from hydro_env.types import Floats, Indices, Mask

MEMORIES = np.array([2.0, 6.0, 20.0, 60.0, 200.0])  # samples; candidates of the slow error's correlation time
RATIOS = np.array([0.0, 0.1, 0.2, 0.4, 0.7, 1.2, 2.0, 4.0, 8.0, 16.0, 40.0])  # slow error over white noise; candidates
WORTH = 6.0  # least gain of twice the log-likelihood by which a slow error is believed
SLOW = 1.0  # slow error that the data sheet does not explain, in standard deviations of its noise
SHORT = 2.0  # samples; memory of noise that looks like a slow error
LASTING = 0.05  # of the window; least memory of a slow error that is no coloured noise
NOISY = 1.1  # white noise over that of the data sheet from which on a channel contradicts it
LEAST_WHITE = 0.1  # smallest white noise, over that of the data sheet
SPIKE = 5.0  # robust standard deviations from the median of its neighbours beyond which a residual is a spike
LEAST_SPIKE = 4.0  # the same, in standard deviations of the data sheet's noise
MOST_SPIKES = 0.2  # share of a channel; with more of them, the channel is not described by spikes
_NEIGHBOURS = 5


class Errors(NamedTuple):
    """Errors of the channels of B windows, over the noise of the data sheet; each (B, channels)."""

    white: Floats  # standard deviation of the white noise
    slow: Floats  # standard deviation of the slow error; 0: none
    memory: Floats  # its correlation time, samples

    @classmethod
    def of_data_sheet(cls, windows: int, channels: int) -> Self:
        """White noise as the data sheet says."""
        return cls(np.ones((windows, channels)), np.zeros((windows, channels)), np.ones((windows, channels)))

    def of_model(self, samples: int) -> Mask:
        """Windows in which several channels differ, at least one of them lastingly, (B,): the model is wrong."""
        differ = (self.slow > SLOW) & (self.memory > SHORT)
        return (differ.sum(axis=1) > 1) & (differ & (self.memory >= LASTING * samples)).any(axis=1)

    def as_white(self, count: Floats, samples: int) -> Self:
        """White noise with which no combination of ``count`` readings, (B, channels), is surer than with these errors.

        Coloured noise is as strong at each frequency as at the lowest; a lasting slow error has its norm everywhere.
        """
        keep = np.exp(-1.0 / self.memory)
        times = np.where(self.memory < LASTING * samples, (1.0 + keep) / (1.0 - keep), count)
        return self._replace(white=np.sqrt(self.white**2 + times * self.slow**2), slow=np.zeros_like(times))

    def part(self, chosen: Any) -> Self:
        """Errors of some of the windows."""
        return type(self)(*(values[chosen] for values in self))


def errors_of(residual: Floats, known: Mask) -> tuple[Errors, Floats]:
    """The most likely errors of residuals (B, channels, T), and twice their negative log-likelihood, (B,).

    Residuals are over the noise of the data sheet; only the ``known`` ones exist.
    """
    errors, likelihood = Errors.of_data_sheet(*residual.shape[:2]), np.zeros(len(residual))
    for place in zip(*np.nonzero(known.any(axis=2)), strict=True):
        white, errors.slow[place], errors.memory[place], cost = _most_likely(
            residual[place], known[place], MEMORIES, RATIOS
        )
        errors.white[place] = max(white, LEAST_WHITE)
        likelihood[place[0]] += cost
    return errors, likelihood


def whitened(values: Floats, known: Mask, errors: Errors) -> Floats:
    """Independent values of unit variance, (B, …, channels, T), from values with these errors; 0 if not ``known``.

    The filter is linear: it serves residuals and derivatives alike.
    """
    shape = values.shape
    inner = np.ascontiguousarray(values.reshape(shape[0], -1, *shape[-2:]))
    result = np.zeros_like(inner)
    _whiten(inner, np.ascontiguousarray(known), *errors, result)
    return result.reshape(shape)


def spikes_of(residual: Floats, known: Mask) -> Mask:
    """Single readings that stand out from their neighbours, (B, channels, T)."""
    filled = np.where(known, residual, 0.0)
    away = np.abs(filled - median_filter(filled, size=(1, 1, _NEIGHBOURS), mode="nearest"))
    away = np.where(known, away, np.where(known.any(axis=2, keepdims=True), np.nan, 0.0))  # 0: an absent channel
    with np.errstate(invalid="ignore"):
        usual = 1.483 * np.nanmedian(away, axis=2, keepdims=True)
        spikes = known & (away > np.maximum(SPIKE * np.nan_to_num(usual), LEAST_SPIKE))
    spikes &= spikes.sum(axis=2, keepdims=True) <= MOST_SPIKES * known.sum(axis=2, keepdims=True)
    return spikes


def _build(sources: int) -> tuple[Any, Any]:
    def most_likely(
        residual: Floats, known: Mask, memories: Floats, ratios: Floats
    ) -> tuple[float, float, float, float]:
        assert sources >= 0  # keys numba's cache
        best = (1.0, 0.0, 1.0, np.inf)
        for ratio in ratios:
            for memory in memories:
                keep = math.exp(-1.0 / memory)
                steady = ratio * ratio
                mean, variance, square, logarithms, count = 0.0, steady, 0.0, 0.0, 0
                for sample in range(len(residual)):
                    if known[sample]:
                        away, total = residual[sample] - mean, variance + 1.0
                        square += away * away / total
                        logarithms += math.log(total)
                        count += 1
                        mean += variance / total * away
                        variance = variance / total
                    mean *= keep
                    variance = keep * keep * variance + (1.0 - keep * keep) * steady
                scale = max(square / count, 1e-12)
                cost = count * (math.log(scale) + 1.0) + logarithms + (WORTH if ratio > 0.0 else 0.0)
                if cost < best[3]:
                    best = (math.sqrt(scale), ratio * math.sqrt(scale), memory, cost)
                if ratio == 0.0:
                    break
        return best

    def whiten(values: Floats, known: Mask, white: Floats, slow: Floats, memory: Floats, result: Floats) -> None:
        assert sources >= 0
        for window in range(values.shape[0]):
            for channel in range(values.shape[2]):
                noise, steady = white[window, channel] ** 2, slow[window, channel] ** 2
                keep = math.exp(-1.0 / memory[window, channel])
                for row in range(values.shape[1]):
                    mean, variance = 0.0, steady
                    for sample in range(values.shape[3]):
                        if known[window, channel, sample]:
                            away = values[window, row, channel, sample] - mean
                            total = variance + noise
                            result[window, row, channel, sample] = away / math.sqrt(total)
                            mean += variance / total * away
                            variance = variance * noise / total
                        mean *= keep
                        variance = keep * keep * variance + (1.0 - keep * keep) * steady

    return compiled(most_likely), compiled(whiten)


_most_likely, _whiten = _build(SOURCES)


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
