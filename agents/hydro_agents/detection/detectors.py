"""The protocol's interface to a detector, and the choice between the leakage head and the estimator."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from hydro_env import TaskConfig
from hydro_env.files import Group

Floats = NDArray[np.float64]

VERDICTS = ("none", "internal leak", "external leak", "valve fault", "sensor fault", "return line", "cannot tell")
"""Possible verdicts of a detector on a window."""

NONE, INTERNAL, EXTERNAL, VALVE, SENSOR, RETURN, UNKNOWN = range(len(VERDICTS))


class Reading(NamedTuple):
    """Results of a detector for N windows, each (N,); NaN: no answer."""

    score: Floats  # rises with the evidence of a leak past the piston; NaN: it cannot tell
    probability: Floats  # of a leak past the piston, 0 to 1
    flow_lpm: Floats  # estimated leak, l/min at 100 bar
    low_lpm: Floats  # 90 % interval of the leak
    high_lpm: Floats
    otherwise: Floats  # number of the verdict if the score is below the threshold


class Detector(Protocol):
    """Anything that evaluates windows of measured signals."""

    threshold: float | None
    """Score at which it reports a leak; ``None``: the protocol computes it from validation windows."""

    def refuses(self, config: TaskConfig, samples: int) -> str:
        """The reason why it cannot read windows of ``samples`` samples of a task; empty if it can."""
        ...

    def read(self, signals: NDArray[Any], config: TaskConfig) -> Reading:
        """Evaluate windows.

        Args:
            signals: (N, 5, T) in SI units, in the order of :data:`~hydro_agents.detection.head.SIGNALS`.
            config: the task as known to the detector: rig, ranges and sensors, not the drawn plants.
        """
        ...


class DetectorChoice(Group):
    """A detector of a protocol, and how many windows it reads."""

    kind: str = Field(description="head, estimator, or module:attribute for your own")
    weights: str | None = Field(None, description="of a head: a path; default: the shipped one")
    task: dict[str, Any] = Field(
        default_factory=dict,
        description="of an estimator: changed fields of its task, such as faults; unknowns and priors follow from it",
    )
    unknowns: tuple[str, ...] = Field((), description="of an estimator: in addition to those from the task")
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


def logit(probability: NDArray[Any]) -> Floats:
    """Logarithm of the odds, finite for 0 and 1."""
    inside = np.clip(np.asarray(probability, dtype=np.float64), 1e-15, 1.0 - 1e-15)
    return np.asarray(np.log(inside / (1.0 - inside)))
