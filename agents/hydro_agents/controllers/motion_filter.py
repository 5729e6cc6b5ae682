"""A Kalman filter for the unknowns beside the data sheet: flow gain, leak and offset of the speed.

Sources: Ljung & Söderström, *Theory and Practice of Recursive Identification* (1983), chapter 2: parameters that drift,
estimated as states. Gelb, *Applied Optimal Estimation* (1974), section 3.8: the first-order Markov process.
"""

import numpy as np

from hydro_env.types import Floats

POSITION, FLOW_GAIN, LEAK, OFFSET = range(4)
"""Entries of the estimate: position (m), relative deviation of the flow gain from the data sheet, leak conductance
(m³/(s Pa)), offset of the speed (m/s)."""


class MotionFilter:
    """Estimates (N, 4) of N axes and their covariances (N, 4, 4).

    In each period the position changes by its known part, by the flow gain's deviation times the travel of the flow, by
    the leak and by the offset. The measured position has white noise.

    The position is a random walk. The other unknowns drift as well, but return to the data sheet: their spread never
    grows beyond that at the start (first-order Markov processes). An axis at rest hardly shows its flow gain, and
    shows leak and offset only as a sum. Random walks would carry these estimates away during a pause.

    Args:
        noise: standard deviation of the measured position, m.
        spread: standard deviations of the estimate at the start, (4,).
        motion: standard deviation of the motion that nothing explains, m per √s.
        memory: times in which flow gain, leak and offset return to the data sheet, s, (3,).
        period: control period, s.
    """

    def __init__(self, noise: float, spread: Floats, motion: float, memory: Floats, period: float) -> None:
        self._noise = noise**2
        self._spread = np.diag(spread**2)
        self._kept = kept = np.append(1.0, np.exp(-period / memory))
        change = spread**2 * (1.0 - kept**2)
        change[POSITION] = motion**2 * period
        self._drift = np.diag(change)
        self._kept_pairs = kept[:, None] * kept
        self._period = period

    def start(self, position: Floats, speed: Floats, leak: Floats, unexplained: Floats) -> tuple[Floats, Floats]:
        """Estimate and covariance at the start: those of the data sheet, given the speed that it does not explain.

        ``speed`` is that of the valve's flow according to the data sheet, ``leak`` the speed per leak conductance, and
        ``unexplained`` the true speed less ``speed``; each (N,).
        """
        zeros = np.zeros_like(position)
        slope = np.stack([zeros, speed, leak, zeros + 1.0], axis=1)
        row = slope * np.diag(self._spread)
        gain = row / np.einsum("ni,ni->n", row, slope)[:, None]
        estimate = gain * unexplained[:, None]
        estimate[:, POSITION] = position
        return estimate, self._spread - gain[:, :, None] * row[:, None, :]

    def advanced(
        self, estimate: Floats, covariance: Floats, travel: Floats, leak_travel: Floats, other: Floats, measured: Floats
    ) -> tuple[Floats, Floats]:
        """Estimate (N, 4) and covariance (N, 4, 4) one period later.

        ``travel`` is that of the piston by the valve's flow according to the data sheet, m; ``leak_travel`` m per leak
        conductance; ``other`` the other known motion, m; ``measured`` the position now, m; each (N,).
        """
        slope = np.empty_like(estimate)
        slope[:, POSITION], slope[:, FLOW_GAIN] = 1.0, travel
        slope[:, LEAK] = leak_travel
        slope[:, OFFSET] = self._period
        predicted = estimate.copy()
        predicted[:, POSITION] = np.einsum("ni,ni->n", estimate, slope) + travel + other
        # F P Fᵀ + Q: only the row and the column of the position change.
        row = np.einsum("nij,nj->ni", covariance, slope)
        row[:, POSITION] = np.einsum("ni,ni->n", row, slope)
        spread = covariance + self._drift
        spread[:, POSITION, 1:] = spread[:, 1:, POSITION] = row[:, 1:]
        spread[:, POSITION, POSITION] = row[:, POSITION] = row[:, POSITION] + self._drift[POSITION, POSITION]
        gain = row / (row[:, :1] + self._noise)
        predicted += gain * (measured - predicted[:, POSITION])[:, None]
        spread -= gain[:, :, None] * row[:, None, :]
        return predicted * self._kept, spread * self._kept_pairs
