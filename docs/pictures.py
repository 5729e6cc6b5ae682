"""Makes the pictures of the README from the tables of a study.

Run: python docs/pictures.py results/study
"""

import sys
from pathlib import Path

import gymnasium as gym
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

import hydro_env  # noqa: F401  (registers the environment)
from agents.controllers import PID, ObservationLayout, PIDGains
from agents.running.folders import config_folder
from hydro_env import TaskConfig

FOLDER = Path(__file__).parent / "images"
COLOURS = {"PID": "#0072b2", "PPO": "#d55e00"}


def results(tables: Path) -> None:
    """Tracking error against the leak, and the share of leaks that is flagged."""
    levels = pd.read_csv(tables / "levels.csv")
    rates = pd.read_csv(tables / "detection_rates.csv")
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, colour in COLOURS.items():
        rows = levels[(levels["metric"] == "mean_error_mm") & (levels["controller"] == name)]
        leak = rows["leakage_flow_lpm"]
        left.plot(leak, rows["mean"], "o-", color=colour, label=name)
        left.fill_between(leak, rows["low"], rows["high"], color=colour, alpha=0.15, linewidth=0)
        flagged = rates[(rates["controller"] == name) & (rates["group"] == "range")]
        flagged = flagged[~flagged["value"].str.startswith("≥")]
        spread = [100 * (flagged["flagged_share"] - flagged["low"]), 100 * (flagged["high"] - flagged["flagged_share"])]
        places = [index + (0.12 if name == "PPO" else -0.12) for index in range(len(flagged))]
        right.errorbar(
            places, 100 * flagged["flagged_share"], spread, fmt="o", color=colour, capsize=3, label=f"under {name}"
        )
    left.set(xscale="log", xlabel="leakage, l/min at 100 bar", ylabel="mean tracking error, mm")
    left.set_ylim(bottom=0)
    left.set_xticks(list(leak), [f"{value:g}" for value in leak])
    left.minorticks_off()
    left.set_title("Positioning", fontsize=11)
    right.set_xticks(range(len(flagged)), flagged["value"])
    right.set(xlabel="leakage, l/min at 100 bar", ylabel="flagged within 2 s, %", ylim=(0, 104))
    right.set_title("Leaks flagged at 1 % false alarms", fontsize=11)
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend(frameon=False, loc="lower right")
    figure.savefig(FOLDER / "results.png", dpi=110)


def axis() -> None:
    """The drawing of the axis in the middle of a move with a leak."""
    env = gym.make("ServoHydraulic-v0", render_mode="rgb_array")
    pid = PID(PIDGains.from_yaml(config_folder() / "agents" / "pid.yaml"), ObservationLayout.of(TaskConfig()))
    observation, _ = env.reset(seed=3, options={"leakage_flow_lpm": 1.0, "reference": "point_to_point"})
    memory = None
    for _ in range(230):
        action, memory = pid.predict(observation, memory)
        observation, *_ = env.step(action)
    Image.fromarray(env.render()).quantize(64).save(FOLDER / "axis.png", optimize=True)
    env.close()


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    axis()
    results(Path(sys.argv[1]) / "tables")
