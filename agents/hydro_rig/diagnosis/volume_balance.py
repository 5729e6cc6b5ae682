"""The leak past the piston from a measured flow: a balance of volumes over steady moves, which needs no valve.

In steady motion the oil that flows into chamber a moves the piston and passes the gap:

    Q = A v + V/β dp_a/dt + G (p_a − p_b)

Area, stiffness and leak are fitted to means over short blocks by robust regression (bisquare: Beaton and Tukey
1974, *Technometrics* 16), which leaves out blocks where a relief valve opens. Blocks of one move share their errors:
the covariance is that of clusters (Liang and Zeger 1986, *Biometrika* 73).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hydro_env.task.sensors import POSITION, PRESSURE_A, PRESSURE_B
from hydro_env.types import Floats, Indices
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE
from hydro_rig.recordings.recording import Recording

SAME_AREA = 0.1
"""Largest difference of the fitted piston area from that of the rig. Flow meters and displacements of pumps are right
within a few per cent; neighbouring bores of ISO 3320 differ by more than 40 % in area, units by 20 % and more."""

LONGEST_STEP = 3.0  # of the usual distance of rows: a longer one ends a part of a recording, as one beyond BLOCK
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


def volume_leak(recording: Recording) -> VolumeLeak | None:
    """The leak past the piston; ``None`` without a flow, the position or one of the pressures."""
    blocks = _blocks_of(recording)
    if blocks is None:
        return None
    speed, volume, difference, rise, range_of_speed = blocks
    known = np.isfinite(speed + volume + difference + rise)
    if len(known) < FEWEST_MOVES:
        return _none(0, "is too short for a balance of volumes")
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


def _blocks_of(recording: Recording) -> Floats | None:
    """Means over blocks, (5, N): speed, flow, difference of the pressures, rise of that in chamber a, range of speed.

    NaN: a reading is missing, or a part of the recording ends.
    """
    steps = np.diff(recording.time)
    step = float(np.median(steps)) if len(steps) else 0.0
    motion = recording.signals[[POSITION, PRESSURE_A, PRESSURE_B]]
    signals = np.vstack([motion, recording.auxiliary.get("flow", np.full_like(recording.time, np.nan))])
    if not np.isfinite(signals).any(axis=1).all() or step <= 0.0:
        return None
    samples = max(round(BLOCK / step / QUARTERS), 1) * QUARTERS
    duration = samples * step
    blocks = []
    ends = np.flatnonzero((steps < 0.0) | (steps > max(BLOCK, LONGEST_STEP * step))) + 1
    for part in np.split(np.arange(len(recording.time)), ends):
        stamps = recording.time[part]
        time = np.arange(stamps[0], stamps[-1], step)
        count = (len(time) - 1) // samples
        if count < 1:
            continue
        # A missing reading stays NaN.
        position, pressure_a, pressure_b, flow = (
            np.interp(time, stamps, values[part])[: count * samples + 1] for values in signals
        )
        speeds = np.diff(position[:: samples // QUARTERS]).reshape(count, QUARTERS) / (duration / QUARTERS)
        means = [_means(values, count) for values in (flow, pressure_a - pressure_b)]
        rise = np.diff(pressure_a[::samples]) / duration
        blocks += [np.stack([speeds.mean(axis=1), *means, rise, np.ptp(speeds, axis=1)]), np.full((5, 1), np.nan)]
    return np.concatenate(blocks, axis=1) if blocks else np.empty((5, 0))


def _means(values: Floats, count: int) -> Floats:
    """Means over ``count`` blocks by the trapezoidal rule."""
    means: Floats = (0.5 * (values[1:] + values[:-1])).reshape(count, -1).mean(axis=1)
    return means


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
