"""Supply, return line and transducers that move: what the axes feel, and what the head answers."""

import numpy as np
import pytest

from hydro_agents.detection.detector import MeasuredColumns
from hydro_agents.detection.disturbances import SUPPLY, Disturbances, Disturbed
from hydro_agents.detection.head import LeakageHead
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import DETECTION
from hydro_env import TaskConfig
from hydro_env.plant.states import State

CONFIG = TaskConfig(episode_duration=3.5)
TIME = CONFIG.control_period * np.arange(CONFIG.steps)
SUPPLY_STATE = State._fields.index("supply_pressure")


class Watcher:
    """Holds the command at zero, and notes the supply pressure of the axes in every control period."""

    def begin(self, axes):
        self.axes, self.seen = axes, []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.seen.append(self.axes.state[:, SUPPLY_STATE].copy())
        return np.zeros((len(observation), 1), dtype=np.float32), None


def moved(row, course, axes, direct):
    courses = np.zeros((axes, 4, CONFIG.steps))
    courses[:, row] = course
    return Disturbances(courses, np.full(axes, direct))


@pytest.mark.parametrize("direct", [False, True])
def test_the_supply_follows_its_course(direct):
    watcher = Watcher()
    disturbances = moved(SUPPLY, np.where(TIME < 1.0, 0.0, 0.05), 2, direct)
    cases = Cases(np.array(DETECTION.take(2)), np.full(2, 0.01), np.full(2, "step"))
    run_cases(CONFIG, Disturbed(watcher, disturbances), cases)
    seen = np.array(watcher.seen)
    assert seen[-1] / seen[190] == pytest.approx(1.05, abs=0.005)
    assert (seen[205] / seen[190] > 1.045).all() == direct  # the accumulator of the paper's rig takes longer


def test_the_shipped_head_marks_windows_with_a_swinging_supply_as_outside_and_no_others():
    head, axes = LeakageHead.load(pretrained_folder() / "leakage_head"), 60
    measured, seeds = MeasuredColumns.of(CONFIG), np.array(DETECTION.take(axes, 150_000))
    shares = []
    for size in (0.0, 0.05):
        disturbances = moved(SUPPLY, size * np.sin(np.pi * TIME), axes, False)
        controller = Disturbed(shipped("pid", CONFIG), disturbances)
        run = run_cases(CONFIG, controller, Cases(seeds, np.full(axes, 0.01)), measured.columns)
        shares.append(head.estimate_windows(measured.si(run.signals)[:, :, 300:]).outside.mean())
    assert shares[0] <= 0.05
    assert shares[1] >= 0.9
