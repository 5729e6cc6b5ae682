"""The detector that reads beside the estimator, and the alarm that watches a recording."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from hydro_agents.controllers.registry import imported
from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.detector import Detector
from hydro_agents.detection.detectors import KINDS, DetectorChoice, make_detector
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.looks import looks_at, window_of
from hydro_agents.detection.monitor import HEAD_FILE, HeadDetector
from hydro_env import ConfigurationError, TaskConfig
from hydro_rig.recordings.quality import Checked

MOST_GAPS = 20
"""Longest duration of a recording including gaps, as a multiple of its sampled time; a longer one is not continuous."""


class Companion(NamedTuple):
    """The detector that reads beside the estimator, and its names."""

    detector: Detector
    name: str = "leakage head"  # in sentences
    column: str = "head"  # at the beginning of its columns
    weights: str = HEAD_FILE  # of a head: the file by which an alarm names it

    @classmethod
    def of(cls, detector: LeakageHead | Detector, weights: str = HEAD_FILE) -> Companion:
        """A detector with its names: that of its class, unless it is a leakage head."""
        if isinstance(detector, LeakageHead):
            return cls(HeadDetector(detector), weights=weights)
        name = type(detector).__name__
        return cls(detector, name, name, "")

    @classmethod
    def named(cls, text: str | None) -> Companion:
        """The detector of ``module:attribute``, or a head from its weights; default: the shipped head.

        Raises:
            ConfigurationError: it cannot be loaded, or is no detector.
        """
        if text is not None and ":" in text and not Path(f"{text}.json").exists():
            return cls.of(make_detector(DetectorChoice(kind=text)))
        return cls(HeadDetector.load(text), weights=text or HEAD_FILE)

    @property
    def own(self) -> bool:
        """Whether it is another detector than the leakage head."""
        return not isinstance(self.detector, HeadDetector)


class Watched(NamedTuple):
    """Result of the alarm."""

    at: float | None  # s, of the alarm; None: there was none
    rate: float | None  # false alarms per 100 h for which it was set
    note: str = ""  # why it did not watch; empty if it watched
    detector: str = ""  # name of another detector than those of the project

    def line(self) -> str:
        """The alarm in one sentence."""
        alarm = f"The alarm of {self.detector}" if self.detector else "The alarm"
        if self.note:
            return f"{alarm} did not watch: {self.note}."
        rate = f", set for a rate of {self.rate:g} per 100 h in healthy axes," if self.rate is not None else ""
        when = f"rose at {self.at:.1f} s" if self.at is not None else "stayed silent"
        return f"{alarm}{rate} {when}."


def watched(checked: Checked, companion: Companion, task: TaskConfig, settings: AlarmSettings) -> Watched:
    """Run an alarm over a recording, as if the axis had been switched on at its start, or say why it did not watch."""
    rate = settings.false_alarms_per_100_h
    try:
        if checked.severe:
            raise ConfigurationError(checked.severe[0].line())
        detector = detector_of(settings, companion)
        samples = checked.samples
        count = int(samples.place[-1]) + 1 if len(samples.place) else 0
        if count < window_of(detector, task):
            raise ConfigurationError("the recording is shorter than a window of the detector")
        if count > MOST_GAPS * len(samples.place):
            raise ConfigurationError("most of the time between the first and the last sample was not recorded")
        signals = np.full((1, len(samples.signals), count), np.nan)
        signals[0, :, samples.place] = samples.signals.T
        looks = looks_at(signals, task, detector, settings.interval)
    except ConfigurationError as error:
        return Watched(None, rate, str(error).removeprefix("alarm: "))
    raised = LeakAlarm(settings).follow(looks)[0].alarm[0]
    name = companion.name if companion.own and detector is companion.detector else ""
    return Watched(float(looks.time[raised.argmax()]) if raised.any() else None, rate, detector=name)


def detector_of(settings: AlarmSettings, companion: Companion) -> Detector:
    """The detector that an alarm was set for: the estimator, which is always there, or one with the companion.

    Raises:
        ConfigurationError: it was set for another detector.
    """
    kind, _, file = settings.detector.partition(" ")
    detector, weights = companion.detector, Path(companion.weights)
    if kind == "estimator":
        return make_detector(DetectorChoice(kind=kind))
    if isinstance(detector, HeadDetector):
        name = f"head {weights.name}"
        if kind in ("", *KINDS) and Path(file or weights).stem == weights.stem:
            return make_detector(DetectorChoice(kind=kind or "head"), detector)
    else:
        name = f"{type(detector).__module__}:{type(detector).__qualname__}"
        if not kind or (":" in kind and imported(kind) in (detector, type(detector))):
            return detector
    raise ConfigurationError(f"it was set for the detector '{settings.detector}', and '{name}' is given")
