"""The playground in a real browser: its axes move, measure and decide as those of the environment."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from browser import open_page

from hydro_agents.detection.head import LeakageEstimate, LeakageHead
from hydro_agents.learning.loading import shipped
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.plant.states import STATE_NAMES

pytest.importorskip("ziglang", reason="the extra 'playground' brings it")
sys.path.append(str(Path(__file__).parents[2] / "docs" / "playground"))
build = importlib.import_module("build_page")
CONFIG = TaskConfig()
STEPS, LEAK = 460, 0.5
SIGNALS = ("position", "pressure_a", "pressure_b", "spool_position", "supply_pressure")
START = "while (!window.playground) await new Promise((go) => setTimeout(go, 10)); const page = window.playground;"


def reference():
    """A move, a rest and a step; m."""
    time = CONFIG.control_period * np.arange(STEPS + 1 + max(CONFIG.preview_samples))
    return 0.01 + 0.01 * np.sin(4.0 * np.minimum(time, 1.2)) + 0.005 * (time > 1.7)


def in_the_environment():
    """States (STEPS, kinds, signals) and answers of the head (STEPS, kinds, 9), and the key of the noise."""
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    options = {"parameters": CONFIG.plant, "leakage_flow_lpm": LEAK, "reference": reference()}
    states, answers = (np.empty((STEPS, len(build.CHOICES), count)) for count in (len(SIGNALS), 9))
    for number, kind in enumerate(build.CHOICES):
        env = ServoHydraulicVectorEnv(1, CONFIG.model_copy(update={"episode_duration": STEPS * CONFIG.control_period}))
        observation, _ = env.reset(seed=[7], options=options)
        controller, memory, watching = shipped(kind, CONFIG), None, None
        key = int(env.axes.record["noise_key"][0])
        for step in range(STEPS):
            answer, watching = head.predict(observation, watching)
            answers[step, number] = answer[0]
            action, memory = controller.predict(observation, memory)
            observation, *_ = env.step(action)
            states[step, number] = [env.axes.state[0, STATE_NAMES.index(name)] for name in SIGNALS]
        env.close()
    return states, answers, key


def in_the_browser(browser, file, key):
    script = f"""async () => {{ {START}
    page.settings.running = false;
    const reference = {json.dumps(reference().tolist())};
    const {{ machine }} = page;
    const throttle = {{ "leakage.internal_resistance": FACTS.testPressure / ({LEAK} * FACTS.litrePerMinute) }};
    for (const axis of [0, 1, 2]) {{
      machine.choose(axis, axis);
      machine.change(axis, {{ ...FACTS.own, ...throttle }});
    }}
    machine.begin(reference[0], {key >> 32}, {key & 0xFFFFFFFF});
    const rows = [];
    const names = {json.dumps([*SIGNALS, *LeakageEstimate._fields])};
    for (let step = 0; step < {STEPS}; step++) {{
      machine.step((ahead) => reference[step + Math.round(ahead / FACTS.period)]);
      rows.push([0, 1, 2].map((axis) => names.map((name) => String(machine.read(axis, name)))));
    }}
    return rows; }}"""
    with open_page(browser, file) as page:
        rows = page.evaluate(script)
        assert page.problems == []
    return np.array(rows, dtype=np.float64)


@pytest.fixture(scope="module")
def runs(browser, tmp_path_factory):
    file = tmp_path_factory.mktemp("page") / "playground.html"
    file.write_text(build.playground_page(), encoding="utf-8")
    states, answers, key = in_the_environment()
    page = in_the_browser(browser, file, key)
    return states, answers, page[:, :, : len(SIGNALS)], page[:, :, len(SIGNALS) :]


def test_the_axes_of_the_page_are_those_of_the_environment(runs):
    states, _, page, _ = runs
    difference = (np.abs(page - states) / np.ptp(states, axis=0)).max(axis=(0, 2))
    for kind, largest in zip(build.CHOICES, difference, strict=True):
        assert largest <= (1e-4 if kind == "ppo" else 1e-9)  # PPO's network sums in float32


def test_the_detectors_of_the_page_are_the_leakage_head(runs):
    _, answers, _, page = runs
    number = 0  # its axis is read in the same periods; the others are read some periods later
    ours, theirs = page[:-1, number], answers[1:, number]  # the page shows the answer after the step
    assert np.array_equal(np.isnan(ours), np.isnan(theirs))
    assert np.nanmax(np.abs(ours - theirs) / (1.0 + np.abs(theirs))) <= 1e-4
    assert (page[-1, :, 0] > 0.9).all()  # each detector finds the leak
