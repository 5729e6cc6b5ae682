"""The held-back parts of recordings beside a simulation of the identified rig: errors of position, speed, pressures."""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from hydro_agents.running.text import number
from hydro_env import PlantParameters, TaskConfig
from hydro_env.plant.parameters import to_vector
from hydro_env.task.sensors import COMMAND, POSITION, PRESSURE_A, PRESSURE_B, SENSORS
from hydro_env.types import Floats, Mask
from hydro_rig.estimation.estimate import estimate
from hydro_rig.estimation.model import Model, noise_of
from hydro_rig.estimation.unknowns import (
    BIASES,
    GAINS,
    LATENCY,
    NULL_DRIFT,
    RISE_TIME,
    Prior,
    Priors,
    priors_of,
    starts_of,
)
from hydro_rig.recordings.parts import Stretch

JUDGED_OVER = 2.0
"""s, over which forecasts from the measured state are judged, beside the whole held-back part. They decide where errors
add up, because nothing holds the axis."""

FORECAST_EVERY = 2.0  # s, from the beginning of a forecast to that of the next
FORECAST_FROM = 2.0  # s before a forecast, which show its state and how far the null of the valve has wandered
START_FROM = 0.2  # s; the initial state comes from this first part; afterwards the simulation uses only the commands
LEAST_MOTION = 20.0  # standard deviation of a channel over its noise, for a meaningful share of variance
CERTAIN = 1e-7  # s, standard deviation of a timing that the fit has found
SPEED_OVER = 0.05  # s, over which a speed is a difference of positions
NO_FORECASTS = np.empty((2, 0, len(SENSORS), 0))


class Forecast(NamedTuple):
    """How well the held-back parts are predicted over some time from the measured state, or as a whole."""

    share: Floats  # (channels,), share of variance explained; NaN: absent, or without motion
    error: Floats  # (channels,), root mean square, SI; NaN: absent
    speed_error: float  # root mean square, m/s; NaN if the axis stood still or left the sensor's range


class HeldBack(NamedTuple):
    """A held-back part, measured and simulated."""

    recording: int  # its number, from 0
    begin: float  # s
    time: Floats  # (T,), s, from its begin
    measured: Floats  # (channels, T), SI
    simulated: Floats  # (channels, T), SI, biases included
    moves: Mask  # (channels,), whether a channel moves so far that its share of variance has a meaning
    forecasts: Floats = NO_FORECASTS  # (2, N, channels, T'), measured and simulated over JUDGED_OVER, SI

    @property
    def whole(self) -> Forecast:
        """How well this part is simulated as a whole."""
        return whole_parts([self])

    def _speed(self, readings: Floats) -> Floats:
        """Speed in m/s, (…, T − k), over SPEED_OVER, from readings (…, channels, T)."""
        position = readings[..., POSITION, :]
        step = max(round(SPEED_OVER / self.period), 1)
        return (position[..., step:] - position[..., :-step]) / (step * self.period)

    @property
    def period(self) -> float:
        """Time from one sample to the next, s."""
        return self.time[1] - self.time[0]


def simulate_held_back(
    part: Stretch, config: TaskConfig, plant: PlantParameters, known: Mapping[str, float]
) -> HeldBack:
    """Simulate a plant on a held-back part; only the initial state comes from its readings, in the first 0.2 s.

    It begins where the position is known, which may end at the end of its sensor's range. ``known``: found biases and
    gains of the sensors, latency and rise time, by name; others count here for nothing.
    """
    timing = {name: Prior(known[name], CERTAIN) for name in (LATENCY, RISE_TIME, *GAINS) if name in known}
    rig = _Rig(config, to_vector(plant), np.array([known.get(name, 0.0) for name in BIASES])[:, None], timing)
    period, count = config.control_period, max(round(START_FROM / config.control_period), 10)
    first = _first_known(part.signals[POSITION], count)
    signals, edge = part.signals[:, first:], part.boundary[:, first:]
    measured = signals[:COMMAND]
    (simulated,) = rig.simulated(signals[None], edge[None], count)
    time = period * np.arange(signals.shape[1], dtype=float)
    moves = [
        np.isfinite(values).any() and np.nanstd(values) >= LEAST_MOTION * noise
        for values, noise in zip(measured, noise_of(config), strict=True)
    ]
    forecasts = rig.forecasts(signals, edge)
    return HeldBack(part.recording, part.begin + first * period, time, measured, simulated, np.array(moves), forecasts)


class _Rig(NamedTuple):
    """An identified rig, to be simulated."""

    config: TaskConfig
    physical: Floats  # parameters of its plant
    bias: Floats  # (channels, 1), SI
    timing: Priors  # found timing and gains, where those of the task do not hold

    def forecasts(self, signals: Floats, edge: Floats) -> Floats:
        """Measured and simulated readings of forecasts from states along a part, (2, N, channels, T)."""
        period = self.config.control_period
        count = round(FORECAST_FROM / period)
        whole = count + round(JUDGED_OVER / period)
        known = np.isfinite(signals[POSITION])
        places = range(0, signals.shape[1] - whole + 1, round(FORECAST_EVERY / period))
        starts = [k for k in places if known[k : k + count].mean() > 0.5]
        if not starts:
            return NO_FORECASTS
        inside = np.array(starts)[:, None] + np.arange(whole)
        windows, boundary = (np.moveaxis(values[:, inside], 0, 1) for values in (signals, edge))
        return np.stack([windows[:, :COMMAND], self.simulated(windows, boundary, count, NULL_DRIFT)])[..., count:]

    def simulated(self, windows: Floats, boundary: Floats, count: int, *more: str) -> Floats:
        """Readings (N, channels, T) of windows (N, 5, T), simulated from what their first ``count`` periods say.

        That is their start, and ``more`` unknowns.
        """
        config, names = self.config, (*starts_of(self.config), *self.timing, *more)
        unbiased = np.concatenate([windows[:, :COMMAND] - self.bias, windows[:, COMMAND, None]], axis=1)
        first, early = (values[:, :, : count + 1] for values in (unbiased, boundary))
        plants = np.tile(self.physical, (len(windows), 1))
        found = estimate(first, config, names, priors=self.timing, physical=plants, boundary=early)
        priors = priors_of(config, names, self.timing)
        model = Model(config, priors, windows[:, COMMAND], physical=plants, boundary=boundary)
        return model.readings(found.scaled) * model.noise[:, None] + self.bias


def forecast(parts: Sequence[HeldBack]) -> Forecast | None:
    """All forecasts over JUDGED_OVER together; ``None``: no part is so long."""
    pieces = [(part, part.forecasts) for part in parts if part.forecasts.size]
    return _judged(pieces) if pieces else None


def whole_parts(parts: Sequence[HeldBack]) -> Forecast:
    """The parts as a whole, where errors add up."""
    return _judged([(part, np.stack([part.measured, part.simulated])[:, None]) for part in parts])


def _judged(pieces: Sequence[tuple[HeldBack, Floats]]) -> Forecast:
    """How well pieces of parts are simulated; each (2, N, channels, T), measured and simulated."""
    shares, errors = [], []
    for row in range(len(SENSORS)):
        moving = (zip(*both[:, :, row], strict=True) for part, both in pieces if part.moves[row])
        shares.append(_share(chain.from_iterable(moving)))
        errors.append(_size([both[1, :, row] - both[0, :, row] for _, both in pieces]))
    speed = _size([part._speed(both[1]) - part._speed(both[0]) for part, both in pieces])
    return Forecast(np.array(shares), np.array(errors), speed)


def _size(errors: Sequence[Floats]) -> float:
    """Root mean square of all numbers; NaN without any."""
    whole = np.concatenate([np.ravel(each) for each in errors])
    known = whole[np.isfinite(whole)]
    return math.sqrt(known @ known / len(known)) if len(known) else math.nan


def _share(pairs: Iterable[tuple[Floats, Floats]]) -> float:
    """Share of the variance of measured signals that their simulations explain: 1 − sum of square errors over squares.

    The squares are those of the measured signal about its mean in each part; −∞ after a failure, NaN without a reading.
    """
    known = [(own[seen], other[seen]) for own, other in pairs if (seen := np.isfinite(own)).any()]
    if not known:
        return math.nan
    square = sum(np.sum((own - other) ** 2) for own, other in known)
    variance = sum(len(own) * own.var() for own, _ in known)
    return 1.0 - square / max(variance, 1e-300) if math.isfinite(square) else -math.inf


def _first_known(position: Floats, count: int) -> int:
    """The first sample from which most of ``count`` positions are known: without them no simulation can start."""
    known = np.convolve(np.isfinite(position), np.ones(count), mode="valid") > 0.5 * count
    return int(known.argmax())


def sizes_of(errors: Forecast) -> list[float]:
    """Errors of position (mm), speed (mm/s) and both pressures (bar); NaN: none."""
    position, pressures = 1e3 * errors.error[POSITION], 1e-5 * errors.error[[PRESSURE_A, PRESSURE_B]]
    return [position, 1e3 * errors.speed_error, *pressures]


def errors_in_words(errors: Forecast) -> str:
    """Errors in mm, mm/s and bar; empty without any."""
    sizes = zip(sizes_of(errors), ("mm", "mm/s", "bar (a)", "bar (b)"), strict=True)
    return ", ".join(f"{number(size, digits=2)} {unit}" for size, unit in sizes if not math.isnan(size))
