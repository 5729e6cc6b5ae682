"""Evaluation of the leakage head under each controller: whole episodes, and the shares that it flags."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import mannwhitneyu

from hydro_agents.detection.detector import Detector, MeasuredColumns, Windows
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.evaluation.conditions import Cell
from hydro_agents.evaluation.participants import split_name
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.seeds import DETECTION, EVALUATION
from hydro_agents.running.statistics import share_interval
from hydro_env import LEAKAGE_CLASSES, TaskConfig

if TYPE_CHECKING:
    from hydro_agents.controllers.base import Controller
    from hydro_agents.detection.head import LeakageHead
    from hydro_agents.evaluation.participants import Participants
    from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol


RANGE_EDGES = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 4.0)
"""l/min at 100 bar; bounds of the size ranges, if the task draws such leaks."""


def detection_cases(config: TaskConfig, count: int) -> Cases:
    """Alternating healthy and leaking episodes, sizes log-uniform, references drawn; the same for every controller."""
    generator = np.random.default_rng(EVALUATION.first)
    healthy = np.arange(count) % 2 == 0
    low = np.where(healthy, config.leakage.healthy_range[0], config.leakage.faulty_range[0])
    high = np.where(healthy, config.leakage.healthy_range[1], config.leakage.faulty_range[1])
    flow = np.exp(generator.uniform(np.log(low), np.log(high)))
    return Cases(np.array(DETECTION.take(count)), flow)


def episodes(protocol: RobustnessProtocol, chosen: Participants) -> Iterator[Cell]:
    """The head on whole episodes under every controller; nothing without a head."""
    if chosen.head is None:
        return
    cases = detection_cases(protocol.task, protocol.detection_episodes)
    for name, controller in chosen.controllers.items():
        digest = fingerprint(controller, chosen.head)
        job = Job(watched, (controller, chosen.head), (protocol.task, cases), digest)
        known = dict(zip(("controller", "training_seed"), split_name(name), strict=True))
        yield Cell(name, next(iter(protocol.conditions)), known, (job,))


def watched(pair: tuple[Controller, LeakageHead], config: TaskConfig, cases: Cases) -> Columns:
    """The episodes of a controller, as the head reads them.

    Raises:
        ControllerError: the controller failed.
    """
    controller, head = pair
    rollout = run_cases(config, controller, cases, MeasuredColumns.of(config).columns, states=False)
    return detection_columns(cases, rollout, HeadDetector(head), config)


def detection_columns(cases: Cases, rollout: Rollout, detector: Detector, config: TaskConfig) -> Columns:
    """Per episode: the leak, and the detector's reading of the whole episode."""
    assert rollout.signals is not None
    assert cases.leakage_flow_lpm is not None
    assert detector.threshold is not None
    reading = detector.read(Windows.of(MeasuredColumns.of(config).si(rollout.signals)), config)
    return {
        "seed": cases.seeds,
        "leakage_flow_lpm": cases.leakage_flow_lpm,
        "class": np.array([LEAKAGE_CLASSES[code] for code in rollout.leakage_class]),
        "probability": reading.probability,
        "estimated_flow_lpm": reading.flow_lpm,
        "flagged": reading.score >= detector.threshold,
    }


def detection_rates(detection: pd.DataFrame, config: TaskConfig) -> pd.DataFrame:
    """Share flagged: per class, per range of sizes, and for all leaks of the moderate class and above."""
    rows = []
    moderate_from = config.leakage.class_bounds[1]
    smallest, largest = config.leakage.faulty_range
    edges = [smallest, *(edge for edge in RANGE_EDGES if smallest < edge < largest), largest]
    for controller, frame in detection.groupby("controller", sort=False):
        flow = frame["leakage_flow_lpm"]
        groups = [("class", name, frame["class"] == name) for name in LEAKAGE_CLASSES]
        for low, high in pairwise(edges):
            groups.append(("range", f"{low:g}–{high:g}", (flow >= low) & (flow < high)))
        groups.append(("range", f"≥ {moderate_from:g}", flow >= moderate_from))
        for kind, label, chosen in groups:
            part = frame[chosen]
            share = share_interval(int(part["flagged"].sum()), len(part)).named("flagged_share")
            rows.append({"controller": controller, "group": kind, "value": label, **share, "episodes": len(part)})
    return pd.DataFrame(rows)


def area_under_roc(scores: NDArray[Any], positive: NDArray[np.bool_]) -> float:
    """Probability that a leak scores higher than a healthy seal (ties count half); NaN without both kinds."""
    if positive.all() or not positive.any():
        return float("nan")
    pairs = np.count_nonzero(positive) * np.count_nonzero(~positive)
    return float(mannwhitneyu(scores[positive], scores[~positive], method="asymptotic").statistic / pairs)
