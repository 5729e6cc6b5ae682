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
from sb3_contrib import RecurrentPPO

from benchmarks import command_line
from hydro_agents.evaluation.drawn_rigs import UNTUNED, on_rig
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.running.text import markdown
from hydro_env.task.configuration import task_config

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


def main() -> None:
    """Train it if it is not there, judge it, and print the table."""
    splits = ("test", "validation", "training")
    output = Path("results/any_axis_alone/policy.zip")
    given = command_line(__doc__, steps=4_000_000, rigs=20, split=splits, first=300, sheet=("yes", "no"), output=output)
    policy = trained(given.output, given.steps, given.sheet == "yes")
    law = {"split": given.split, "count": given.rigs, "first": given.first, "sheet": given.sheet == "yes"}
    drawn, rows = task_config(rig="drawn", law=law), []
    for number in range(given.rigs):
        own, other = on_rig(policy, "", drawn, number), on_rig(None, "flow_linearising", drawn, number)
        rows.append((own["error_um"][0] / other["error_um"][0], own["failures"][0]))
    ratio, failures = np.array(rows).T
    text = [f"{np.median(ratio):.3g}", f"{np.exp(np.log(ratio).mean()):.3g}", f"{ratio.min():.3g}–{ratio.max():.3g}"]
    header = ("rigs", f"error ÷ {UNTUNED}, median", "geometric mean", "range", "failures")
    print(markdown(header, [[str(len(ratio)), *text, f"{failures.sum():.0f}"]]))


if __name__ == "__main__":
    main()
