"""How well leakage heads for any axis read rigs that they never saw, beside the flow balance alone.

    python benchmarks/any_axis_head.py [--weights HEAD ...] [--rigs 30] [--structure] [--own 0] [--split test]

They read windows of 2 s under untuned flow linearisation. A leak of 1 % is 1 % of the flow at full opening, at 100 bar.
"Found" is the share found with a threshold that gives 1 % false alarms on healthy axes of that rig. ``--own`` trains
heads on the first rigs, minutes per rig. The file of rows is the checkpoint.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.metrics import roc_auc_score

from benchmarks import command_line, kept_rows
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.detection.balance import INTERNAL, fit_balance
from hydro_agents.detection.damaged_signals import repaired
from hydro_agents.detection.detector import logit, measured_run, threshold_at_false_alarm_rate
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.head_training import train_head
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.detection.training_settings import HeadTrainingSettings
from hydro_agents.running.cases import Cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import DETECTION, THRESHOLDS, SeedRange
from hydro_agents.running.text import markdown
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.types import Floats

BALANCE, OWN = "its flow balance alone", "head of the rig's own"
FULL_FLOW = 11.298  # l/min, of the paper's rig at full opening
HEALTHY = 0.1  # % of the flow at full opening
SHARES = (HEALTHY, 0.5, 1.0, 3.0)
WINDOWS = 300  # of each leak; of healthy axes three times as many
RUNS = 4000  # for a head of the rig's own
STRUCTURE = {"tip_share": 0.3, "wave_share": 0.3, "sharp_share": 0.4}  # of the rigs with structure


def leaking(task: TaskConfig, share: float, plants: SeedRange, skip: int) -> Floats:
    """Signals (N, 5, T), SI, of moving axes with a leak of a share (%) of the flow at full opening."""
    count = WINDOWS if share > HEALTHY else 3 * WINDOWS
    leaks = np.full(count, 0.01 * share * FULL_FLOW * leak_scale(task))
    acting = FlowLinearising(FlowLinearisingGains(), task)
    signals, run = measured_run(task, acting, Cases(np.array(plants.take(count, skip)), leaks))
    return signals[run.failed_at < 0]


def rig_rows(number: int, task: TaskConfig, weights: list[str], own: bool, plants: SeedRange) -> list[dict[str, Any]]:
    """A row of results for each detector on one rig."""
    heads = {name: LeakageHead.load(name).moved_to(task) for name in weights}
    sheet = next(iter(heads.values())).sheet
    if own and task.sensors.spool_position.fitted:
        acting = [FlowLinearising(FlowLinearisingGains(), task)]
        heads[OWN] = train_head(task, acting, HeadTrainingSettings(episodes=RUNS, validation_episodes=RUNS // 2))
    signals = [leaking(task, share, plants, 200 * number) for share in SHARES]
    answers = {name: [head.estimate_windows(each) for each in signals] for name, head in heads.items()}
    scores = {name: [logit(found.probability) for found in each] for name, each in answers.items()}
    scores[BALANCE] = [fit_balance(repaired(each, sheet).signals, sheet).estimate[:, INTERNAL] for each in signals]
    rows = []
    for name, (healthy, *others) in scores.items():
        threshold = threshold_at_false_alarm_rate(healthy, 0.01)
        row = {"rig": number, "detector": name}
        for share, each in zip(SHARES[1:], others, strict=True):
            row[f"found_{share:g}"] = float(np.mean(each >= threshold))
        truth = np.repeat([False, True], [len(healthy), len(others[1])])
        row["area_1"] = roc_auc_score(truth, np.concatenate([healthy, others[1]]))
        if name in heads:
            calm, *_, large = answers[name]
            seen = calm.probability >= heads[name].settings.threshold
            row["false_alarms"] = float(np.mean(seen & (calm.outside == 0.0)))
            row["outside"] = float(np.mean(calm.outside > 0.0))
            row["size_ratio_3"] = float(np.median(large.flow_lpm) / (0.03 * FULL_FLOW * leak_scale(task)))
        rows.append(row)
    return rows


def summary(rows: pd.DataFrame) -> Iterator[list[str]]:
    """One row per detector: means over the rigs, in %; then of the heads on those rigs that have one of their own."""
    has_own = rows["rig"].isin(rows.loc[rows["detector"] == OWN, "rig"])
    beside = rows[has_own & ~rows["detector"].isin([OWN, BALANCE])]
    beside = beside.assign(detector=beside["detector"] + ", the same rigs")
    for name, own in pd.concat([rows, beside], ignore_index=True).groupby("detector", sort=False):
        found = [f"{100.0 * own[f'found_{share:g}'].mean():.1f}" for share in SHARES[1:]]
        low = f"{100.0 * own['found_1'].quantile(0.1):.0f}"
        rest = [f"{100.0 * own[column].mean():.1f}" for column in ("false_alarms", "outside")]
        areas = f"{own['area_1'].mean():.3f} ({own['area_1'].min():.2f})"
        yield [str(name), str(len(own)), *found, low, areas, *rest, f"{own['size_ratio_3'].median():.2f}"]


def main() -> None:
    """Judge heads on drawn rigs, and print a table."""
    weights, output = [str(pretrained_folder() / "leakage_head_any_axis")], Path("results/any_axis_head.csv")
    options = {"rigs": 30, "structure": False, "own": 0, "split": ("test", "validation"), "first": 0}
    given = command_line(__doc__, weights=weights, **options, output=output, jobs=2)
    law = {"split": given.split, "count": given.rigs, "first": given.first, "preview_paces": []}
    tasks = rig_tasks(task_config(law=law | ({"structure": STRUCTURE} if given.structure else {})))
    plants = DETECTION if given.split == "test" else THRESHOLDS

    def rows_of(number: int) -> list[dict[str, Any]]:
        return rig_rows(number, tasks[number], given.weights, number < given.own, plants)

    rows = kept_rows(given.output, "rig", range(len(tasks)), rows_of, given.jobs)
    found = [f"{share:g} % found" for share in SHARES[1:]]
    header = ("detector", "rigs", *found, "1 %: worst tenth", "area, 1 % (least)", "false alarms", "outside")
    print(markdown((*header, "size of 3 %"), list(summary(rows))))


if __name__ == "__main__":
    main()
