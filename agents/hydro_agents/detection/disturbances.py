"""Disturbances that the flow balance takes for constant: of the supply, the return line and the pressure transducers.

The leakage head learns from them to mark such a window as "outside" (outlier exposure: Hendrycks, Mazeika & Dietterich
2019, *Deep Anomaly Detection with Outlier Exposure*).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import SIGNALS, cut
from hydro_agents.running.cases import TrueStateController
from hydro_env.axes import Axes
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.states import State
from hydro_env.types import Array, Floats, Indices, Mask, Singles

Span = tuple[float, float]

SUPPLY, TANK, PRESSURE_A, PRESSURE_B = range(4)
"""Rows of a course: factor on the supply pressure less 1, and additions to the tank pressure and to both readings."""

NOTICEABLE = np.array([0.01, 0.5e5, 1e5, 1e5])  # range of each row from which a window counts as disturbed; Pa

DRIFTS = (PRESSURE_A, PRESSURE_B)  # rows to add to the readings of :data:`PRESSURES`
PRESSURES = [SIGNALS.index("pressure_a"), SIGNALS.index("pressure_b")]
_RELIEF, _TANK = (Coefficients._fields.index(name) for name in ("relief_pressure", "tank_pressure"))
_SUPPLY = State._fields.index("supply_pressure")


class DisturbanceKind(NamedTuple):
    """A kind of disturbance: its shape over time, with a size and a time that are log-uniform."""

    row: int
    shape: Callable[[Floats, float, float], Floats]  # from time (T,), s; start, s; time of the kind, s
    size: Span
    time: Span  # s: period, duration, or time constant
    signs: tuple[float, ...] = (1.0,)  # of the size


def swing(time: Floats, start: float, period: float) -> Floats:
    """A sine; ``start`` is its phase."""
    return np.sin(2.0 * np.pi * (time - start) / period)


def ramp(time: Floats, start: float, duration: float) -> Floats:
    """0, then a linear rise to 1 within ``duration``."""
    return np.clip((time - start) / duration, 0.0, 1.0)


def step(time: Floats, start: float, constant: float) -> Floats:
    """0, then an exponential approach to 1."""
    return np.where(time < start, 0.0, 1.0 - np.exp(-np.maximum(time - start, 0.0) / constant))


BOTH = (-1.0, 1.0)
DISTURBANCES = {
    "supply swings": DisturbanceKind(SUPPLY, swing, (0.007, 0.1), (0.3, 8.0)),
    "supply sags": DisturbanceKind(SUPPLY, ramp, (0.03, 0.3), (1.0, 8.0), (-1.0,)),
    "supply steps": DisturbanceKind(SUPPLY, step, (0.02, 0.2), (0.01, 0.3), BOTH),
    "pump ripple": DisturbanceKind(SUPPLY, swing, (0.007, 0.05), (0.004, 0.1)),
    "tank swings": DisturbanceKind(TANK, swing, (0.4e5, 2e5), (0.3, 8.0)),
    "pressure a drifts": DisturbanceKind(PRESSURE_A, ramp, (1.5e5, 10e5), (1.0, 8.0), BOTH),
    "pressure b drifts": DisturbanceKind(PRESSURE_B, ramp, (1.5e5, 10e5), (1.0, 8.0), BOTH),
}
"""Kinds of disturbance by name."""


class Disturbances(NamedTuple):
    """One disturbance of each of N axes over T control periods."""

    course: Floats  # (N, 4, T)
    direct: Mask  # (N,), the pressure at the valve follows at once; else the setting of the relief valve

    def felt(self, axes: Indices, begins: Array, samples: int) -> Floats:
        """Ranges of the courses in one window of each of some axes, over :data:`NOTICEABLE`, the largest; (axes,)."""
        return (np.ptp(cut(self.course[axes], begins, samples), axis=2) / NOTICEABLE).max(axis=1)


def drawn(generator: np.random.Generator, kinds: NDArray[np.str_], steps: int, period: float) -> Disturbances:
    """Disturbances of axes, one kind each; ``steps`` control periods of ``period`` s."""
    time = period * np.arange(steps, dtype=float)
    course = np.zeros((len(kinds), len(NOTICEABLE), steps))
    for axis, name in enumerate(kinds):
        kind = DISTURBANCES[name]
        size = np.exp(generator.uniform(*np.log(kind.size))) * generator.choice(kind.signs)
        start = generator.uniform(-0.5, 0.9) * time[-1]
        course[axis, kind.row] = size * kind.shape(time, start, np.exp(generator.uniform(*np.log(kind.time))))
    ripple = kinds == "pump ripple"  # an accumulator on the way to the valve would damp it
    return Disturbances(course, ripple | (generator.random(len(kinds)) < 0.5))


class Disturbed:
    """A controller, on axes whose supply and return line move."""

    def __init__(self, controller: Controller, disturbances: Disturbances) -> None:
        self.controller, self.disturbances = controller, disturbances

    def begin(self, axes: Axes) -> None:
        """Note the undisturbed pressures of the axes whose episodes begin."""
        self._axes, self._step = axes, 0
        self._relief, self._tank = axes.coefficient[:, [_RELIEF, _TANK]].T.copy()
        self._supply = axes.state[:, _SUPPLY].copy()
        if isinstance(self.controller, TrueStateController):
            self.controller.begin(axes)

    def predict(self, observation: Any, *memory: Any, **named: Any) -> tuple[Singles, Any]:
        """Commands of the controller; the pressures of this control period are set before it."""
        course, direct = self.disturbances.course[:, :, self._step], self.disturbances.direct
        supply = 1.0 + course[:, SUPPLY]
        self._axes.coefficient[:, _RELIEF] = self._relief * supply
        self._axes.coefficient[:, _TANK] = self._tank + course[:, TANK]
        self._axes.state[direct, _SUPPLY] = (self._supply * supply)[direct]
        self._step += 1
        return self.controller.predict(observation, *memory, **named)
