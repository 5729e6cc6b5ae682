"""Makes the pictures of the README and of the site.

Run: python docs/pictures.py [results/study], where the folder has the tables of a study; without one, only the drawing,
the animation and the charts of the pages' own tables are made.
"""

import hashlib
import sys
import tempfile
from io import BytesIO
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from PIL import Image

import hydro_env  # noqa: F401  (registers the environment)
from hydro_agents.learning.loading import shipped
from hydro_agents.report.kit import GREY, INK, WIDE, draw, drawn, leak_axis, panel, picture, signal
from hydro_env import TaskConfig
from hydro_env.rendering import PAPER
from hydro_env.task.configuration import task_config
from hydro_rig.export.controller_folder import exported_files
from hydro_rig.export.rehearsal import rehearse

DOCS = Path(__file__).parent
FOLDER, TABLES = DOCS / "images", DOCS / "tables"


@drawn
def results(tables: Path) -> None:
    """Ratio of the tracking errors over the leak.

    The ratio is paired by plant: its interval shows what overlapping intervals of two means hide.
    """
    ratios = pd.read_csv(tables / "comparison.csv", dtype={"value": str})
    base = ratios["against"].iloc[0]
    rows = ratios[(ratios["group"] == "level") & (ratios["against"] == base)]
    rows = rows.assign(leak=rows["value"].astype(float))
    axes = panel(height=3.4, title="Positioning", ylabel=f"mean error over that of the {base}", ylim=(0.0, 1.15))
    draw(axes, rows, "leak", "ratio", [base, *rows["controller"].unique()])
    leak_axis(axes, rows["leak"])
    axes.axhline(1.0, color=INK, label=base)
    axes.legend(loc="lower right")
    (FOLDER / "results.png").write_bytes(picture(axes, "png"))


def axis() -> None:
    """The drawing of the axis in the middle of a move with a leak."""
    env = gym.make("ServoHydraulic-v0", render_mode="rgb_array")
    pid = shipped("pid", TaskConfig())
    observation, _ = env.reset(seed=3, options={"leakage_flow_lpm": 1.0, "reference": "point_to_point"})
    memory = None
    for _ in range(230):
        action, memory = pid.predict(observation, memory)
        observation, *_ = env.step(action)
    Image.fromarray(env.render()).quantize(64).save(FOLDER / "axis.png", optimize=True)
    env.close()


@drawn
def controllers() -> None:
    """Error of each controller over that of the PID under all conditions of the robustness protocol."""
    table = pd.read_csv(TABLES / "robustness.csv", skiprows=1).assign(of="")
    axes = panel(height=2.6, xlabel="error over the PID's", xlim=(0.0, 1.1))
    draw(axes, table, "controller", "equal_weight", [""], "of")
    axes.axvline(1.0, color=GREY, linewidth=1.0)
    save("chart_controllers.svg", axes)


@drawn
def detectors() -> None:
    """Share of leaks that each detector finds at 1 % false alarms, over the leak."""
    table = pd.read_csv(TABLES / "detectors.csv", skiprows=1)
    axes = panel(ylabel="found, %", ylim=(0, 104))
    draw(axes, table, "level", "at_1_percent", list(table["detector"].unique()), "detector", 100.0)
    leak_axis(axes, table["level"])
    axes.legend(loc="lower right")
    save("chart_detectors.svg", axes)


@drawn
def performance() -> None:
    """Speed over the number of axes, from the table of the benchmark."""
    table = pd.read_csv(TABLES / "speed.csv", skiprows=1)
    values = table.drop_duplicates("row").set_index("row")["median"]
    kinds = {"axes": "this environment", "CartPole-v1": "CartPole-v1, Gymnasium's fastest"}
    counts = [64, 1024, 4096, 16384]
    axes = panel(xscale="log", yscale="log", xlabel="axes side by side", ylabel="steps per second")
    for kind, label in kinds.items():
        axes.plot(counts, [values[f"{kind}, N = {count:,}"] for count in counts], label=label)
    axes.set_xticks(counts, [f"{count:,}" for count in counts])
    axes.set_xticks([], minor=True)
    axes.set_ylim(top=5.0 * axes.get_ylim()[1])  # room for the legend above the lines
    axes.legend(loc="upper left")
    save("chart_speed.svg", axes)


CHARTS = {
    "chart_controllers.svg": "tables/robustness.csv",
    "chart_detectors.svg": "tables/detectors.csv",
    "chart_speed.svg": "tables/speed.csv",
}
"""Charts, and the file whose numbers each shows."""


def data_mark(chart: str) -> str:
    """A comment at the end of a chart that names its numbers; tests/site/test_site.py compares it with the file."""
    numbers = (DOCS / CHARTS[chart]).read_bytes()
    return f"<!-- {CHARTS[chart]} {hashlib.sha256(numbers).hexdigest()[:16]} -->\n"


def save(chart: str, axes: Axes) -> None:
    """Write a chart of one panel."""
    (FOLDER / chart).write_bytes(picture(axes, "svg") + data_mark(chart).encode())


@drawn
def rehearsal() -> None:
    """Position of an axis that exported C code moves, in four scenes of its rehearsal."""
    task = task_config(None, rig=DOCS / "hidden_rig.yaml", control_period=0.002)
    files, _ = exported_files(shipped("flow_linearising", task), task, "hydro export flow_linearising")
    with tempfile.TemporaryDirectory() as place:
        for name, content in files.items():
            (Path(place) / name).write_bytes(content)
        _, takes = rehearse(Path(place))
    axes = panel(WIDE, 2.8, xlabel="time, s", ylabel="position, mm")
    for take in takes:
        if take.scene.name in ("healthy", "broken cable", "emergency stop", "restart"):
            signal(axes, take.time, 1e3 * take.position, label=take.scene.name)
    (FOLDER / "rehearsal.svg").write_bytes(picture(axes, "svg"))


CONTROLLERS = {"left: PID, tuned": "pid", "right: flow linearisation": "flow_linearising"}
LEAK = 2.0  # l/min at 100 bar, of the animation
DRAWN = (24, 70, 460, 206)  # of a frame: the cylinder, pixels
GAP = 18  # between the two axes, pixels
EVERY = 8  # control periods of 5 ms per frame


def animation() -> None:
    """An axis with a worn seal under two controllers, in real time: frames above, errors below."""
    task = TaskConfig()
    frames, errors = {}, {}
    for name, kind in CONTROLLERS.items():
        env, controller, memory = gym.make("ServoHydraulic-v0", render_mode="rgb_array"), shipped(kind, task), None
        observation, _ = env.reset(seed=4, options={"leakage_flow_lpm": LEAK, "reference": "multi_sine"})
        frames[name], errors[name] = [], []
        for step in range(task.steps):
            action, memory = controller.predict(observation, memory)
            observation, *_, info = env.step(action)
            errors[name].append(1e3 * (info["position"] - info["reference"]))
            if step % EVERY == 0:
                frames[name].append(Image.fromarray(env.render()).crop(DRAWN))
        env.close()
    time = task.control_period * np.arange(1, task.steps + 1)
    width, height = DRAWN[2] - DRAWN[0] + GAP, DRAWN[3] - DRAWN[1]

    @drawn
    def below(steps: int) -> Image.Image:
        axes = panel(2 * width / 120, 1.7, xlim=(0, time[-1]), ylim=(-0.6, 0.6), xlabel="time, s", ylabel="error, mm")
        for name in CONTROLLERS:
            axes.plot(time[:steps], errors[name][:steps], marker="", label=name)
        axes.legend(loc="upper right")
        return Image.open(BytesIO(picture(axes, "png"))).convert("RGB")

    pages = []
    for index in range(len(next(iter(frames.values())))):
        plot = below(index * EVERY + 1)
        page = Image.new("RGB", (2 * width, height + plot.height), PAPER)
        for column, name in enumerate(CONTROLLERS):
            page.paste(frames[name][index], (column * width, 0))
        page.paste(plot, (0, height))
        pages.append(page)
    more = {"save_all": True, "append_images": pages[1:], "duration": 5 * EVERY, "loop": 0, "quality": 60, "method": 6}
    pages[0].save(FOLDER / "leak.webp", **more)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    axis()
    animation()
    controllers()
    detectors()
    performance()
    rehearsal()
    if len(sys.argv) > 1:
        results(Path(sys.argv[1]) / "tables")
