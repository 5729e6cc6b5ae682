"""Computing time of a detector on this machine: seconds per window, and per update of the streaming head."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import Detector, Windows
from hydro_agents.detection.detectors import HeadDetector
from hydro_agents.detection.head import LeakageHead
from hydro_agents.evaluation.leak_jobs import windows
from hydro_agents.evaluation.leak_protocol import FIRST_TEST_SEED, HEALTHY, LeakProtocol
from hydro_env import ServoHydraulicVectorEnv, TaskConfig

WINDOWS, STRETCHES = 8, 16


def timings_table(protocol: LeakProtocol, detectors: dict[str, Detector]) -> pd.DataFrame:
    """Seconds on one core, the shortest of several repetitions: per window, and per update of a head on one axis."""
    config, base = protocol.task_in(protocol.base), protocol.conditions[protocol.base]
    samples = round(base.duration / config.control_period)
    signals, _ = windows(config, base.acting, protocol.cases_in(protocol.base, HEALTHY, WINDOWS), samples)
    rows: list[dict[str, object]] = []
    known = protocol.known_task(protocol.base)
    for name, detector in detectors.items():
        if detector.refuses(known, samples):
            continue
        seconds = _shortest(partial(detector.read, Windows.of(signals), known), 2) / WINDOWS
        rows.append({"detector": name, "what": "window", "seconds": seconds})
        if isinstance(detector, HeadDetector):
            rows.append({"detector": name, "what": "update", "seconds": _update(detector.head, config)})
    return pd.DataFrame(rows)


def _shortest(call: Callable[[], object], repetitions: int) -> float:
    best = np.inf
    for _ in range(repetitions):
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return float(best)


def _update(head: LeakageHead, config: TaskConfig) -> float:
    """Seconds per call of ``predict`` on one axis with a full window.

    A head reads its window once in many calls: mean over such a stretch, and the shortest of several stretches.
    """
    env = ServoHydraulicVectorEnv(1, config, info=False)
    observation, _ = env.reset(seed=[FIRST_TEST_SEED])
    env.close()
    state = None
    seconds = []
    for step in range(head.settings.window + STRETCHES * head.interval):
        start = time.perf_counter()
        _, state = head.predict(observation, state, np.array([step == 0]))
        seconds.append(time.perf_counter() - start)
    stretches = np.reshape(seconds[-STRETCHES * head.interval :], (STRETCHES, head.interval))
    return float(stretches.mean(axis=1).min())
