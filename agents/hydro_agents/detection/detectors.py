"""The detectors of a protocol by name: the leakage head, the estimator, or any class of your own."""

from pydantic import Field, field_validator

from hydro_agents.controllers.by_name import imported
from hydro_agents.detection.detector import Detector
from hydro_env import ConfigurationError
from hydro_env.files import Group

ESTIMATOR = "hydro_rig.estimation.estimator:EstimatorDetector"  # of the package above this one: it comes by name


class DetectorChoice(Group):
    """A detector, and how many windows it reads in a protocol."""

    kind: str = Field(description="head, estimator, or module:attribute for your own")
    weights: str | None = Field(None, description="of a head: a path; default: the shipped one")
    windows: int = Field(1000, ge=1, le=100_000, description="windows per leak level")
    validation_windows: int = Field(4000, ge=20, le=100_000, description="healthy ones, for 1 % false alarms")
    batch: int = Field(500, ge=1, le=10_000, description="windows per job; fixed: no result depends on the machine")

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in ("head", "estimator") and ":" not in kind:
            raise ValueError("must be head, estimator, or module:attribute")
        return kind


def make_detector(choice: DetectorChoice) -> Detector:
    """The detector of a choice.

    Raises:
        ConfigurationError: its weights cannot be read, or the object that it names is no detector.
    """
    if choice.kind == "head":
        from hydro_agents.detection.monitor import HeadDetector  # a detector of your own needs no network

        return HeadDetector.load(choice.weights)
    named = imported(ESTIMATOR if choice.kind == "estimator" else choice.kind)
    detector = named() if isinstance(named, type) else named
    if missing := [part for part in ("threshold", "refuses", "read") if not hasattr(detector, part)]:
        raise ConfigurationError(f"'{choice.kind}': is no leak detector, it has no {', '.join(missing)}")
    return detector
