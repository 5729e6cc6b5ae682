"""Figures of a leakage head on test plants: detection, false alarms, size and intervals by operation and by fault.

    python benchmarks/leakage_head.py [--head agents/hydro_agents/pretrained/leakage_head] [--plants N] [--output F]

Every row is one way of operating the axis, with a fault or none. Each plant runs with a leak of 0.01 (healthy), 0.1,
0.2, 0.3 and 1 l/min; the head reads 2 s (row "first": from the start of a run, else from anywhere in it). "unseen":
no training window was made under that controller.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers import ObservationLayout
from hydro_agents.controllers.registry import make_controller
from hydro_agents.detection.detector import threshold_at_false_alarm_rate
from hydro_agents.detection.features import SIGNALS
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import load_head
from hydro_agents.detection.operations import MANNERS, Operation, loaded, slow, still
from hydro_agents.learning.opponents import opponent
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import DETECTION, EVALUATION
from hydro_agents.study.other_rig import default_study
from hydro_env import TaskConfig
from hydro_env.files import read_yaml
from hydro_env.folders import config_file
from hydro_env.task.configuration import task_config

LEVELS = (0.01, 0.1, 0.2, 0.3, 1.0)
"""l/min at 100 bar; the first one is healthy."""

RUN = 10.0
"""s; duration of a run."""


class SlidingMode:
    """Command of a saturated sliding variable: error plus speed."""

    def __init__(self, config: TaskConfig) -> None:
        self.layout = ObservationLayout.of(config)

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[NDArray[np.float32], Any]:
        """Commands (N, 1)."""
        error, speed = (self.layout.si(observation, name) for name in ("tracking_error", "velocity_estimate"))
        return 0.35 * np.clip((60.0 * error - 1.5 * speed) / 0.25, -1.0, 1.0).astype(np.float32)[:, None], 0


class Swing:
    """A sine in open loop, of another frequency and size for each axis, and a weak pull to the reference."""

    def __init__(self, config: TaskConfig) -> None:
        self.layout, self.period = ObservationLayout.of(config), config.control_period

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[NDArray[np.float32], Any]:
        """Commands (N, 1)."""
        if state is None:
            generator, count = np.random.default_rng(5), len(observation)
            frequency, size = 10 ** generator.uniform(-0.3, 0.9, count), 10 ** generator.uniform(-1.5, -0.3, count)
            state = (0, self.layout.si(observation, "previous_command"), frequency, size)
        step, holding, frequency, size = state
        wave = size * np.sin(2.0 * np.pi * frequency * step * self.period)
        command = holding + self.layout.si(observation, "tracking_error") + wave
        return np.clip(command, -1.0, 1.0).astype(np.float32)[:, None], (step + 1, *state[1:])


class Row(NamedTuple):
    """One row: its name, the task, who operates the axes, and a fault."""

    name: str
    task: Callable[[TaskConfig], TaskConfig]
    who: str
    faults: dict[str, float]
    first: bool = False  # windows at the start of runs


def plain(config: TaskConfig) -> TaskConfig:
    """The task as it is."""
    return config


ROWS = (
    Row("PID, first 2 s", plain, "pid", {}, first=True),
    *(Row(f"{who}, running", plain, who, {}) for who in ("pid", "ppo", "proportional", "by hand", "open loop")),
    *(Row(f"{who}, standing still", still, who, {}) for who in ("pid", "proportional")),
    Row("pid, slow references", slow, "pid", {}),
    Row("chattering", plain, "chattering", {}),
    Row("pid, changing loads", loaded, "pid", {}),
    *(Row(f"unseen: {who}", plain, who, {}) for who in ("adrc", "lqg", "sliding mode", "sine in open loop")),
    Row("unseen: adrc, standing still", still, "adrc", {}),
    Row("pid, null shift +1 %", plain, "pid", {"valve_null_shift": 0.01}),
    Row("pid, null shift -1 %", plain, "pid", {"valve_null_shift": -0.01}),
    Row("pid, underlap + 0.025", plain, "pid", {"valve_underlap": 0.025}),
    Row("pid, rated flow × 0.7", plain, "pid", {"valve_flow": -0.3}),
    Row("pid, hysteresis 2 %", plain, "pid", {"valve_hysteresis": 0.02}),
    Row("pid, spool offset -1 %", plain, "pid", {"spool_position_offset": -0.005}),  # of a range of ±1
    Row("pid, spool gain + 3 %", plain, "pid", {"spool_position_gain": 0.03}),
    Row("pid, pressure b offset 1 %", plain, "pid", {"pressure_b_offset": 0.01}),
    Row("pid, pressure a drop-out 5 %", plain, "pid", {"pressure_a_dropout": 0.05}),
    Row("pid, pressure a frozen", plain, "pid", {"pressure_a_freeze": 1.0}),
    Row("pid, tank pressure + 5 bar", plain, "pid", {"tank_pressure": 5e5}),
    Row("pid, external leak 1 l/min", plain, "pid", {"external_leak": 1.0}),
    Row("pid standing still, null shift 1 %", still, "pid", {"valve_null_shift": 0.01}),
    Row("pid standing still, underlap + 0.025", still, "pid", {"valve_underlap": 0.025}),
)


def operator(who: str, config: TaskConfig, count: int) -> Any:
    """Controller or operation by its name."""
    if who in MANNERS:
        return Operation(MANNERS[who], config, count, EVALUATION.first)
    if who in ("adrc", "lqg"):
        return make_controller(who, config, read_yaml(config_file("agents", who)))
    own = {"sliding mode": SlidingMode, "sine in open loop": Swing}
    return own[who](config) if who in own else opponent(who, config, who)


def measured(row: Row, head: LeakageHead, config: TaskConfig, plants: int) -> dict[str, Any]:
    """One row of the table."""
    task = row.task(task_config(config, episode_duration=RUN))
    flow = np.tile(LEVELS, plants)
    seeds = np.repeat(DETECTION.take(plants, 100_000), len(LEVELS))
    faults = {name: np.full(len(flow), size) for name, size in row.faults.items()}
    layout = ObservationLayout.of(task)
    columns = [layout.index(name) for name in SIGNALS]
    run = run_cases(task, operator(row.who, task, len(flow)), Cases(seeds, flow, faults=faults), columns, states=False)
    assert run.signals is not None
    window = head.settings.window
    length = np.where(run.failed_at < 0, task.steps, run.failed_at + 1)
    whole = np.flatnonzero(length >= window)
    places = np.random.default_rng(0).random(len(whole)) * (not row.first) * (length[whole] - window)
    cut = [run.signals[case, :, int(place) : int(place) + window] for case, place in zip(whole, places, strict=True)]
    found, true = head.estimate_signals(np.stack(cut)), flow[whole]
    flagged, inside = found.probability >= head.settings.threshold, found.outside == 0.0
    held = (found.low_lpm <= true) & (true <= found.high_lpm)
    leaking = true >= 0.3
    one_percent = threshold_at_false_alarm_rate(found.probability[true == LEVELS[0]], 0.01)
    shares = {
        ("false alarms" if level == LEVELS[0] else f"{level:g} l/min"): 100.0 * flagged[true == level].mean()
        for level in LEVELS
    }
    return {
        "row": row.name,
        **shares,
        "false alarms inside": 100.0 * (flagged & inside)[true == LEVELS[0]].mean(),
        "interval holds": 100.0 * held[inside].mean() if inside.any() else np.nan,
        "outside": 100.0 * (~inside).mean(),
        "log10 size": np.sqrt(np.mean(np.log10(found.flow_lpm / true)[leaking] ** 2)),
        "median log10 size": np.median(np.abs(np.log10(found.flow_lpm / true)[leaking])),
        **{
            f"{level:g} at 1 %": 100.0 * np.mean(found.probability[true == level] >= one_percent)
            for level in LEVELS[1:4]
        },
        "windows": len(whole),
    }


def update_time(head: LeakageHead, config: TaskConfig) -> tuple[float, float]:
    """Mean and largest processor time (ms) of one ``predict`` on one axis, over 1000 periods after a first window."""
    env = gym.make("ServoHydraulic-v0", config=task_config(config, episode_duration=RUN), info=False)
    observation, _ = env.reset(seed=EVALUATION.first)
    controller = opponent("pid", config, "PID")
    memory, state, times = None, None, []
    for _ in range(head.settings.window + 1000):
        action, memory = controller.predict(observation, memory)
        began = time.thread_time()
        _, state = head.predict(observation, state)
        times.append(1e3 * (time.thread_time() - began))
        observation, *_ = env.step(action)
    late = times[head.settings.window :]
    return float(np.mean(late)), float(np.max(late))


def main() -> None:
    """Print the table, and write it where it is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--head", type=Path)
    parser.add_argument("--plants", type=int, default=100)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    config = default_study().task
    head = load_head(given.head, config)
    print("one update, ms of processor time: mean {:.3f}, largest {:.3f}".format(*update_time(head, config)))
    rows = []
    for row in ROWS:
        rows.append(measured(row, head, config, given.plants))
        print(pd.DataFrame(rows[-1:]).to_string(index=False, header=len(rows) == 1, float_format="{:.3g}".format))
    if given.output is not None:
        pd.DataFrame(rows).to_csv(given.output, index=False)


if __name__ == "__main__":
    main()
