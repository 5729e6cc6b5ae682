"""The robustness protocol: the same plants, references and noise for every controller, at every leak level.

A list of independent cases, each a pure function of configuration and seed. Only test seeds are used here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, model_validator

from agents.controllers.base import Controller, ObservationLayout
from agents.evaluation.metrics import METRICS, rollout_metrics
from agents.evaluation.statistics import (
    conditional_value_at_risk,
    geometric_ratio_interval,
    mean_interval,
    ratio_interval,
    share_interval,
)
from agents.leakage.head import SIGNALS, LeakageHead
from agents.leakage.metrics import (
    area_under_roc,
    average_precision,
    detection_rate,
    precision_recall_curve,
    roc_curve,
    threshold_at_false_alarm_rate,
)
from agents.running.cases import Cases, Rollout, run_cases
from agents.running.seeds import TEST_SEEDS
from hydro_env import LEAKAGE_CLASSES, REFERENCE_FAMILIES, TaskConfig
from hydro_env.files import Group
from hydro_env.task.configuration import LEAKAGE_LIMIT

DETECTION_SEEDS_OFFSET = 500_000
SEEDS_PER_FAMILY = 10_000
FALSE_ALARM_RATE = 0.01


class ProtocolSettings(Group):
    """Size of an evaluation."""

    leak_levels: tuple[float, ...] = Field(
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0), min_length=1, description="l/min at 100 bar"
    )
    families: tuple[str, ...] = Field(REFERENCE_FAMILIES[:6], min_length=1)
    plants: int = Field(32, ge=3, le=10_000, description="per level and family")
    detection_episodes: int = Field(4000, ge=100, le=200_000, description="per controller, half of them healthy")

    @model_validator(mode="after")
    def _possible(self) -> ProtocolSettings:
        for level in self.leak_levels:
            if not 0.0 < level <= LEAKAGE_LIMIT:
                raise ValueError(f"leak_levels: {level:g} l/min: must be within 0 (excluded) to {LEAKAGE_LIMIT:g}")
        for family in self.families:
            if family not in REFERENCE_FAMILIES[:6]:
                raise ValueError(f"families: unknown '{family}'; known: {', '.join(REFERENCE_FAMILIES[:6])}")
        for name in ("leak_levels", "families"):
            if len(set(getattr(self, name))) != len(getattr(self, name)):
                raise ValueError(f"{name}: holds something twice")
        return self


@dataclass(frozen=True)
class Evaluation:
    """Every number of an evaluation, as tables."""

    cases: pd.DataFrame  # one row per controller, level, family, plant
    levels: pd.DataFrame  # per controller and level: means, intervals, worst case, CVaR of every metric
    families: pd.DataFrame  # the same per controller and family
    ratios: pd.DataFrame  # per controller against the first: overall, per level, per family
    detection: pd.DataFrame  # one row per episode for the head
    detection_rates: pd.DataFrame  # per controller and class or level
    detection_summary: pd.DataFrame  # per controller: AUROC, average precision, false alarms, size error
    curves: pd.DataFrame  # ROC and precision–recall


def tracking_cases(settings: ProtocolSettings) -> tuple[Cases, pd.DataFrame]:
    """All cases of the tracking part, and a table of what each is."""
    rows = [
        (level, family, plant)
        for level in settings.leak_levels
        for family in settings.families
        for plant in range(settings.plants)
    ]
    table = pd.DataFrame(rows, columns=["leakage_flow_lpm", "family", "plant"])
    # A family meets the same plants at every level; another family meets others.
    family_number = table["family"].map({name: i for i, name in enumerate(REFERENCE_FAMILIES)})
    seeds = TEST_SEEDS.start + table["plant"].to_numpy() + SEEDS_PER_FAMILY * family_number.to_numpy()
    cases = Cases(seeds.astype(np.int64), table["leakage_flow_lpm"].to_numpy(), table["family"].to_numpy().astype(str))
    return cases, table


def evaluate(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    head: LeakageHead | None,
    settings: ProtocolSettings,
    progress: Callable[[str, int, int], None] | None = None,
) -> Evaluation:
    """Run the protocol.

    Args:
        config: the task.
        controllers: by name; the first is the one that the others are compared with.
        head: leakage head, run under every controller; ``None`` leaves detection out.
        settings: size of the evaluation.
        progress: called with what runs, cases done, of how many.
    """
    cases, table = tracking_cases(settings)
    frames = []
    for name, controller in controllers.items():

        def report(done: int, what: str = name) -> None:
            if progress is not None:
                progress(f"tracking, {what}", done, len(cases))

        rollout = run_cases(config, controller, cases, progress=report)
        assert cases.families is not None
        preview = max(config.references.preview_times, default=0.0)
        metrics = rollout_metrics(rollout, cases.families, config.control_period, preview)
        frames.append(table.assign(controller=name, seed=cases.seeds, **metrics))
    all_cases = pd.concat(frames, ignore_index=True)

    detection = pd.DataFrame()
    if head is not None:
        detection = _detection(config, controllers, head, settings, progress)
    return Evaluation(
        cases=all_cases,
        levels=_summary(all_cases, "leakage_flow_lpm"),
        families=_summary(all_cases, "family"),
        ratios=_ratios(all_cases, list(controllers)),
        detection=detection,
        detection_rates=_detection_rates(detection) if head is not None else pd.DataFrame(),
        detection_summary=_detection_summary(detection, head, config) if head is not None else pd.DataFrame(),
        curves=_curves(detection, config) if head is not None else pd.DataFrame(),
    )


def _per_plant(frame: pd.DataFrame, metric: str) -> NDArray[np.float64]:
    """Mean over everything else, by plant."""
    means: NDArray[np.float64] = frame.groupby("plant")[metric].mean().to_numpy(dtype=np.float64)
    return means


def _summary(cases: pd.DataFrame, by: str) -> pd.DataFrame:
    rows = []
    for (controller, group), frame in cases.groupby(["controller", by], sort=False):
        for metric, (unit, _) in METRICS.items():
            interval = mean_interval(_per_plant(frame, metric))
            rows.append(
                {
                    "controller": controller,
                    by: group,
                    "metric": metric,
                    "unit": unit,
                    "mean": interval.value,
                    "low": interval.low,
                    "high": interval.high,
                    "worst": float(frame[metric].max()),
                    "cvar_5_percent": conditional_value_at_risk(frame[metric].to_numpy()),
                    "cases": len(frame),
                }
            )
    return pd.DataFrame(rows)


def _ratios(cases: pd.DataFrame, names: list[str]) -> pd.DataFrame:
    """Mean error of each controller over that of the first, paired by plant.

    Over all cases, per level, per family, and over all with equal weight for each family (large steps otherwise
    outweigh the rest).
    """
    rows = []
    base = cases[cases["controller"] == names[0]]
    groups: list[tuple[str, str, object]] = [("all", "", None)]
    groups += [("level", str(level), level) for level in cases["leakage_flow_lpm"].unique()]
    groups += [("family", family, family) for family in cases["family"].unique()]
    for name in names[1:]:
        own = cases[cases["controller"] == name]
        for kind, label, value in groups:
            column = {"level": "leakage_flow_lpm", "family": "family"}.get(kind)
            mine = own if column is None else own[own[column] == value]
            theirs = base if column is None else base[base[column] == value]
            a, b = _per_plant(mine, "mean_error_mm"), _per_plant(theirs, "mean_error_mm")
            interval = ratio_interval(a, b)
            wins = float(np.mean(mine["mean_error_mm"].to_numpy() < theirs["mean_error_mm"].to_numpy()))
            rows.append(
                {
                    "controller": name,
                    "against": names[0],
                    "group": kind,
                    "value": label,
                    "ratio": interval.value,
                    "low": interval.low,
                    "high": interval.high,
                    "share_of_cases_better": wins,
                }
            )
        by_family = [
            [_per_plant(frame[frame["family"] == family], "mean_error_mm") for family in cases["family"].unique()]
            for frame in (own, base)
        ]
        interval = geometric_ratio_interval(np.array(by_family[0]), np.array(by_family[1]))
        rows.append(
            {
                "controller": name,
                "against": names[0],
                "group": "equal_weight",
                "value": "geometric mean of the families' ratios",
                "ratio": interval.value,
                "low": interval.low,
                "high": interval.high,
                "share_of_cases_better": float("nan"),
            }
        )
    return pd.DataFrame(rows)


def _detection(
    config: TaskConfig,
    controllers: Mapping[str, Controller],
    head: LeakageHead,
    settings: ProtocolSettings,
    progress: Callable[[str, int, int], None] | None,
) -> pd.DataFrame:
    """Healthy and leaking episodes of drawn references, the same for every controller, and what the head says."""
    layout = ObservationLayout.of(config)
    columns = [layout.index(name) for name in SIGNALS]
    count = settings.detection_episodes
    generator = np.random.default_rng(TEST_SEEDS.start)
    healthy = np.arange(count) % 2 == 0
    low = np.where(healthy, config.leakage.healthy_range[0], config.leakage.faulty_range[0])
    high = np.where(healthy, config.leakage.healthy_range[1], config.leakage.faulty_range[1])
    flow = np.exp(generator.uniform(np.log(low), np.log(high)))
    first = TEST_SEEDS.start + DETECTION_SEEDS_OFFSET
    cases = Cases(np.arange(first, first + count), flow)
    frames = []
    for name, controller in controllers.items():

        def report(done: int, what: str = name) -> None:
            if progress is not None:
                progress(f"detection, {what}", done, count)

        rollout: Rollout = run_cases(config, controller, cases, columns, states=False, progress=report)
        assert rollout.signals is not None
        estimate = head.estimate_signals(rollout.signals)
        frames.append(
            pd.DataFrame(
                {
                    "controller": name,
                    "seed": cases.seeds,
                    "leakage_flow_lpm": flow,
                    "class": [LEAKAGE_CLASSES[code] for code in rollout.leakage_class],
                    "probability": estimate.probability,
                    "estimated_flow_lpm": estimate.flow_lpm,
                    "flagged": estimate.probability >= head.settings.threshold,
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


BINS = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 4.0)


def _detection_rates(detection: pd.DataFrame) -> pd.DataFrame:
    """Share flagged: per class, per range of sizes, and for all leaks of at least 0.3 l/min."""
    rows = []
    for controller, frame in detection.groupby("controller", sort=False):
        groups = [("class", name, frame[frame["class"] == name]) for name in LEAKAGE_CLASSES]
        flow = frame["leakage_flow_lpm"]
        for a, b in pairwise(BINS):
            groups.append(("range", f"{a:g}–{b:g}", frame[(flow >= a) & (flow < b)]))
        groups.append(("range", "≥ 0.3", frame[flow >= 0.3]))
        for kind, label, part in groups:
            interval = share_interval(int(part["flagged"].sum()), len(part))
            rows.append(
                {
                    "controller": controller,
                    "group": kind,
                    "value": label,
                    "flagged_share": interval.value,
                    "low": interval.low,
                    "high": interval.high,
                    "episodes": len(part),
                }
            )
    return pd.DataFrame(rows)


def _healthy_and_leaking(flow: NDArray[np.float64], config: TaskConfig) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which episodes count as healthy and which as leaking, by the classes of the task."""
    return flow <= config.leakage.class_bounds[0], flow > config.leakage.faulty_range[0]


def _detection_summary(detection: pd.DataFrame, head: LeakageHead, config: TaskConfig) -> pd.DataFrame:
    rows = []
    for controller, frame in detection.groupby("controller", sort=False):
        flow = frame["leakage_flow_lpm"].to_numpy()
        score = frame["probability"].to_numpy()
        healthy, leaking = _healthy_and_leaking(flow, config)
        kept = healthy | leaking
        seen = flow >= 0.3
        at_test_rate = threshold_at_false_alarm_rate(score[healthy], FALSE_ALARM_RATE)
        decades = np.abs(np.log10(frame["estimated_flow_lpm"].to_numpy()[leaking] / flow[leaking]))
        rows.append(
            {
                "controller": controller,
                "auroc_above_0.1_lpm": area_under_roc(score[kept], leaking[kept]),
                "average_precision": average_precision(score[kept], leaking[kept]),
                "threshold": head.settings.threshold,
                "false_alarm_rate": detection_rate(score[healthy], head.settings.threshold),
                "detection_rate_from_0.3_lpm": detection_rate(score[seen], head.settings.threshold),
                "detection_rate_from_0.3_lpm_at_1_percent": detection_rate(score[seen], at_test_rate),
                "median_size_error_factor": float(10 ** np.median(decades)),
                "p90_size_error_factor": float(10 ** np.quantile(decades, 0.9)),
                "healthy_episodes": int(healthy.sum()),
                "leaking_episodes": int(leaking.sum()),
            }
        )
    return pd.DataFrame(rows)


def _curves(detection: pd.DataFrame, config: TaskConfig) -> pd.DataFrame:
    frames = []
    for controller, frame in detection.groupby("controller", sort=False):
        flow = frame["leakage_flow_lpm"].to_numpy()
        healthy, leaking = _healthy_and_leaking(flow, config)
        kept = healthy | leaking
        score, positive = frame["probability"].to_numpy()[kept], leaking[kept]
        for name, curve in (
            ("roc", roc_curve(score, positive)),
            ("precision_recall", precision_recall_curve(score, positive)),
        ):
            frames.append(
                pd.DataFrame(
                    {"controller": controller, "curve": name, "x": curve.x, "y": curve.y, "threshold": curve.threshold}
                )
            )
    return pd.concat(frames, ignore_index=True)
