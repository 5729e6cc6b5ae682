"""How well one leakage head reads rigs that it never saw, beside its flow balance alone and heads of a rig's own.

    python benchmarks/any_axis_head.py [--weights HEAD] [--rigs 30] [--own 0] [--split test] [--output FILE]

Windows of 2 s under untuned flow linearisation, and of axes that a P controller holds. A leak of 1 % is 1 % of the flow
at full opening, at 100 bar. "Found" is the share found with a threshold that gives 1 % false alarms on healthy axes of
that rig. ``--own`` trains heads on the first rigs, minutes per rig. The file of rows is the checkpoint.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.kept_rows import kept_rows
from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.detection.balance import INTERNAL, fit_balance
from hydro_agents.detection.damaged_signals import repaired
from hydro_agents.detection.detector import logit, measured_run, threshold_at_false_alarm_rate
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.head_training import train_head
from hydro_agents.detection.operations import MANNERS, Operation, at_rest
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.detection.training_settings import HeadTrainingSettings
from hydro_agents.evaluation.detection import area_under_roc
from hydro_agents.running.cases import Cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import DETECTION, THRESHOLDS, SeedRange
from hydro_agents.running.text import markdown
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.types import Floats

ANY, BALANCE, OWN = "head for any axis", "its flow balance alone", "head of the rig's own"
FULL_FLOW = 11.298  # l/min, of the paper's rig at full opening
HEALTHY = 0.1  # % of the flow at full opening
SHARES = (HEALTHY, 0.5, 1.0, 3.0)
WINDOWS = 300  # of each leak; of healthy axes three times as many
RUNS = 4000  # for a head of the rig's own


def windows(task: TaskConfig, still: bool, share: float, plants: SeedRange, skip: int) -> Floats:
    """Signals (N, 5, T), SI, of axes with a leak of a share (%) of the flow at full opening."""
    count = WINDOWS if share > HEALTHY else 3 * WINDOWS
    seeds = np.array(plants.take(count, skip))
    leaks = np.full(count, 0.01 * share * FULL_FLOW * leak_scale(task))
    acting: Controller = FlowLinearising(FlowLinearisingGains(), task)
    if still:
        task = at_rest(task)
        acting = Operation(MANNERS["proportional"], task, count, skip)
    signals, run = measured_run(task, acting, Cases(seeds, leaks))
    return signals[run.failed_at < 0]


def rig_rows(number: int, task: TaskConfig, weights: str, own: bool, plants: SeedRange) -> list[dict[str, Any]]:
    """A row of results for each detector and motion on one rig."""
    heads = {ANY: LeakageHead.load(weights).moved_to(task)}
    if own and task.sensors.spool_position.fitted:
        acting = [FlowLinearising(FlowLinearisingGains(), task)]
        settings = HeadTrainingSettings(episodes=RUNS, validation_episodes=RUNS // 2)
        heads[OWN] = train_head(task, acting, settings)
    rows = []
    for still in (False, True):
        signals = [windows(task, still, share, plants, 200 * number) for share in SHARES]
        answers = {name: [head.estimate_windows(each) for each in signals] for name, head in heads.items()}
        scores = {name: [logit(found.probability) for found in each] for name, each in answers.items()}
        sheet = heads[ANY].sheet
        scores[BALANCE] = [fit_balance(repaired(each, sheet).signals, sheet).estimate[:, INTERNAL] for each in signals]
        for name, (healthy, *leaking) in scores.items():
            threshold = threshold_at_false_alarm_rate(healthy, 0.01)
            row = {"rig": number, "detector": name, "motion": "held" if still else "moving"}
            for share, each in zip(SHARES[1:], leaking, strict=True):
                row[f"found_{share:g}"] = float(np.mean(each >= threshold))
            truth = np.repeat([False, True], [len(healthy), len(leaking[1])])
            row["area_1"] = area_under_roc(np.concatenate([healthy, leaking[1]]), truth)
            if name in heads:
                calm, *_, large = answers[name]
                own_threshold = heads[name].settings.threshold
                valid = calm.outside == 0.0
                row["false_alarms"] = float(np.mean((calm.probability >= own_threshold) & valid))
                row["outside"] = float(np.mean(calm.outside))
                row["size_ratio_3"] = float(np.median(large.flow_lpm) / (0.03 * FULL_FLOW * leak_scale(task)))
            rows.append(row)
    return rows


def summary(rows: pd.DataFrame) -> Iterator[list[str]]:
    """One row per detector and motion: means over the rigs, in %; then over those that have a head of their own."""
    has_own = rows["rig"].isin(rows.loc[rows["detector"] == OWN, "rig"])
    beside = rows[has_own & (rows["detector"] == ANY)].assign(detector=f"{ANY}, the same rigs")
    rows = pd.concat([rows, beside], ignore_index=True)
    for (motion, name), own in rows.groupby(["motion", "detector"], sort=False):
        found = [f"{100.0 * own[f'found_{share:g}'].mean():.1f}" for share in SHARES[1:]]
        low = f"{100.0 * own['found_1'].quantile(0.1):.0f}"
        rest = [f"{100.0 * own[column].mean():.1f}" for column in ("false_alarms", "outside")]
        areas = f"{own['area_1'].mean():.3f} ({own['area_1'].min():.2f})"
        yield [motion, name, str(len(own)), *found, low, areas, *rest, f"{own['size_ratio_3'].median():.2f}"]


def main() -> None:
    """Judge the head on the rigs, and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", default=str(pretrained_folder() / "leakage_head_any_axis"))
    parser.add_argument("--rigs", type=int, default=30)
    parser.add_argument("--own", type=int, default=0, help="rigs for which a head is trained")
    parser.add_argument("--split", default="test", choices=("validation", "test"))
    parser.add_argument("--first", type=int, default=0, help="number of the first rig")
    parser.add_argument("--output", type=Path, default=Path("results/any_axis_head.csv"))
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    tasks = rig_tasks(
        task_config(law={"split": given.split, "count": given.rigs, "first": given.first, "preview_paces": []})
    )
    plants = DETECTION if given.split == "test" else THRESHOLDS
    rows = kept_rows(
        given.output,
        "rig",
        range(len(tasks)),
        lambda number: rig_rows(number, tasks[number], given.weights, number < given.own, plants),
        given.jobs,
    )
    found = [f"{share:g} % found" for share in SHARES[1:]]
    header = ("motion", "detector", "rigs", *found, "1 %: worst tenth", "area, 1 % (least)")
    print(markdown((*header, "false alarms", "outside", "size of 3 %"), list(summary(rows))))


if __name__ == "__main__":
    main()
