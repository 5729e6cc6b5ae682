"""A made-up run of a leakage protocol with known answers."""

import numpy as np
import pandas as pd
from small_leaks import small

from hydro_agents.detection.detector import Cause
from hydro_agents.evaluation.leak_protocol import Detectors
from hydro_agents.evaluation.runner import Results

LEVELS = [0.0, 0.05, 0.1, 0.2, 0.3, 1.0, -1.0]
CONDITIONS = {
    "plain": {"group": "levels", "label": "ordinary motion", "duration": 2.0, "levels": LEVELS},
    "adrc": {"group": "controller", "label": "ADRC", "acting": "ADRC", "levels": [0.0, 0.1]},
    "null": {"group": "fault", "label": "valve null −1 %", "faults": {"valve_null_shift": -0.01}},
}
COUNT = 100


def protocol():
    detectors = {"head": {"kind": "head"}, "estimator": {"kind": "estimator"}}
    return small(conditions=CONDITIONS, detectors=detectors, levels=[0.0, 0.3])


def cell(detector, condition, level, flagged, factor=1.1, width=0.2, verdict=Cause.NONE, silent=0):
    """Windows of which ``flagged`` are reported; estimates beside the truth by ``factor``, intervals of ± ``width``."""
    leak = np.full(COUNT, level if level > 0.0 else 0.01)
    if level < 0.0:
        leak = np.where(np.arange(COUNT) % 2 == 0, 0.01, 1.0)
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
            "probability": np.where(leak > 0.03, 0.8, 0.2) if level < 0.0 else np.where(told, 0.5, np.nan),
            "flow_lpm": flow,
            "low_lpm": flow - width * leak,
            "high_lpm": flow + width * leak,
            "flagged": reported,
            "at_1_percent": reported,
            "verdict": verdicts,
            "leaking": leak > 0.03,
        }
    )


def run():
    found = {0.0: 1, 0.05: 30, 0.1: 70, 0.2: 98, 0.3: 100, 1.0: 100, -1.0: 50}
    frames = [cell(name, "plain", level, hits) for name in ("head", "estimator") for level, hits in found.items()]
    frames += [
        cell("head", "adrc", 0.0, 4),
        cell("head", "adrc", 0.1, 50),
        cell("head", "null", 0.0, 60),
        cell("head", "null", 0.3, 100, factor=2.0),
        cell("estimator", "null", 0.0, 0, verdict=Cause.VALVE, silent=80),
        cell("estimator", "null", 0.3, 0, silent=100),
    ]
    thresholds = pd.DataFrame({"detector": ["head", "estimator"], "at_1_percent": 0.5, "used": 0.5, "windows": 200})
    status = pd.DataFrame(
        [("head", "plain", "done", ""), ("estimator", "adrc", "not applicable", "reads no ADRC")],
        columns=["detector", "condition", "status", "message"],
    )
    bound = pd.DataFrame({"condition": "plain", "level": [0.3, 0.3, 1.0], "seed": 0.0, "sigma_lpm": [0.01, 0.03, 0.05]})
    made = {"windows": pd.concat(frames, ignore_index=True), "thresholds": thresholds, "alarms": alarms()}
    return Results(protocol(), Detectors({}), {"leak_bound": bound}, status, facts=[("file", "made up")], _made=made)


def alarms():
    shared = {"detector": "head", "then": "all", "axes": 40}
    healthy = {**shared, "leak_lpm": 0.0, "alarms": 2, "hours": 100.0}
    healthy |= {"per_100_h": 2.0, "per_100_h_low": 0.2, "per_100_h_high": 7.2}
    missed = {"missed": 0.02, "missed_low": 0.0, "missed_high": 0.1}
    leaks = [{**shared, **missed, "leak_lpm": level, "median_s": 3.0 / level, "p90_s": 9.0} for level in (0.1, 1.0)]
    return pd.DataFrame([healthy, *leaks])


def tables():
    return run().tables()
