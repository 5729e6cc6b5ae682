"""Makes the pictures of the README from the tables of a study.

Run: python docs/pictures.py results/study
"""

import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

import hydro_env  # noqa: F401  (registers the environment)
from agents.controllers import PID, PIDGains
from agents.report.canvas import WIDE, bars, dodge, level_axis, looks_of, render
from agents.running.folders import config_folder
from hydro_env import TaskConfig

FOLDER = Path(__file__).parent / "images"


def results(tables: Path) -> None:
    """Ratio of the tracking errors over the leak, and the share of leaks that is flagged.

    The ratio is paired by plant: its interval shows what overlapping intervals of two means hide.
    """
    ratios = pd.read_csv(tables / "ratios.csv", dtype={"value": str})
    rates = pd.read_csv(tables / "detection_rates.csv")
    base, names = ratios["against"].iloc[0], list(rates["controller"].unique())
    looks = looks_of(names)

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        left.axhline(1.0, color=looks[base].colour, label=base)
        for index, name in enumerate(names[1:]):
            rows = ratios[(ratios["controller"] == name) & (ratios["group"] == "level")]
            places = level_axis(left, [float(value) for value in rows["value"]])
            at = np.array(list(places.values())) + dodge(len(names) - 1, index, 0.05)
            bars(left, at, rows, "ratio", looks[name], name)
        left.set(title="Positioning", ylabel=f"mean error over that of the {base}", ylim=(0.0, 1.15))
        for index, name in enumerate(names):
            own = rates[(rates["controller"] == name) & (rates["group"] == "range")]
            own = own[~own["value"].str.startswith("≥")]
            percent = own.assign(**{column: 100.0 * own[column] for column in ("flagged_share", "low", "high")})
            places = np.arange(len(own)) + dodge(len(names), index, 0.24)
            bars(right, places, percent, "flagged_share", looks[name], f"under {name}", "points")
        right.set_xticks(range(len(own)), own["value"])
        right.set(title="Leaks flagged within 2 s", xlabel="leak, l/min at 100 bar", ylabel="%", ylim=(0, 104))
        left.legend(loc="lower right")
        right.legend(loc="lower right")

    (FOLDER / "results.png").write_bytes(render(paint, (WIDE, 3.4), "png")[0])


def axis() -> None:
    """The drawing of the axis in the middle of a move with a leak."""
    env = gym.make("ServoHydraulic-v0", render_mode="rgb_array")
    pid = PID(PIDGains.from_yaml(config_folder() / "agents" / "pid.yaml"), TaskConfig())
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
