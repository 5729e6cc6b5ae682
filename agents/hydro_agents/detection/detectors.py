"""The detectors by name: the leakage head, the estimator, both in two stages, or any class of your own."""

from __future__ import annotations

from typing import Any

from pydantic import Field, field_validator

from hydro_agents.controllers.by_name import imported
from hydro_agents.detection.detector import Detector
from hydro_env import ConfigurationError
from hydro_env.files import Group

DETECTOR_KINDS = ("head", "estimator", "two_stage")

ESTIMATOR = "hydro_rig.estimation.estimator:EstimatorDetector"
TWO_STAGE = "hydro_rig.estimation.two_stage:TwoStageDetector"
"""Detectors of the package above this one: they come by name."""


class DetectorChoice(Group):
    """A detector, and how many windows it reads in a protocol."""

    kind: str = Field(description="head, estimator, two_stage, or module:attribute for your own")
    weights: str | None = Field(None, description="of a head or two_stage: a path; default: the shipped one")
    task: dict[str, Any] = Field(
        default_factory=dict,
        description="of an estimator: changed fields of its task, such as ranges; unknowns and priors follow from it",
    )
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
        if kind not in DETECTOR_KINDS and ":" not in kind:
            raise ValueError(f"must be {', '.join(DETECTOR_KINDS)}, or module:attribute")
        return kind


def make_detector(choice: DetectorChoice) -> Detector:
    """The detector of a choice.

    Raises:
        ConfigurationError: its weights cannot be read, or the object that it names is no detector.
    """
    detector: Detector
    if ":" in choice.kind:
        named = imported(choice.kind)
        detector = named() if isinstance(named, type) else named
        missing = [part for part in ("threshold", "refuses", "read") if not hasattr(detector, part)]
        if missing:
            raise ConfigurationError(f"'{choice.kind}': is no leak detector, it has no {', '.join(missing)}")
    elif choice.kind == "estimator":
        detector = imported(ESTIMATOR)(choice.task)
    else:
        from hydro_agents.detection.monitor import HeadDetector  # a detector of your own needs no network

        detector = HeadDetector.load(choice.weights)
        if choice.kind == "two_stage":
            detector = imported(TWO_STAGE)(detector, imported(ESTIMATOR)(choice.task, restarts=0))
    return detector
