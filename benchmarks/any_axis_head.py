"""How well leakage heads for any axis read rigs that they never saw, axes at rest, and recordings of others.

    python benchmarks/any_axis_head.py [rigs] [--weights HEAD ...] [--rigs 30] [--structure] [--own 0] [--split test]
    python benchmarks/any_axis_head.py rest [--weights HEAD ...] [--rigs 8]
    python benchmarks/any_axis_head.py recordings --rig FILE --task FILE RECORDING ...

* ``rigs``: windows of 2 s under untuned flow linearisation, beside the flow balance alone. A leak of 1 % is 1 % of the
  flow at full opening, at 100 bar. "Found" is the share found with a threshold that gives 1 % false alarms on healthy
  axes of that rig. ``--own`` trains heads on the first rigs, minutes per rig. The file of rows is the checkpoint.
* ``rest``: axes that a P controller holds, with a sound seal and with a leak of 0.3 l/min (on another rig than the
  paper's, as much of its valve's flow): shares of the windows in which the head in use sees a leak, or cannot tell.
* ``recordings``: windows of 2 s, a tenth of them apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.lib.stride_tricks import sliding_window_view
from sklearn.metrics import roc_auc_score

from benchmarks.kept_rows import kept_rows
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.detection.balance import INTERNAL, fit_balance
from hydro_agents.detection.damaged_signals import repaired
from hydro_agents.detection.detector import Windows, logit, measured_run, threshold_at_false_alarm_rate
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.head_training import train_head
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.detection.operations import MANNERS, Operation, at_rest
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
from hydro_rig.recordings.quality import check_recording
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import bridged, on_grid

BALANCE, OWN = "its flow balance alone", "head of the rig's own"
FULL_FLOW = 11.298  # l/min, of the paper's rig at full opening
HEALTHY = 0.1  # % of the flow at full opening
SHARES = (HEALTHY, 0.5, 1.0, 3.0)
WINDOWS = 300  # of each leak; of healthy axes three times as many
RUNS = 4000  # for a head of the rig's own


STRUCTURE = {"tip_share": 0.3, "wave_share": 0.3, "sharp_share": 0.4}  # of the rigs with structure
AT_REST = {
    "sound valve": {},
    "null −1 %": {"valve_null_shift": -0.01},
    "null +1 %": {"valve_null_shift": 0.01},
    "underlap + 0.025": {"valve_underlap": 0.025},
}
RESTING = (0.01, 0.3)  # leaks in the rig's unit, of axes at rest
APART = 10  # windows of a recording begin one part of so many apart


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


def read(detector: HeadDetector, windows: Windows, task: TaskConfig) -> tuple[Any, Any, Floats]:
    """In which windows a head sees a leak, and in which it answers, and the sizes, each (N,)."""
    assert detector.threshold is not None
    reading = detector.read(windows, task)
    return reading.answers & (reading.score >= detector.threshold), reading.answers, reading.flow_lpm


def at_rest_rows(task: TaskConfig, detector: HeadDetector, skip: int) -> Iterator[dict[str, Any]]:
    """Shares of the windows of held axes in which the head sees a leak, and in which it cannot tell."""
    twice = task_config(at_rest(task), episode_duration=2.0 * task.episode_duration)
    seeds = np.array(DETECTION.take(WINDOWS, skip))
    for valve, sizes in AT_REST.items():
        faults = {name: np.full(WINDOWS, size) for name, size in sizes.items()}
        for leak in RESTING:
            acting = Operation(MANNERS["proportional"], twice, WINDOWS, skip)
            cases = Cases(seeds, np.full(WINDOWS, leak * leak_scale(task)), faults=faults)
            signals, run = measured_run(twice, acting, cases)
            seen, answers, _ = read(detector, Windows.of(signals[run.failed_at < 0, :, -task.steps :]), task)
            yield {"valve": valve, "leak": leak, "leak seen": seen.mean(), "cannot tell": 1.0 - answers.mean()}


def recording_row(file: Path, task: TaskConfig, detector: HeadDetector) -> dict[str, Any]:
    """What the head reads in a recording."""
    samples, _ = bridged(check_recording(read_recording(file), task).samples)
    head = detector.on(on_grid(task, samples.period))
    signals = sliding_window_view(samples.signals, head.settings.window, axis=1)
    windows = Windows.of(signals[:, :: head.settings.window // APART].transpose(1, 0, 2))
    seen, answers, sizes = read(detector, windows, head.settings.task)
    row = {"recording": file.name, "windows": len(windows), "leak seen": int(seen.sum())}
    return row | {"cannot tell": int((~answers).sum()), "median size": np.median(sizes)}


def judge_rigs(given: argparse.Namespace) -> None:
    """Judge the heads on drawn rigs."""
    law = {"split": given.split, "count": given.rigs, "first": given.first, "preview_paces": []}
    tasks = rig_tasks(task_config(law=law | ({"structure": STRUCTURE} if given.structure else {})))
    plants = DETECTION if given.split == "test" else THRESHOLDS
    rows = kept_rows(
        given.output,
        "rig",
        range(len(tasks)),
        lambda number: rig_rows(number, tasks[number], given.weights, number < given.own, plants),
        given.jobs,
    )
    found = [f"{share:g} % found" for share in SHARES[1:]]
    header = ("detector", "rigs", *found, "1 %: worst tenth", "area, 1 % (least)", "false alarms", "outside")
    print(markdown((*header, "size of 3 %"), list(summary(rows))))


def judge_rest(given: argparse.Namespace) -> None:
    """Judge the heads at rest: the one in use on the paper's rig, and each on drawn rigs."""
    drawn = rig_tasks(task_config(law={"split": given.split, "count": given.rigs, "preview_paces": []}))
    rows = [{"head": "in use", **row} for row in at_rest_rows(TaskConfig(), HeadDetector.load(), 0)]
    for name in given.weights:
        for number, task in enumerate(drawn):
            rows += [{"head": name, **row} for row in at_rest_rows(task, HeadDetector.load(name), 300 * number)]
    table = (100.0 * pd.DataFrame(rows).groupby(["head", "valve", "leak"], sort=False).mean()).round(1).reset_index()
    print(markdown(tuple(table), table.astype(str).to_numpy().tolist()))


def judge_recordings(given: argparse.Namespace) -> None:
    """Judge the heads on recordings of one rig."""
    task = task_config(given.task, rig=given.rig)
    rows = []
    for name in given.weights:
        detector = HeadDetector.load(name)
        rows += [{"head": name, **recording_row(file, task, detector)} for file in given.recordings]
    print(markdown(tuple(rows[0]), pd.DataFrame(rows).round(3).astype(str).to_numpy().tolist()))


JUDGES = {"rigs": judge_rigs, "rest": judge_rest, "recordings": judge_recordings}


def main() -> None:
    """Judge heads, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=JUDGES, default="rigs")
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--weights", nargs="+", default=[str(pretrained_folder() / "leakage_head_any_axis")])
    parser.add_argument("--rigs", type=int, default=30)
    parser.add_argument("--structure", action="store_true", help="rigs with structure that no nameplate tells")
    parser.add_argument("--own", type=int, default=0, help="rigs for which a head is trained")
    parser.add_argument("--split", default="test", choices=("validation", "test"))
    parser.add_argument("--first", type=int, default=0, help="number of the first rig")
    parser.add_argument("--rig", help="of recordings")
    parser.add_argument("--task", help="of recordings")
    parser.add_argument("--output", type=Path, default=Path("results/any_axis_head.csv"))
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    JUDGES[given.what](given)


if __name__ == "__main__":
    main()
