"""A small leakage protocol, a detector, and a made-up run with known answers."""

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import Cause, Reading
from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.evaluation.runner import Results, run

SMALL = {
    "task": {"episode_duration": 0.3},
    "levels": [0.0, 1.0],
    "detectors": {"D": {"kind": "head", "windows": 10, "validation_windows": 20, "batch": 6}},
    "base": "plain",
    "conditions": {
        "plain": {"group": "levels", "duration": 0.3, "levels": [0.0, 1.0]},
        "null": {"group": "fault", "duration": 0.3, "faults": {"valve_null_shift": 0.02}},
    },
}


def small(**changes):
    return LeakProtocol(**{**SMALL, **changes})


def ran(protocol=None, detectors=None, **options):
    """Results of a small protocol; by default with one detector."""
    return run(protocol or small(), detectors or {"D": Spread()}, **options)


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


LEVELS = [0.0, 0.05, 0.1, 0.2, 0.3, 1.0]
CONDITIONS = {
    "plain": {"group": "levels", "label": "ordinary motion", "duration": 2.0, "levels": LEVELS},
    "three_step": {"group": "controller", "label": "switch", "acting": "three-step switch", "levels": [0.0, 0.1]},
    "null": {"group": "fault", "label": "valve null −1 %", "faults": {"valve_null_shift": -0.01}},
}
COUNT = 100


def made_up_protocol():
    detectors = {"head": {"kind": "head"}, "estimator": {"kind": "estimator"}}
    return small(conditions=CONDITIONS, detectors=detectors, levels=[0.0, 0.3])


def cell(detector, condition, level, flagged, factor=1.1, width=0.2, verdict=Cause.NONE, silent=0):
    """Windows of which ``flagged`` are reported; estimates beside the truth by ``factor``, intervals of ± ``width``."""
    leak = np.full(COUNT, level if level > 0.0 else 0.01)
    reported = np.arange(COUNT) < flagged
    verdicts = np.where(reported, Cause.INTERNAL_LEAK, verdict)
    verdicts[COUNT - silent :] = Cause.UNKNOWN if silent else verdicts[COUNT - silent :]
    told = verdicts != Cause.UNKNOWN
    flow = np.where(told, leak * factor, np.nan)
    return pd.DataFrame(
        {
            "detector": detector,
            "condition": condition,
            "level": level,
            "seed": np.arange(COUNT, dtype=float),
            "leak_lpm": leak,
            "error_mm": 0.1 if condition == "plain" else 0.05,
            "score": np.where(told, reported.astype(float), np.nan),
            "flow_lpm": flow,
            "low_lpm": flow - width * leak,
            "high_lpm": flow + width * leak,
            "flagged": reported,
            "at_1_percent": reported,
            "verdict": verdicts,
        }
    )


def made_up_run():
    found = {0.0: 1, 0.05: 30, 0.1: 70, 0.2: 98, 0.3: 100, 1.0: 100}
    frames = [cell(name, "plain", level, hits) for name in ("head", "estimator") for level, hits in found.items()]
    frames += [
        cell("head", "three_step", 0.0, 4),
        cell("head", "three_step", 0.1, 50),
        cell("head", "null", 0.0, 60),
        cell("head", "null", 0.3, 100, factor=2.0),
        cell("estimator", "null", 0.0, 0, verdict=Cause.VALVE, silent=80),
        cell("estimator", "null", 0.3, 0, silent=100),
    ]
    thresholds = pd.DataFrame({"detector": ["head", "estimator"], "at_1_percent": 0.5, "used": 0.5, "windows": 200})
    status = pd.DataFrame(
        [("head", "plain", "done", ""), ("estimator", "three_step", "not applicable", "reads no switch")],
        columns=["detector", "condition", "status", "message"],
    )
    bound = pd.DataFrame({"condition": "plain", "level": [0.3, 0.3, 1.0], "seed": 0.0, "sigma_lpm": [0.01, 0.03, 0.05]})
    made = {"windows": pd.concat(frames, ignore_index=True), "thresholds": thresholds}
    return Results(made_up_protocol(), {}, {"bound": bound}, status, facts=[("file", "made up")], _made=made)


def made_up_tables():
    return made_up_run().tables()
