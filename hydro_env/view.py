"""The numbers that the drawing of an axis shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class View:
    """One picture as numbers; SI units."""

    time: float
    position: float
    velocity: float
    reference: float
    reference_preview: NDArray[np.floating]  # (n,) coming samples in m, spaced as the history is; may be empty
    pressure_a: float  # Pa gauge, as the other pressures
    pressure_b: float
    supply_pressure: float
    spool_position: float  # -1 to 1
    command: float  # -1 to 1
    leakage_flow_lpm: float  # l/min at 100 bar
    external_force: float  # N; positive pushes against extension
    stroke: float
    bore_diameter: float
    rod_diameter: float
    has_spring: bool
    history_time: NDArray[np.floating]  # (m,) past samples of the episode, as the two below
    history_position: NDArray[np.floating]
    history_reference: NDArray[np.floating]
    sample_interval: float = 0.0  # s; 0: that of the history
