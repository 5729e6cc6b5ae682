"""What the leakage head answers where supply, return line or sensors move.

Run: python benchmarks/leakage_head.py [--head WEIGHTS] [--windows 200]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hydro_agents.detection.detector import MeasuredColumns
from hydro_agents.detection.disturbances import PRESSURE_A, SUPPLY, TANK, Disturbances, Disturbed
from hydro_agents.detection.head import LeakageHead
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import DETECTION
from hydro_agents.running.text import markdown
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.types import Floats

BEGIN, LENGTH = 1.5, 2.0  # s, of the windows

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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--head", type=Path, default=pretrained_folder() / "leakage_head")
    parser.add_argument("--windows", type=int, default=200, help="axes per disturbance and leak")
    given = parser.parse_args()
    header = ("disturbance", "false alarms", "outside", "0.3 l/min found", "outside")
    print(markdown(header, disturbance_rows(LeakageHead.load(given.head), given.windows)))


if __name__ == "__main__":
    main()
