"""The playground in a real browser: its axes move, measure and decide as those of the environment."""

import json
from pathlib import Path

import numpy as np
import pytest
from browser import SCHEMES, SIZES, open_page, problems_of

from hydro_agents.detection.head import LeakageEstimate, LeakageHead
from hydro_agents.learning.loading import shipped
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.plant.states import STATE_NAMES
from hydro_rig.export.playground import CHOICES

FILE = Path(__file__).parents[3] / "docs" / "playground.html"
PAGE = FILE.read_text(encoding="utf-8")
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
    states, answers = (np.empty((STEPS, len(CHOICES), count)) for count in (len(SIGNALS), 9))
    for number, kind in enumerate(CHOICES):
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


def in_the_browser(browser, key):
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
    with open_page(browser, FILE) as page:
        rows = page.evaluate(script)
        assert page.problems == []
    return np.array(rows, dtype=np.float64)


@pytest.fixture(scope="module")
def runs(browser):
    states, answers, key = in_the_environment()
    page = in_the_browser(browser, key)
    return states, answers, page[:, :, : len(SIGNALS)], page[:, :, len(SIGNALS) :]


@pytest.mark.parametrize("number", range(len(CHOICES)), ids=list(CHOICES))
def test_the_axes_of_the_page_are_those_of_the_environment(runs, number):
    states, _, page, _ = (part[:, number] for part in runs)
    difference = np.abs(page - states) / np.ptp(states, axis=0)
    assert difference.max() <= (1e-4 if list(CHOICES)[number] == "ppo" else 1e-9)  # PPO's network sums in float32


def test_the_detectors_of_the_page_are_the_leakage_head(runs):
    _, answers, _, page = runs
    number = 0  # its axis is read in the same periods; the others are read some periods later
    ours, theirs = page[:-1, number], answers[1:, number]  # the page shows the answer after the step
    assert np.array_equal(np.isnan(ours), np.isnan(theirs))
    assert np.nanmax(np.abs(ours - theirs) / (1.0 + np.abs(theirs))) <= 1e-4
    assert (page[-1, :, 0] > 0.9).all()  # each detector finds the leak


def test_the_detectors_listen_for_two_seconds_before_they_give_a_verdict(browser):
    script = f"""async (steps) => {{ {START}
    page.settings.running = false;
    page.restart();
    for (let step = 0; step < steps; step++) page.step();
    page.draw();
    return [...document.querySelectorAll(".verdict")].map((line) => line.textContent); }}"""
    steps = round(2.0 / CONFIG.control_period)
    with open_page(browser, FILE) as page:
        first, later = page.evaluate(script, steps - 10), page.evaluate(script, steps + 30)
    assert len(first) == len(later) == len(CHOICES)
    assert all(line.startswith("detector: listening, ") for line in first)
    assert not any("listening" in line for line in later)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", SIZES)
def test_nothing_is_cut_off_and_the_console_stays_silent(browser, width, scheme):
    with open_page(browser, FILE, width, scheme=scheme) as page:
        page.evaluate(
            f"""async () => {{ {START}
            for (let step = 0; step < 500; step++) page.step();
            document.querySelectorAll("details").forEach((part) => (part.open = true));
            page.draw(); }}"""
        )
        assert problems_of(page) == []
        assert page.evaluate("document.querySelectorAll('canvas').length") == 7
        assert page.evaluate("matchMedia('(prefers-color-scheme: dark)').matches") == (scheme == "dark")


def test_the_page_is_one_small_file():
    assert len(PAGE.encode()) <= 1_000_000
    assert "http:" not in PAGE
    assert "https:" not in PAGE
    assert 'src="' not in PAGE
