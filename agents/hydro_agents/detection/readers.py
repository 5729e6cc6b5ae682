"""The detectors of this project for the protocol: the leakage head, and the estimator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import ObservationLayout
from hydro_agents.controllers.registry import imported
from hydro_agents.detection.detectors import (
    EXTERNAL,
    NONE,
    RETURN,
    SENSOR,
    VALVE,
    Detector,
    DetectorChoice,
    Floats,
    Reading,
    logit,
)
from hydro_agents.detection.features import LABELS
from hydro_agents.detection.head import LeakageEstimate, LeakageHead
from hydro_agents.estimation.estimate import Estimate, estimate
from hydro_agents.estimation.unknowns import EXTERNAL_LEAKAGE, EXTERNAL_RESISTANCE, LEAKAGE, default_unknowns, priors_of
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.randomisation import own_value
from hydro_env.units import flow_from_resistance

HEAD_FILE = "leakage_head"

LEAST_DEVIATION = 0.1
"""Smallest credible standard deviation of the leak, as a fraction of the healthy bound: the model is not exact."""

CLEAR = 3.0
"""Distance of an unknown from its normal range at which the estimator names it as a fault, in standard deviations."""


OTHER_LABELS = {"external_leak": EXTERNAL, "valve_fault": VALVE, "sensor_fault": SENSOR, "return_line": RETURN}
"""Verdict of each fault other than a leak, for the probabilities of the head."""


class HeadReader:
    """The leakage head: its score is the logit of the probability of a leak."""

    def __init__(self, head: LeakageHead) -> None:
        self.head = head
        self.threshold: float | None = float(logit(np.array([head.settings.threshold]))[0])

    def refuses(self, config: TaskConfig, samples: int) -> str:
        """The reason if the observations differ, or the head cannot read the length of the window."""
        settings = self.head.settings
        if settings.layout != ObservationLayout.of(config) or settings.task.plant != config.plant:
            return "the head was trained on another rig or on other observations"
        if not settings.window <= samples <= settings.longest:
            return f"the head reads windows of {settings.window} to {settings.longest} samples, these have {samples}"
        return ""

    def read(self, signals: NDArray[Any], config: TaskConfig) -> Reading:
        """Evaluate windows; see :class:`~hydro_agents.detection.detectors.Detector`."""
        del config
        found = self.head.estimate_windows(signals)
        inside = found.outside == 0.0
        probability, flow, low, high = (
            np.where(inside, values, np.nan)
            for values in (found.probability, found.flow_lpm, found.low_lpm, found.high_lpm)
        )
        score = np.where(inside, logit(found.probability), np.nan)
        return Reading(score, probability, flow, low, high, self._otherwise(found))

    def _otherwise(self, found: LeakageEstimate) -> Floats:
        """The fault with the largest excess over its threshold, as the number of its verdict; else none."""
        verdict = np.full(len(found.probability), float(NONE))
        highest = np.zeros(len(verdict))
        thresholds = logit(self.head.tensors["thresholds"])
        for name, kind in OTHER_LABELS.items():
            above = logit(getattr(found, name)) - thresholds[LABELS.index(name)]
            verdict = np.where(above > highest, float(kind), verdict)
            highest = np.maximum(highest, above)
        return verdict


class EstimatorReader:
    """The estimator with the simulator as model: its score is the leak above the healthy bound, in standard deviations.

    Args:
        changes: of the task that gives unknowns and priors.
        unknowns: additional names (:mod:`hydro_agents.estimation.unknowns`).
    """

    threshold: float | None = None

    def __init__(self, changes: Mapping[str, Any] | None = None, unknowns: tuple[str, ...] = ()) -> None:
        self.changes, self.unknowns = dict(changes or {}), unknowns

    def refuses(self, config: TaskConfig, samples: int) -> str:
        """An empty text: the estimator reads every rig and every length."""
        del config, samples
        return ""

    def read(self, signals: NDArray[Any], config: TaskConfig) -> Reading:
        """Evaluate windows; see :class:`~hydro_agents.detection.detectors.Detector`."""
        expected = task_config(config, **self.changes)
        own = default_unknowns(expected)
        names = (*own, *(name for name in self.unknowns if name not in own))
        found = estimate(signals, expected, names, threads=1)
        bound = config.leakage.class_bounds[0]
        flow, deviation = found.value(LEAKAGE), found.deviation(LEAKAGE)
        score = (flow - bound) / np.hypot(deviation, LEAST_DEVIATION * bound)
        low, high = found.interval(LEAKAGE)
        known = found.holds

        def said(values: Floats) -> Floats:
            return np.where(known, values, np.nan)

        probability = found.probability_above(LEAKAGE, bound)
        return Reading(said(score), said(probability), said(flow), said(low), said(high), named_fault(found, config))


def named_fault(found: Estimate, config: TaskConfig) -> Floats:
    """Number of the verdict, (N,), from the unknowns other than the leak past the piston.

    An unknown names a fault if it lies clearly outside its normal range: by 3 of its own standard deviations beyond 2
    standard deviations of the healthy task's prior. An unknown that a healthy task does not draw has a wide prior; half
    a standard deviation of it counts as normal.

    Args:
        found: the estimate.
        config: the task without faults.
    """
    verdict = np.full(len(found), float(NONE))
    priors = priors_of(config, found.names)
    own = default_unknowns(config)
    clearest = np.full(len(found), CLEAR)
    for name in found.names:
        kind = _kind_of(name)
        if kind is None or name == LEAKAGE:
            continue
        value, deviation = found.value(name), found.deviation(name)
        if name == EXTERNAL_LEAKAGE:
            beyond = (value - _largest_rod_leak(config)) / deviation
        else:
            prior = priors[name]
            distance = np.log(value / prior.mean) if prior.logarithmic else value - prior.mean
            spread = deviation / value if prior.logarithmic else deviation
            normal = (2.0 if name in own else 0.5) * prior.deviation
            beyond = (np.abs(distance) - normal) / spread
        beyond = np.nan_to_num(beyond, nan=-np.inf)
        verdict = np.where(beyond > clearest, float(kind), verdict)
        clearest = np.maximum(clearest, beyond)
    return verdict


def _largest_rod_leak(config: TaskConfig) -> float:
    """The largest external leak of a healthy axis, l/min at 100 bar."""
    own = own_value(config.plant, EXTERNAL_RESISTANCE)
    drawn = config.randomisation.get(EXTERNAL_RESISTANCE)
    return flow_from_resistance(drawn.bounds(own)[0] if drawn is not None else own)


def _kind_of(name: str) -> int | None:
    if name == EXTERNAL_LEAKAGE:
        return EXTERNAL
    if name == "supply.tank_pressure":
        return RETURN
    if name.startswith("valve."):
        return VALVE
    return SENSOR if name.endswith(("_bias", "_gain")) else None


def make_detector(choice: DetectorChoice, head: LeakageHead | None = None) -> Detector:
    """The detector of a choice.

    Args:
        choice: kind and settings.
        head: replaces the head of the choice.

    Raises:
        ConfigurationError: its weights cannot be read, or the object that it names is no detector.
    """
    if ":" in choice.kind:
        named = imported(choice.kind)
        own: Detector = named() if isinstance(named, type) else named
        missing = [part for part in ("threshold", "refuses", "read") if not hasattr(own, part)]
        if missing:
            raise ConfigurationError(f"'{choice.kind}': is no leak detector, it has no {', '.join(missing)}")
        return own
    if choice.kind == "estimator":
        return EstimatorReader(choice.task, choice.unknowns)
    return HeadReader(head or LeakageHead.load(choice.weights or pretrained_folder() / HEAD_FILE))
