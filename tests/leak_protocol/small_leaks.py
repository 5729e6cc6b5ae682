"""A small leakage protocol and a detector for its tests."""

import numpy as np

from hydro_agents.detection.detector import Cause, Reading
from hydro_agents.evaluation.leak_protocol import Detectors, LeakProtocol
from hydro_agents.evaluation.runner import run

SMALL = {
    "task": {"episode_duration": 0.3},
    "levels": [0.0, 1.0],
    "detectors": {"D": {"kind": "head", "windows": 10, "validation_windows": 20, "batch": 6}},
    "base": "plain",
    "conditions": {
        "plain": {"group": "levels", "duration": 0.3, "levels": [0.0, 1.0, -1.0]},
        "null": {"group": "fault", "duration": 0.3, "faults": {"valve_null_shift": 0.02}},
    },
}


def small(**changes):
    return LeakProtocol(**{**SMALL, **changes})


def ran(protocol=None, detectors=None, alarms=None, **options):
    """Results of a small protocol; by default with one detector, in this process."""
    chosen = Detectors(detectors or {"D": Spread()}, alarms or {})
    return run(protocol or small(), chosen, **{"jobs": 1, **options})


class Spread:
    """Scores the spread of the spool; silent where the spool stands far out, and never on windows of another length."""

    threshold = None

    def __init__(self, factor=1.0, samples=60):
        self.factor, self.samples = factor, samples

    def refuses(self, task, samples):
        return "" if samples == self.samples else f"reads {self.samples} samples"

    def read(self, windows, task):
        spool = windows.signal("spool_position")
        score = np.where(np.abs(spool).max(axis=1) > 0.9, np.nan, self.factor * spool.std(axis=1))
        return Reading.of(score, np.where(np.abs(spool.mean(axis=1)) > 0.01, Cause.VALVE, Cause.NONE))
