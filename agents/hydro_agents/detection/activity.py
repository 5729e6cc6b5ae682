"""The activity of an axis during a window: it stands, moves slowly, or moves; a leak shows differently in each."""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.detector import SIGNALS
from hydro_env.types import Array

STANDING_BELOW, MOVING_FROM = 1e-4, 5e-3  # m/s; below the first the axis stands, from the second on it moves
SPAN = 0.1  # averaging time in s of the position before its travel is computed, which removes the noise


class Activity(IntEnum):
    """Activity of an axis during a window."""

    STANDING = 0
    SLOW = 1
    MOVING = 2


def activity_of(signals: Array, control_period: float) -> NDArray[np.int8]:
    """:class:`Activity` (N,) during windows of signals (N, 5, T) in SI units; lost samples are left out."""
    position = np.asarray(signals[:, SIGNALS.index("position")], float)
    count = max(round(SPAN / control_period), 1)
    blocks = position[:, : position.shape[1] // count * count].reshape(len(position), -1, count)
    present = np.isfinite(blocks)
    means = np.where(present, blocks, 0.0).sum(axis=2) / np.maximum(present.sum(axis=2), 1)
    known = present.any(axis=2)
    travel = np.where(known, means, -np.inf).max(axis=1) - np.where(known, means, np.inf).min(axis=1)
    speed = np.where(known.any(axis=1), travel, 0.0) / (position.shape[1] * control_period)
    return (speed >= STANDING_BELOW).astype(np.int8) + (speed >= MOVING_FROM)
