"""The leak past the piston from a measured flow: a balance of volumes over steady moves, which needs no valve.

In steady motion the oil that flows into chamber a moves the piston and passes the gap:

    Q = A v + V/β dp_a/dt + G (p_a − p_b)

Area, stiffness and leak are fitted to means over short blocks by robust regression (bisquare: Beaton and Tukey
1974, *Technometrics* 16), which leaves out blocks where a relief valve opens. Blocks of one move share their errors:
the covariance is that of clusters (Liang and Zeger 1986, *Biometrika* 73).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hydro_env.types import Floats, Indices
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

SAME_AREA = 0.1
"""Largest difference of the fitted piston area from that of the rig. Flow meters and displacements of pumps are right
within a few per cent; neighbouring bores of ISO 3320 differ by more than 40 % in area, units by 20 % and more."""

BLOCK = 0.5  # s, over which flow, speed and pressures are averaged
QUARTERS = 4  # of a block, whose speeds show whether it is steady
STEADY = 0.2  # largest range of their speeds, as a share of the mean
LEAST_SPEED = 0.05  # as a share of the speed that 95 % of the blocks do not exceed
FEWEST_MOVES = 6
OUTLIER = 4.685  # of the bisquare, standard deviations; 95 % efficient for normal errors
ROUNDS = 50
COVERAGE = 0.9


class VolumeLeak(NamedTuple):
    """A leak with its 90 % interval, l/min at 100 bar; NaN without an answer."""

    value: float
    low: float
    high: float
    area: float  # m², effective area of the piston in chamber a
    moves: int  # steady ones
    rest: float  # unexplained share of the flow: robust standard deviation over root mean square
    why: str  # the reason for no answer, beginning with a verb; empty for an answer

    def on(self, area: float) -> VolumeLeak:
        """The leak on a rig whose piston has this area in chamber a, m²: no answer if the fitted one is another."""
        if self.why or abs(self.area / area - 1.0) <= SAME_AREA:
            return self
        what = f"fits a piston of {1e4 * self.area:.3g} cm² in chamber a, but the rig has {1e4 * area:.3g} cm²: "
        return _none(self.moves, what + "its unit or sign, the unit of the position, or the bore of the rig is wrong")


class Blocks(NamedTuple):
    """Means over blocks of a recording, (N,) each; NaN: a reading is missing."""

    speed: Floats  # m/s
    flow: Floats  # m³/s, into chamber a
    difference: Floats  # Pa, of the pressures
    rise: Floats  # Pa/s, of the pressure in chamber a
    range_of_speed: Floats  # m/s, within the block


def leak_of_blocks(parts: Iterable[Blocks]) -> VolumeLeak | None:
    """The leak past the piston from the blocks of the parts of a recording; ``None`` if there are none."""
    parts = list(parts)
    if not parts:
        return None
    if sum(len(part.speed) for part in parts) < FEWEST_MOVES:
        return _none(0, "is too short for a balance of volumes")
    between = np.full((len(Blocks._fields), 1), np.nan)  # a part ends a move
    joined = np.concatenate([np.concatenate([np.array(part), between], axis=1) for part in parts], axis=1)
    speed, volume, difference, rise, range_of_speed = joined
    known = np.isfinite(speed + volume + difference + rise)
    usual = float(np.quantile(np.abs(speed[known]), 0.95)) if known.any() else 0.0
    steady = known & (np.abs(speed) > LEAST_SPEED * usual) & (range_of_speed < STEADY * np.abs(speed))
    chosen = np.flatnonzero(steady)
    ends = (np.diff(chosen) > 1) | (np.diff(np.sign(speed[chosen])) != 0.0)
    move = np.cumsum(np.append(0, ends)) if len(chosen) else np.zeros(0, np.int64)
    moves = len(np.unique(move))
    if moves < FEWEST_MOVES:
        return _none(moves, f"covers {moves} steady moves; a balance of volumes needs {FEWEST_MOVES}")
    causes = np.column_stack([speed, difference, rise])[chosen]
    scale = np.sqrt((causes**2).mean(axis=0)) + 1e-300
    found, deviation, rest, left = _robust(causes / scale, volume[chosen], move)
    size = LEAKAGE_TEST_PRESSURE / LITRE_PER_MINUTE / scale[1]
    reach = float(student.ppf(0.5 + 0.5 * COVERAGE, max(left - causes.shape[1], 1))) * deviation[1] * size
    leak, area = found[1] * size, float(found[0] / scale[0])
    if leak + reach < 0.0:
        what = "gives a negative leak in the balance of volumes: it depends on more than speed and pressures"
        return _none(moves, what)
    return VolumeLeak(float(leak), float(leak - reach), float(leak + reach), area, moves, rest, "")


def _none(moves: int, why: str) -> VolumeLeak:
    unknown = float("nan")
    return VolumeLeak(unknown, unknown, unknown, unknown, moves, unknown, why)


def blocks_of(position: Floats, pressure_a: Floats, pressure_b: Floats, flow: Floats, period: float) -> Blocks:
    """Means over blocks.

    Args:
        position: (T,), m.
        pressure_a: (T,), Pa.
        pressure_b: (T,), Pa.
        flow: into chamber a, (T,), m³/s.
        period: of the samples, s. NaN in a signal leaves out the block.
    """
    samples = max(round(BLOCK / period / QUARTERS), 1) * QUARTERS
    count = (len(position) - 1) // samples
    ends = np.arange(count + 1) * samples
    duration = samples * period

    def mean(values: Floats) -> Floats:
        between = 0.5 * (values[1 : ends[-1] + 1] + values[: ends[-1]])
        means: Floats = between.reshape(count, samples).mean(axis=1)
        return means

    quarter = position[: ends[-1] + 1 : samples // QUARTERS]
    speeds: Floats = (np.diff(quarter) / (duration / QUARTERS)).reshape(count, QUARTERS)
    rise = np.diff(pressure_a[ends]) / duration
    difference = mean(pressure_a - pressure_b)
    return Blocks(speeds.mean(axis=1), mean(flow), difference, rise, np.ptp(speeds, axis=1))


def _robust(causes: Floats, wanted: Floats, cluster: Indices) -> tuple[Floats, Floats, float, int]:
    """Coefficients and deviations (P,), unexplained share of ``wanted``, and number of clusters with weight."""
    weight: NDArray[Any] = np.ones(len(wanted))
    left: NDArray[Any] = wanted
    found, deviation = np.zeros(causes.shape[1]), 0.0
    for turn in range(ROUNDS):
        normal = (causes * weight[:, None]).T @ causes
        found = np.linalg.lstsq(normal, (causes * weight[:, None]).T @ wanted, rcond=None)[0]
        left = wanted - causes @ found
        deviation = 1.483 * float(np.median(np.abs(left))) + 1e-300
        off = left / (OUTLIER * deviation)
        # The first rounds keep a part of the weight of outliers, so that they cannot lead to another minimum.
        weight = np.where(np.abs(off) < 1.0, (1.0 - off**2) ** 2, 0.0) if turn > 5 else 1.0 / (1.0 + off**2)
    inverse = np.linalg.pinv((causes * weight[:, None]).T @ causes)
    scores = np.zeros((int(cluster.max()) + 1, causes.shape[1]))
    np.add.at(scores, cluster, (weight * left)[:, None] * causes)
    used = len(np.unique(cluster[weight > 0.5]))
    factor = used / max(used - causes.shape[1], 1)
    covariance = factor * inverse @ (scores.T @ scores) @ inverse
    return found, np.sqrt(np.diag(covariance)), deviation / float(np.sqrt((wanted**2).mean())), used
