"""The held-back parts of recordings beside a simulation of the identified rig: errors of position, speed, pressures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from hydro_agents.running.text import number
from hydro_env import PlantParameters, TaskConfig
from hydro_env.plant.parameters import to_vector
from hydro_env.task.sensors import COMMAND, POSITION, SENSORS
from hydro_env.types import Floats
from hydro_rig.estimation.estimate import estimate
from hydro_rig.estimation.model import Model, noise_of
from hydro_rig.estimation.unknowns import Prior, priors_of, starts_of
from hydro_rig.recordings.parts import Stretch

START_FROM = 0.2  # s; the initial state comes from this first part; afterwards the simulation uses only the commands
LEAST_MOTION = 20.0
"""Smallest standard deviation of a channel, as a multiple of its noise, for a meaningful share of variance."""

CERTAIN = 1e-7  # s, standard deviation of a timing that the fit has found
SPEED_OVER = 0.05  # s, over which a speed is a difference of positions
MOVING = 0.3  # of the largest speed: above, the axis moves, and its simulated speed is compared with the measured one
PRESSURES = tuple(SENSORS.index(name) for name in ("pressure_a", "pressure_b"))


class HeldBack(NamedTuple):
    """A held-back part, measured and simulated."""

    recording: int  # its number, from 0
    begin: float  # s
    time: Floats  # (T,), s, from its begin
    measured: Floats  # (channels, T), SI
    simulated: Floats  # (channels, T), SI, biases included
    share: Floats  # (channels,), share of variance explained; NaN for an absent channel, or one without motion

    @property
    def error(self) -> Floats:
        """Root mean square of simulated minus measured readings, SI, (channels,); NaN for an absent channel."""
        return _root_mean_square(self.simulated - self.measured)

    @property
    def speed_error(self) -> float:
        """Root mean square of the error of the speed, m/s; NaN if the axis stood still or left the sensor's range."""
        measured, simulated = self._speeds()
        return float(_root_mean_square((simulated - measured)[None])[0])

    @property
    def speed_ratios(self) -> tuple[float, float]:
        """Simulated over measured speed while both move, minus 1, median, extending and retracting; NaN: no motion."""
        measured, simulated = self._speeds()
        least = MOVING * np.nanmax(np.abs(measured), initial=0.0) if np.isfinite(measured).any() else math.inf
        ratios = []
        for sign in (1.0, -1.0):
            both = (sign * measured > least) & (sign * simulated > least) & (least > 0.0)
            ratios.append(float(np.median(simulated[both] / measured[both])) - 1.0 if both.any() else math.nan)
        return ratios[0], ratios[1]

    def _speeds(self) -> tuple[Floats, Floats]:
        """Measured and simulated speed, m/s, (T − k,)."""
        step = max(round(SPEED_OVER / (self.time[1] - self.time[0])), 1)
        away = self.time[step:] - self.time[:-step]
        measured, simulated = (
            (values[POSITION, step:] - values[POSITION, :-step]) / away for values in (self.measured, self.simulated)
        )
        return measured, simulated


def _root_mean_square(errors: Floats) -> Floats:
    """Of each row, (channels,); NaN without a number."""
    known = np.isfinite(errors)
    square: Floats = np.where(known, errors, 0.0) ** 2
    root: Floats = np.sqrt(square.sum(axis=1) / np.where(known.any(axis=1), known.sum(axis=1), np.nan))
    return root


def simulate_held_back(
    part: Stretch,
    config: TaskConfig,
    plant: PlantParameters,
    biases: Sequence[float],
    timing: Mapping[str, float] = MappingProxyType({}),
) -> HeldBack:
    """Simulate a plant on a held-back part; only the initial state comes from its readings, in the first 0.2 s.

    It begins where the position is known, which may end at the end of its sensor's range.

    Args:
        part: of a recording.
        config: the task.
        plant: the identified plant.
        biases: of each channel, SI.
        timing: found latency and rise time by name, s, where those of the task do not hold.
    """
    period, count = config.control_period, max(round(START_FROM / config.control_period), 10)
    first = _first_known(part.signals[POSITION], count)
    signals = part.signals[:, first:]
    bias = np.asarray(biases)[:, None]
    measured = signals[: len(SENSORS)]
    unbiased = np.concatenate([measured - bias, signals[None, COMMAND]])
    physical = to_vector(plant)[None]
    names, fixed = (*starts_of(config), *timing), {name: Prior(value, CERTAIN) for name, value in timing.items()}
    edge = None if part.boundary is None else part.boundary[None, :, first:]
    early = None if edge is None else edge[:, :, : count + 1]
    found = estimate(unbiased[None, :, : count + 1], config, names, priors=fixed, physical=physical, boundary=early)
    model = Model(config, priors_of(config, names, fixed), signals[None, COMMAND], physical=physical, boundary=edge)
    read, _ = model.readings(found.scaled, np.zeros(1, np.int64))
    simulated = read[0] * model.noise[:, None] + bias
    time = period * np.arange(signals.shape[1], dtype=np.float64)
    motion = np.array([np.nanstd(row) if np.isfinite(row).any() else 0.0 for row in measured])
    share = np.array([_share([pair]) for pair in zip(measured, simulated, strict=True)])
    share[motion < LEAST_MOTION * noise_of(config)] = np.nan
    return HeldBack(part.recording, part.begin + first * period, time, measured, simulated, share)


def _first_known(position: Floats, count: int) -> int:
    """The first sample from which most of ``count`` positions are known: without them no simulation can start."""
    known = np.convolve(np.isfinite(position), np.ones(count), mode="valid") > 0.5 * count
    return int(known.argmax())


def share_of_all(parts: Sequence[HeldBack]) -> Floats:
    """Share of the variance explained in all held-back parts together, (channels,); NaN: absent, or without motion."""
    shares = np.full(len(SENSORS), np.nan)
    for row in range(len(SENSORS)):
        moved = [part for part in parts if not math.isnan(part.share[row])]
        if moved:
            shares[row] = _share([(part.measured[row], part.simulated[row]) for part in moved])
    return shares


def _share(pairs: Sequence[tuple[Floats, Floats]]) -> float:
    """Share of the variance of measured signals that their simulations explain: 1 − sum of square errors over squares.

    The squares are those of the measured signal about its mean in each part; −∞ after a failure, NaN without a reading.
    """
    square = variance = 0.0
    known_any = False
    for measured, simulated in pairs:
        known = np.isfinite(measured)
        if known.any():
            known_any = True
            square += float(np.sum((measured[known] - simulated[known]) ** 2))
            variance += float(known.sum() * measured[known].var())
    share = 1.0 - square / max(variance, 1e-300) if known_any else float("nan")
    return share if np.isfinite(share) or not known_any else float("-inf")


def errors_in_words(parts: Sequence[HeldBack]) -> str:
    """Errors of the held-back parts in mm, mm/s and bar, each the root mean square of all parts; empty without any."""
    weights = np.array([len(part.time) for part in parts], dtype=np.float64)

    def together(errors: Floats) -> float:
        known = np.isfinite(errors)
        return math.sqrt(np.average(errors[known] ** 2, weights=weights[known])) if known.any() else math.nan

    found = np.array([part.error for part in parts])
    position, speed = together(found[:, POSITION]), together(np.array([part.speed_error for part in parts]))
    phrases = [] if math.isnan(position) else [f"{number(1e3 * position, digits=2)} mm"]
    phrases += [] if math.isnan(speed) else [f"{number(1e3 * speed, digits=2)} mm/s"]
    pressures = [together(found[:, row]) for row in PRESSURES]
    if not all(map(math.isnan, pressures)):
        words = [f"{number(1e-5 * p, digits=2)} bar ({n})" for n, p in zip("ab", pressures, strict=True) if p == p]
        phrases.append(" and ".join(words))
    return ", ".join(phrases)
