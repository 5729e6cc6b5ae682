"""PPO with a memory and nothing underneath, on the environment that draws the rig: the researcher's first attempt.

    python benchmarks/any_axis_alone.py [--steps 4000000] [--rigs 20] [--split test] [--first 300] [--sheet no]

RecurrentPPO of sb3-contrib trains on ``rig="drawn"``, 64 rigs of the training split; on rigs that it never saw its
error stands beside that of untuned flow linearisation, in the sensor's frame, as in ``any_axis.py``. The trained model
is kept in ``--output``; a later call only judges it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sb3_contrib import RecurrentPPO

from benchmarks import command_line
from benchmarks.any_axis import UNTUNED, families_and_leaks
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.running.seeds import ANY_AXIS
from hydro_agents.running.text import markdown
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.sensors import POSITION

PRACTICE: dict[str, Any] = {"reward": {"frame": "sensor", "error_limit": 100.0}}


def trained(file: Path, steps: int, sheet: bool) -> RecurrentPPO:
    """The policy in a file, or a new one that is trained and kept there."""
    if file.exists():
        return RecurrentPPO.load(file, device="cpu")
    env = AxisVecEnv(task_config(rig="drawn", law={"sheet": sheet}, **PRACTICE), 256, reward_scale=0.02)
    network = {"lstm_hidden_size": 64, "net_arch": [64], "log_std_init": -0.5}
    rate: dict[str, Any] = {"learning_rate": lambda left: 1e-3 * (0.1 + 0.9 * left), "gamma": 0.98, "n_epochs": 4}
    size: dict[str, Any] = {"n_steps": 64, "batch_size": 4096, "seed": 0, "device": "cpu", "verbose": 1}
    model = RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=network, **rate, **size)
    model.learn(steps, log_interval=20)
    file.parent.mkdir(parents=True, exist_ok=True)
    model.save(file)
    return model


def error(controller: Any, config: TaskConfig, rig: TaskConfig) -> tuple[float, int]:
    """Geometric mean over the families of the mean error in µm, and the number of failures, on one rig.

    ``config`` is the task whose observations the controller reads; a failed axis is wrong by its stroke.
    """
    families, leaks = families_and_leaks()
    count = len(families)
    env = ServoHydraulicVectorEnv(count, config, autoreset_mode="NextStep", info=False)
    options = {"reference": families.tolist(), "leakage_flow_lpm": leaks}
    observation, _ = env.reset(seed=list(ANY_AXIS.take(count)), options=options)
    bias, failed = env.axes.column("bias")[:, POSITION].copy(), np.zeros(count, dtype=bool)
    total, memory = np.zeros(count), None
    for step in range(rig.steps):
        command, memory = controller.predict(observation, memory, np.full(count, step == 0), True)
        observation, _, terminated, _, _ = env.step(command)
        failed |= terminated
        apart = np.abs(env.axes.column("position") + bias - env.axes.column("reference"))
        total += np.where(failed, rig.plant.cylinder.stroke, apart)
    means = pd.Series(1e6 * total / rig.steps).groupby(families).mean()
    return float(np.exp(np.log(means).mean())), int(failed.sum())


def main() -> None:
    """Train it if it is not there, judge it, and print the table."""
    splits = ("test", "validation", "training")
    output = Path("results/any_axis_alone/policy.zip")
    given = command_line(__doc__, steps=4_000_000, rigs=20, split=splits, first=300, sheet=("yes", "no"), output=output)
    policy = trained(given.output, given.steps, given.sheet == "yes")
    rows = []
    for number in range(given.first, given.first + given.rigs):
        law = {"split": given.split, "count": 1, "first": number}
        config = task_config(rig="drawn", law={**law, "sheet": given.sheet == "yes"})
        rig = rig_tasks(task_config(law={**law, "preview_paces": []}))[0]
        own, failures = error(policy, config, rig)
        other, _ = error(FlowLinearising(FlowLinearisingGains(), rig), rig, rig)
        rows.append((own / other, failures))
    ratio, failures = np.array(rows).T
    text = [f"{np.median(ratio):.3g}", f"{np.exp(np.log(ratio).mean()):.3g}", f"{ratio.min():.3g}–{ratio.max():.3g}"]
    header = ("rigs", f"error ÷ {UNTUNED}, median", "geometric mean", "range", "failures")
    print(markdown(header, [[str(len(ratio)), *text, f"{failures.sum():.0f}"]]))


if __name__ == "__main__":
    main()
