"""What the leakage head's network adds to its features, and what it answers where supply, return line or sensors move.

Run: python benchmarks/leakage_head.py CHECKPOINT [--head WEIGHTS] [--windows 200] [--test 3000]

``CHECKPOINT`` is the ``head_checkpoint.safetensors`` that ``hydro train head`` leaves; it holds the windows of the
training. On them a logistic regression and gradient-boosted trees (scikit-learn) learn the same question from the same
features. The thresholds of all give 1 % false alarms on validation axes without faults, at rest and in motion apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import roc_auc_score

from hydro_agents.detection.dataset import Plan, Windows
from hydro_agents.detection.detector import MeasuredColumns, logit, threshold_at_false_alarm_rate
from hydro_agents.detection.disturbances import PRESSURE_A, SUPPLY, TANK, Disturbances, Disturbed
from hydro_agents.detection.features import FEATURES, SPREAD, STILL
from hydro_agents.detection.head import OUTSIDE, LeakageHead, standardised
from hydro_agents.detection.head_training import FALSE_ALARM_RATE, KIND
from hydro_agents.detection.training_settings import HeadTrainingSettings
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import DETECTION
from hydro_agents.running.text import markdown
from hydro_agents.running.weights import load_checkpoint
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.types import Floats

Scores = Callable[[NDArray[np.float32]], Floats]

CONTROLLERS = ("pid", "flow_linearising", "ppo")
SIZES = (0.03, 0.1, 0.3, 5.0)  # l/min at 100 bar; between each two of them a column
BEGIN, LENGTH = 1.5, 2.0  # s, of the windows with a disturbance
OUTSIDE_RATE = 0.02  # of undisturbed windows, for the comparison

DISTURBANCES: dict[str, tuple[int, Callable[[Floats, Floats], Floats]]] = {
    "none": (SUPPLY, lambda time, phase: np.zeros(np.broadcast_shapes(time.shape, phase.shape))),
    "supply ± 2 % at 0.5 Hz": (SUPPLY, lambda time, phase: 0.02 * np.sin(np.pi * (time - phase))),
    "supply ± 5 % at 0.5 Hz": (SUPPLY, lambda time, phase: 0.05 * np.sin(np.pi * (time - phase))),
    "supply sags by 20 % in 4 s": (SUPPLY, lambda time, phase: -0.2 * np.clip(time / 4.0, 0.0, 1.0) + 0.0 * phase),
    "supply drops by 10 % at 2.5 s": (SUPPLY, lambda time, phase: -0.1 * (time > 2.5) + 0.0 * phase),
    "pump ripple ± 2 % at 43 Hz": (SUPPLY, lambda time, phase: 0.02 * np.sin(86.0 * np.pi * (time - phase))),
    "tank ± 2 bar at 1 Hz": (TANK, lambda time, phase: 2e5 * np.sin(2.0 * np.pi * (time - phase))),
    "pressure a drifts by 5 bar in 4 s": (
        PRESSURE_A,
        lambda time, phase: 5e5 * np.clip(time / 4.0, 0.0, 1.0) + 0.0 * phase,
    ),
    "LuGre friction": (SUPPLY, lambda time, phase: np.zeros(np.broadcast_shapes(time.shape, phase.shape))),
}
"""The moving row and its course over time (T,) s with a phase (N, 1) s, by name."""


def disturbed_windows(config: TaskConfig, name: str, leak: float, axes: int, direct: bool) -> Floats:
    """Signals (N, 5, T), SI, of axes under PID; a supply moves at the valve if ``direct``, else at its setting."""
    task = task_config(config, episode_duration=BEGIN + LENGTH + config.control_period)
    if name == "LuGre friction":
        plant = task.plant.model_dump()
        task = task_config(task, plant=plant | {"friction": plant["friction"] | {"model": "lugre"}})
    row, shape = DISTURBANCES[name]
    course = np.zeros((axes, 4, task.steps))
    phases = np.random.default_rng(DETECTION.first).uniform(0.0, 2.0, (axes, 1))
    course[:, row] = shape(task.control_period * np.arange(task.steps, dtype=np.float64), phases)
    disturbances = Disturbances(course, np.full(axes, direct))
    measured, seeds = MeasuredColumns.of(task), np.array(DETECTION.take(axes, 160_000))
    controller = Disturbed(shipped("pid", task), disturbances)
    run = run_cases(task, controller, Cases(seeds, np.full(axes, leak)), measured.columns, states=False)
    assert run.signals is not None
    signals = measured.si(run.signals)
    disturbances.read(signals)
    begin, length = (round(time / task.control_period) for time in (BEGIN, LENGTH))
    return signals[run.failed_at < 0, :, begin : begin + length]


def disturbance_rows(head: LeakageHead, axes: int) -> list[list[str]]:
    """By disturbance, in %: false alarms, marked "outside", and the same with 0.3 l/min: found, marked "outside"."""
    rows = []
    for name, (row, _) in DISTURBANCES.items():
        for direct in (False, True) if row == SUPPLY and name not in ("none", "LuGre friction") else (False,):
            cells = [name + (", at the valve" if direct else "")]
            for leak in (0.01, 0.3):
                found = head.estimate_windows(disturbed_windows(head.settings.task, name, leak, axes, direct))
                flagged = (found.probability >= head.settings.threshold) & (found.outside == 0.0)
                cells += [f"{100.0 * flagged.mean():.1f}", f"{100.0 * found.outside.mean():.1f}"]
            rows.append(cells)
    return rows


def learned(head: LeakageHead, training: Windows) -> dict[str, tuple[Scores, Scores | None]]:
    """By name: the score of a leak, and that of a disturbed window."""
    t = head.tensors

    def inputs(features: NDArray[np.float32]) -> NDArray[np.float32]:
        return standardised(features, t["mean"], t["scale"])

    def balance(features: NDArray[np.float32]) -> Floats:
        return np.asarray(features[:, FEATURES.index("internal leak over deviation")], dtype=np.float64)

    def network(features: NDArray[np.float32]) -> Floats:
        return head.outputs(inputs(features))[:, 0]

    def doubt(features: NDArray[np.float32]) -> Floats:
        return head.outputs(inputs(features))[:, OUTSIDE]

    known: dict[str, tuple[Scores, Scores | None]] = {"flow balance alone: leak over its deviation": (balance, None)}
    makes: dict[str, Callable[[], Any]] = {
        "logistic regression": partial(LogisticRegression, max_iter=2000),
        "gradient-boosted trees": partial(HistGradientBoostingClassifier, max_iter=500),
    }

    def scored(make: Callable[[], Any], wanted: NDArray[np.bool_]) -> Scores:
        model = make().fit(inputs(training.features), wanted)
        return lambda features: logit(model.predict_proba(inputs(features))[:, 1])

    for name, make in makes.items():
        known[name] = scored(make, training.labels[:, 0] > 0.0), scored(make, training.disturbance >= 1.0)
    return known | {"network": (network, doubt)}


def baseline_row(name: str, scores: tuple[Scores, Scores | None], validation: Windows, test: Windows) -> list[str]:
    """In %: false alarms, also with other faults; found by size, in motion and at rest; disturbances marked."""

    def clean(windows: Windows) -> NDArray[np.bool_]:
        return np.asarray((windows.disturbance == 0.0) & (windows.fault < 0) & (windows.noise == 1.0))

    score, still = scores[0](test.features), test.features[:, SPREAD] < STILL
    of_validation, at_rest = scores[0](validation.features), validation.features[:, SPREAD] < STILL
    healthy = clean(validation) & (validation.labels[:, 0] == 0.0)
    limits = [
        threshold_at_false_alarm_rate(of_validation[healthy & here], FALSE_ALARM_RATE) for here in (~at_rest, at_rest)
    ]
    flagged, leaking = score >= np.where(still, limits[1], limits[0]), test.labels[:, 0] == 1.0
    plain = test.disturbance == 0.0

    def share(chosen: NDArray[np.bool_]) -> str:
        return f"{100.0 * flagged[chosen].mean():.1f}"

    cells = [name, share(clean(test) & ~leaking), share(plain & (test.fault >= 0) & ~leaking)]
    for here in (~still, still):
        for low, high in pairwise(SIZES):
            cells.append(share(plain & here & leaking & (test.size > low) & (test.size <= high)))
    cells.append(f"{roc_auc_score(leaking[plain], score[plain]):.4f}")
    if scores[1] is None:
        return [*cells, "–"]
    limit = np.quantile(scores[1](validation.features[validation.disturbance == 0.0]), 1.0 - OUTSIDE_RATE)
    return [*cells, f"{100.0 * np.mean(scores[1](test.features[test.disturbance >= 1.0]) > limit):.1f}"]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--head", type=Path, default=pretrained_folder() / "leakage_head")
    parser.add_argument("--windows", type=int, default=200, help="axes per disturbance and leak")
    parser.add_argument("--test", type=int, default=3000, help="runs of the comparison")
    arguments = parser.parse_args()
    head = LeakageHead.load(arguments.head)
    head_line = ("disturbance", "false alarms", "outside", "0.3 l/min found", "outside")
    print(markdown(head_line, disturbance_rows(head, arguments.windows)), flush=True)
    tensors, _ = load_checkpoint(arguments.checkpoint, KIND)
    training, validation = (
        Windows(*(tensors[f"{phase}.{name}"] for name in Windows._fields)) for phase in ("data", "validation")
    )
    settings = HeadTrainingSettings(**head.settings.training["settings"])
    config = head.settings.task
    plan = Plan(config, [shipped(kind, config) for kind in CONTROLLERS], settings)
    test = Windows.joined(list(plan.windows(arguments.test, DETECTION.take(arguments.test, 170_000)[0])))
    columns = [f"{low:g}–{high:g}" for low, high in pairwise(SIZES)]
    motion, rest = ([f"{where} {column}" for column in columns] for where in ("moving", "at rest"))
    names = ("", "false alarms", "with other faults", *motion, *rest, "AUC", "disturbed, marked")
    table = [baseline_row(name, scores, validation, test) for name, scores in learned(head, training).items()]
    print(f"\n{len(training.features)} training and {len(test.features)} test windows, {len(FEATURES)} features\n")
    print(markdown(names, table))


if __name__ == "__main__":
    main()
