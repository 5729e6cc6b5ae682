"""The detectors by name: the leakage head, the estimator, or any class of your own."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field, field_validator

from hydro_agents.controllers.registry import imported
from hydro_agents.detection.detector import Cause, Detector, Reading, Windows, logit
from hydro_agents.detection.estimator import EstimatorDetector, FollowingDetector
from hydro_agents.detection.features import LABELS
from hydro_agents.detection.head import LeakageEstimate, LeakageHead
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group

HEAD_FILE = "leakage_head"

OUTSIDE = "unlike all that the leakage head was trained on"

OTHER_CAUSES = tuple(cause for cause in Cause if Cause.INTERNAL_LEAK < cause < Cause.UNKNOWN)
"""Causes that the head names besides a leak past the piston."""


class HeadDetector:
    """The leakage head: its score is the logit of the probability of a leak."""

    def __init__(self, head: LeakageHead) -> None:
        self.head, self.window = head, head.settings.window
        self.threshold: float | None = float(logit(np.array([head.settings.threshold]))[0])

    def refuses(self, task: TaskConfig, samples: int) -> str:
        """The reason if rig or control period differ from those of its training, or the windows are too short."""
        settings = self.head.settings
        if settings.task.plant != task.plant:
            return "the leakage head was trained for another rig"
        if settings.task.control_period != task.control_period:
            return f"the leakage head was trained for a control period of {1e3 * settings.task.control_period:g} ms"
        if samples < settings.window:
            return f"the leakage head reads windows of at least {settings.window * task.control_period:g} s"
        return ""

    def read(self, windows: Windows, task: TaskConfig) -> Reading:
        """Read windows; a window unlike those of the training, or with a stuck sensor, has the cause ``UNKNOWN``."""
        del task
        found = self.head.estimate_windows(windows.signals)
        outside = found.outside > 0.0
        excess = self._excess(found)
        named = np.where(excess.max(axis=1) > 0.0, np.array(OTHER_CAUSES)[excess.argmax(axis=1)], Cause.NONE)
        return Reading.of(
            logit(found.probability),
            np.where(outside, Cause.UNKNOWN, named),
            probability=found.probability,
            flow_lpm=found.flow_lpm,
            low_lpm=found.low_lpm,
            high_lpm=found.high_lpm,
            fault=tuple(
                " and ".join(cause.in_full for cause, above in zip(OTHER_CAUSES, row, strict=True) if above)
                for row in (excess > 0.0).tolist()
            ),
            why=tuple(np.where(outside, OUTSIDE, "").tolist()),
        )

    def _excess(self, found: LeakageEstimate) -> Any:
        """Logits of the other causes above their thresholds, (N, causes)."""
        names = [cause.word.replace(" ", "_") for cause in OTHER_CAUSES]
        thresholds = logit(self.head.tensors["thresholds"])[[LABELS.index(name) for name in names]]
        return logit(np.column_stack([getattr(found, name) for name in names])) - thresholds


class DetectorChoice(Group):
    """A detector, and how many windows it reads in a protocol."""

    kind: str = Field(description="head, estimator, or module:attribute for your own")
    weights: str | None = Field(None, description="of a head: a path; default: the shipped one")
    task: dict[str, Any] = Field(
        default_factory=dict,
        description="of an estimator: changed fields of its task, such as ranges; unknowns and priors follow from it",
    )
    unknowns: tuple[str, ...] = Field((), description="of an estimator: in addition to its own")
    groups: tuple[str, ...] = Field((), description="of the conditions that it reads; default: all")
    windows: int = Field(1000, ge=1, le=100_000, description="windows per leak level")
    validation_windows: int = Field(
        4000, ge=20, le=100_000, description="healthy windows for the threshold at 1 % false alarms"
    )
    batch: int = Field(
        500, ge=1, le=10_000, description="windows per job; fixed: results must not depend on the machine"
    )

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in ("head", "estimator") and ":" not in kind:
            raise ValueError("must be head, estimator, or module:attribute")
        return kind


def make_detector(choice: DetectorChoice, head: LeakageHead | None = None, following: bool = False) -> Detector:
    """The detector of a choice.

    Args:
        choice: kind and settings.
        head: replaces the head of the choice.
        following: whether it reads successive windows of the same axes; an estimator then follows them.

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
        return (FollowingDetector if following else EstimatorDetector)(choice.task, choice.unknowns)
    return HeadDetector(head or LeakageHead.load(choice.weights or pretrained_folder() / HEAD_FILE))
