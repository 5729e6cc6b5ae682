"""The leak past the piston from a measured flow: a balance of volumes over steady moves, which needs no valve.

In steady motion the oil that flows into chamber a moves the piston and passes the gap:

    Q = A v + V/β dp_a/dt + G (p_a − p_b)

Area, stiffness and leak are fitted to means over short blocks by robust regression (bisquare: Beaton and Tukey
1974, *Technometrics* 16), which leaves out blocks where a relief valve opens. Blocks of one move share their errors:
the covariance is that of clusters (Liang and Zeger 1986, *Biometrika* 73).
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t as student

from hydro_env import TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.sensors import POSITION, PRESSURE_A, PRESSURE_B
from hydro_env.types import Floats, Indices
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE
from hydro_rig.diagnosis.verdict import NO_LEAK, Kind, Leak, Limits, Verdict
from hydro_rig.recordings.recording import Recording
from hydro_rig.recordings.sampling import cut, sampled

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


class Balance(NamedTuple):
    """What a balance says."""

    leak: Leak  # NaN without an answer
    moves: int  # steady ones
    rest: float  # unexplained share of the flow: robust standard deviation over root mean square
    why: str  # the reason for no answer, beginning with a verb; empty for an answer


def volume_leak(recording: Recording, config: TaskConfig) -> Balance | None:
    """The leak past the piston of the task's rig; ``None`` without flow, position or one of the pressures.

    No answer if the balance fits another piston.
    """
    samples, area = sampled(recording, config, own_grid=True), plant_coefficients(config.plant).area_a
    blocks = cut(samples, max(round(BLOCK / samples.period / QUARTERS), 1) * QUARTERS)
    position, pressure_a, pressure_b = blocks.signals[:, [POSITION, PRESSURE_A, PRESSURE_B]].swapaxes(0, 1)
    flow = blocks.auxiliary_signal("flow")
    if not all(np.isfinite(values).any() for values in (position, pressure_a, pressure_b, flow)):
        return None
    moving, rising = (np.gradient(values, samples.period, axis=1) for values in (position, pressure_a))
    causes = np.stack([moving, pressure_a - pressure_b, rising]).mean(axis=2).T
    speed, volume = causes[:, 0], flow.mean(axis=1)
    speeds = moving.reshape(len(blocks), QUARTERS, -1).mean(axis=2)
    size, known = np.abs(speed), np.isfinite(causes.sum(axis=1) + volume)
    usual = np.quantile(size[known], 0.95) if known.any() else 0.0
    steady = known & (size > LEAST_SPEED * usual) & (np.ptp(speeds, axis=1) < STEADY * size)
    apart = np.diff(blocks.begin[steady]) > 1.5 * blocks.samples * samples.period
    move = np.cumsum(np.append(1, apart | (np.diff(np.sign(speed[steady])) != 0.0)))
    moves = move[-1] if steady.any() else 0
    if moves < FEWEST_MOVES:
        return _none(moves, f"covers {moves} steady moves; a balance of volumes needs {FEWEST_MOVES}")
    scale = np.sqrt((causes[steady] ** 2).mean(axis=0)) + 1e-300
    found, deviation, rest, left = _robust(causes[steady] / scale, volume[steady], move)
    own, unit = found[0] / scale[0], LEAKAGE_TEST_PRESSURE / LITRE_PER_MINUTE / scale[1]
    if abs(own / area - 1.0) > SAME_AREA:
        what = f"fits a piston of {1e4 * own:.3g} cm² in chamber a, but the rig has {1e4 * area:.3g} cm²: its unit or "
        return _none(moves, what + "sign, the unit of the position, or the bore of the rig is wrong")
    reach = student.ppf(0.5 + 0.5 * COVERAGE, max(left - len(found), 1)) * deviation[1]
    leak = Leak(*(unit * (found[1] + reach * np.array([0.0, -1.0, 1.0]))).tolist())
    if leak.high < 0.0:
        what = "gives a negative leak in the balance of volumes: it depends on more than speed and pressures"
        return _none(moves, what)
    return Balance(leak, moves, rest, "")


def _none(moves: int, why: str) -> Balance:
    return Balance(NO_LEAK, moves, np.nan, why)


def _robust(causes: Floats, wanted: Floats, cluster: Indices) -> tuple[Floats, Floats, float, int]:
    """Coefficients and deviations (P,), unexplained share of ``wanted``, and number of clusters with weight."""
    weight: Any = np.ones(len(wanted))
    for turn in range(ROUNDS):
        weighted = causes * weight[:, None]
        found = np.linalg.lstsq(weighted.T @ causes, weighted.T @ wanted, rcond=None)[0]
        left = wanted - causes @ found
        deviation = 1.483 * np.median(np.abs(left)) + 1e-300
        off = left / (OUTLIER * deviation)
        # The first rounds keep a part of the weight of outliers, so that they cannot lead to another minimum.
        weight = np.where(np.abs(off) < 1.0, (1.0 - off**2) ** 2, 0.0) if turn > 5 else 1.0 / (1.0 + off**2)
    inverse = np.linalg.pinv((causes * weight[:, None]).T @ causes)
    scores = np.zeros((cluster[-1] + 1, causes.shape[1]))
    np.add.at(scores, cluster, (weight * left)[:, None] * causes)
    used = len(np.unique(cluster[weight > 0.5]))
    factor = used / max(used - causes.shape[1], 1)
    covariance = factor * inverse @ (scores.T @ scores) @ inverse
    return found, np.sqrt(np.diag(covariance)), deviation / np.sqrt((wanted**2).mean()), used


def by_volume(verdict: Verdict, balance: Balance, limits: Limits) -> Verdict:
    """The verdict with a measured flow: where the estimator cannot tell, the balance of volumes decides alone."""
    if verdict.kind is not Kind.UNKNOWN:
        return verdict
    if balance.why:
        return verdict._replace(why=f"{verdict.why}; flow {balance.why}")
    leak, why = balance.leak, f"by a balance of volumes over {balance.moves} steady moves, which needs no valve"
    if leak.low > limits.healthy:
        return Verdict(Kind.LEAK, why, leak)
    if leak.high < limits.fault:
        return Verdict(Kind.HEALTHY, why, leak)
    return Verdict(Kind.UNKNOWN, f"the leak past the piston is {leak.text()} {why}; it may be healthy or faulty", leak)
