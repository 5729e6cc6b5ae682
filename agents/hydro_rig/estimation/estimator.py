"""The estimator with the simulator as model, as a detector.

Its unknowns are the parameters that the task draws and those that change by wear, without which a worn valve would look
like a leak. Windows without signs of wear are fitted again without it, but with the lap of the edges, which no
nameplate tells: the simpler model gives the leak more precisely. A window at rest shows no signs of wear, whatever the
valve is like, and its leak keeps the uncertainty of the wear.

Where the residuals are not mere noise, the parts are tried that the file of a rig does not tell
(:mod:`hydro_rig.estimation.structure`). What none of them explains widens the interval.
"""

import math
from collections.abc import Mapping
from functools import partial
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from hydro_agents.detection.detector import HALF_WIDTH, Cause, Reading, Why, Windows
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.running.text import number
from hydro_env import TaskConfig, task_config
from hydro_env.task.randomisation import own_value
from hydro_env.types import ByName, Floats, Indices, Mask
from hydro_env.units import LITRE_PER_MINUTE, flow_from_resistance
from hydro_rig.estimation.estimate import SURE, EstimationSettings, estimate
from hydro_rig.estimation.result import Estimate
from hydro_rig.estimation.structure import LAP, USUAL_LAP, Lacking, Part, lacking, unexplained, with_parts
from hydro_rig.estimation.unknowns import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    LEAKAGE,
    Prior,
    Priors,
    default_unknowns,
)

WIDE_BIAS = 3.0  # standard deviation of a sensor's offset, relative to the largest offset of the data sheet
WIDEST_READING = 0.05
"""Largest standard deviation of a valid reading, as a share of the leak, or in l/min at 100 bar on the default rig; on
other rigs it grows with their flow (:func:`~hydro_agents.detection.sheet.leak_scale`)."""

STEPS_WITH_PART = 25  # largest number of iterations of each fit with a part that an axis may have
LEAST_TRAVEL = 20.0  # smallest travel of an axis in motion, in standard deviations of the position's noise
LEAST_DEVIATION = 0.1  # credible standard deviation of the leak, of the healthy bound: the model is not exact

LARGEST_NULL_SHIFT, LARGEST_BACK_PRESSURE, LARGEST_BIAS = 0.004, 1.5e5, 2.0
"""Limits of a healthy axis: null shift as a fraction of full stroke, return pressure above the data sheet's in Pa, and
offset of a sensor relative to its data sheet."""


class Wear(NamedTuple):
    """A fault that an unknown names, and its words."""

    cause: Cause
    what: str
    factor: float  # displayed units per unit of the unknown
    unit: str

    def sized(self, value: float) -> str:
        """Its words with its size."""
        return f"{self.what} ({number(self.factor * value)} {self.unit})"


WEAR = {
    "valve.null_shift": Wear(Cause.VALVE, "null shift of the valve", 100.0, "% of full stroke"),
    "valve.underlap": Wear(Cause.VALVE, "worn edges of the valve, underlap", 100.0, "%"),
    LAP: Wear(Cause.VALVE, "worn edges of the valve, overlap", 100.0, "%"),
    "valve.rated_flow": Wear(Cause.VALVE, "rated flow of the valve", 1.0 / LITRE_PER_MINUTE, "l/min"),
    "supply.tank_pressure": Wear(Cause.RETURN_LINE, "pressure in the return line", 1e-5, "bar"),
    EXTERNAL_LEAKAGE: Wear(Cause.EXTERNAL_LEAK, Cause.EXTERNAL_LEAK.in_full, 1.0, "l/min at 100 bar"),
    "pressure_a_bias": Wear(Cause.SENSOR, "offset of the pressure sensor of chamber a", 1e-5, "bar"),
    "pressure_b_bias": Wear(Cause.SENSOR, "offset of the pressure sensor of chamber b", 1e-5, "bar"),
    "spool_position_bias": Wear(Cause.SENSOR, "offset of the spool sensor", 100.0, "% of full stroke"),
}
"""By unknown. An offset of the position is no fault: its zero is arbitrary."""


class EstimatorDetector:
    """The estimator: its score is the leak above the healthy bound, in standard deviations.

    It reads windows with all commands; any sensor may be absent. A window that the model does not explain, or with a
    negative leak, has the cause ``UNKNOWN``; one with too little motion, ``UNDETERMINED``. Arguments as of
    :class:`~hydro_rig.estimation.estimate.EstimationSettings`.
    """

    threshold: float | None = None

    def __init__(self, threads: int | None = 1, restarts: int = EstimationSettings().restarts) -> None:
        self.settings = EstimationSettings(restarts=restarts, threads=threads)

    def refuses(self, task: TaskConfig, samples: int) -> str:
        """An empty text: the estimator reads every rig and every length."""
        return ""

    def read(self, windows: Windows, task: TaskConfig) -> Reading:
        """Read N windows of a task: rig, ranges and sensors."""
        return self.read_and_fit(windows, task)[0]

    def read_and_fit(
        self, windows: Windows, task: TaskConfig, usual: tuple[Part, ...] = ()
    ) -> tuple[Reading, Estimate | None]:
        """Read windows, and return the estimates with wear as well, one for each window with commands; ``None``: none.

        ``usual``: parts that this axis had in other windows.
        """
        unread = Reading.of(np.full(len(windows), np.nan), why=Why.NO_COMMANDS)
        chosen = np.flatnonzero(windows.commanded)
        if not len(chosen):
            return unread, None
        used, names, wear = windows.part(chosen), default_unknowns(task), wear_priors(task)
        worn = self._estimate(used, task, (*names, *wear), wear)
        self._with_parts(used, task, worn, usual)
        excess = _excess(worn, task)
        value, deviation = worn.value(LEAKAGE).copy(), worn.deviation(LEAKAGE).copy()
        position = used.signal("position")
        travel = np.fmax.reduce(position, axis=1) - np.fmin.reduce(position, axis=1)
        still = travel < LEAST_TRAVEL * task.sensors.position.noise  # it cannot show whether the valve is worn
        simple = np.flatnonzero(worn.holds & ~(excess > 0.0).any(axis=1) & ~still & ~worn.parts.astype(bool))
        if len(simple):
            lap = {name: prior for name, prior in wear.items() if name == LAP}
            plain = self._estimate(used.part(simple), task, (*names, LAP), lap, (worn, simple), horizons=())
            better = np.flatnonzero(plain.holds)
            value[simple[better]] = plain.value(LEAKAGE)[better]
            deviation[simple[better]] = plain.deviation(LEAKAGE)[better]
        return unread.replaced(chosen, _reading(worn, excess, value, deviation, still, task)), worn

    def _estimate(
        self,
        windows: Windows,
        task: TaskConfig,
        names: tuple[str, ...],
        priors: Priors,
        begin: tuple[Estimate, Indices] | None = None,
        **changes: Any,
    ) -> Estimate:
        """Estimate unknowns of windows, from rows of another estimate on; ``changes`` are those of the settings."""
        names = windows.unrecorded(tuple(dict.fromkeys(names)))
        first = {}
        if begin:
            found, rows = begin
            values = {name: found.value(name)[rows] for name in found.names if name in names}
            first = {name: value for name, value in values.items() if np.isfinite(value).all()}
        return estimate(
            windows.signals,
            task,
            names,
            priors={name: prior for name, prior in priors.items() if name in names},
            first=first,
            settings=self.settings._replace(**changes),
            boundary=windows.boundary,
        )

    def _with_parts(self, windows: Windows, task: TaskConfig, worn: Estimate, usual: tuple[Part, ...]) -> None:
        """Fit windows whose readings the model does not explain with parts that it lacks.

        The better estimates replace those in ``worn``. A recorded supply moves as recorded.
        """
        recorded = bool(np.isfinite(windows.auxiliary_signal("supply_pressure")).any())
        possible = lacking(task, (windows.samples - 1) * task.control_period, recorded)
        for row in np.flatnonzero(unexplained(worn)):
            chosen = np.array([row])
            fit = partial(self._with_given_parts, windows.part(chosen), task, possible)
            found = with_parts(worn.part(chosen), possible, usual, fit)
            worn.take(chosen, found, found.parts.astype(bool))

    def _with_given_parts(
        self,
        window: Windows,
        task: TaskConfig,
        possible: Mapping[Part, Lacking],
        parts: tuple[Part, ...],
        begin: Estimate,
    ) -> Estimate:
        """The estimate of a window with parts, from another estimate on, unless the model did not hold there."""
        priors, names = wear_priors(task), begin.names
        for part in parts:
            priors |= possible[part].priors
            names = (*names, *possible[part].priors)
            task = task_config(task, **possible[part].changes)
        effort: ByName = {"restarts": 0, "effort": self.settings.effort._replace(iterations=STEPS_WITH_PART)}
        if not begin.holds[0]:
            return self._estimate(window, task, names, priors, **effort)
        return self._estimate(window, task, names, priors, (begin, np.array([0])), horizons=(), **effort)


def _reading(
    worn: Estimate, excess: Floats, value: Floats, deviation: Floats, still: Mask, task: TaskConfig
) -> Reading:
    """The reading of leaks with their standard deviations, (N,) each."""
    fits = worn.holds & (value + SURE * deviation >= 0.0)  # a negative leak: the model is wrong
    bound = task.leakage.class_bounds[0]
    known = deviation <= WIDEST_READING * np.maximum(leak_scale(task), value)
    known |= still & (value - SURE * deviation > bound)  # whatever the valve is like, oil passes the piston
    worst = np.array([wear.cause for wear in WEAR.values()])[excess.argmax(axis=1)]
    cause = np.where(excess.max(axis=1) > 0.0, worst, Cause.NONE)
    spread = np.hypot(deviation, LEAST_DEVIATION * bound)
    return Reading.of(
        (value - bound) / spread,
        np.where(~fits, Cause.UNKNOWN, np.where(known, cause, Cause.UNDETERMINED)),
        sigma=deviation / spread,
        probability=ndtr((value - bound) / deviation),
        flow_lpm=value,
        low_lpm=value - HALF_WIDTH * deviation,
        high_lpm=value + HALF_WIDTH * deviation,
        fault=_in_words(worn, excess > 0.0),
        why=np.select(
            [~fits, known, still, worn.of_model], [Why.MISFIT, Why.ANSWERED, Why.AT_REST, Why.DIFFERS], Why.UNDETERMINED
        ),
    )


def wear_priors(task: TaskConfig) -> dict[str, Prior]:
    """Priors of the parameters that wear or drift, wide enough for the faults of :mod:`hydro_env.task.faults`."""
    valve, tank = task.plant.valve, task.plant.supply.tank_pressure
    wide = {
        "valve.null_shift": Prior(valve.null_shift, 0.01),
        "valve.underlap": Prior(max(valve.underlap, 1e-3), 0.6, True),
        "valve.rated_flow": Prior(valve.rated_flow, 0.2, True),
        "supply.tank_pressure": Prior(tank, 3e5),
        EXTERNAL_LEAKAGE: Prior(0.0, 1.0),
    }
    if LAP not in task.randomisation:
        wide[LAP] = Prior(valve.overlap, USUAL_LAP)
    for channel in ("pressure_a", "pressure_b", "spool_position"):
        bias = getattr(task.sensors, channel).bias
        if bias > 0.0:
            wide[f"{channel}_bias"] = Prior(0.0, WIDE_BIAS * bias)
    return wide


def healthy_range(task: TaskConfig, name: str) -> tuple[float, float]:
    """Lowest and highest value of an unknown on an axis without a fault, from the ranges of the task."""
    if name in BIASES:
        reach = LARGEST_BIAS * getattr(task.sensors, name.removesuffix("_bias")).bias
        return -reach, reach
    path = EXTERNAL_RESISTANCE if name == EXTERNAL_LEAKAGE else name
    own = own_value(task.plant, path)
    reach = {"valve.null_shift": LARGEST_NULL_SHIFT, "supply.tank_pressure": LARGEST_BACK_PRESSURE}.get(name, 0.0)
    if reach:
        return own - reach, own + reach
    low, high = task.randomisation[path].bounds(own) if path in task.randomisation else (own, own)
    if name == EXTERNAL_LEAKAGE:
        reach = flow_from_resistance(min(low, high))
        return -reach, reach
    if name == LAP:  # wear only takes lap away; edges as open at the null as the roundest healthy ones are not worn
        return min(low, high) - 0.5 * healthy_range(task, "valve.underlap")[1], math.inf
    return low, high


def _excess(found: Estimate, task: TaskConfig) -> Floats:
    """Distance of each unknown of WEAR beyond its healthy range, (N, unknowns), in standard deviations above SURE."""
    excess = np.full((len(found), len(WEAR)), -np.inf)
    for column, name in enumerate(WEAR):
        if name in found.names:
            value, (low, high) = found.value(name), healthy_range(task, name)
            excess[:, column] = np.maximum(low - value, value - high) / found.deviation(name) - SURE
            if name == "supply.tank_pressure":  # a supply that moves may take its place
                excess[[Part.SUPPLY in parts for parts in found.parts], column] = -np.inf
    return np.where(np.isnan(excess), -np.inf, excess)


def _in_words(found: Estimate, faulty: Mask) -> tuple[str, ...]:
    """The faults of each window as text; the size of a fault is the median over all windows that show it."""
    texts = [
        wear.sized(np.median(found.value(name)[rows])) if rows.any() else ""
        for (name, wear), rows in zip(WEAR.items(), faulty.T, strict=True)
    ]
    return tuple(" and ".join(compress(texts, row)) for row in faulty)
