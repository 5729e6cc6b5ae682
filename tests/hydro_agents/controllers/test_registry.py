"""Controllers by name: kinds, modules of one's own, and one clear line for what is wrong."""

import numpy as np
import pytest
from refusal import refused

from hydro_agents.controllers.pid import PID
from hydro_agents.controllers.registry import make_controller
from hydro_agents.learning.opponents import opponent
from hydro_env import ConfigurationError, TaskConfig

CONFIG = TaskConfig()
SOURCE = """
import numpy as np

class Simple:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 1)), state

class Tuned(Simple):
    def __init__(self, config, gain=1.0):
        self.period, self.gain = config.control_period, gain

def make(config):
    return Tuned(config, 7.0)

class Group:
    inner = Tuned

ready = Simple()
number = 3

def command(observation):
    return observation["error"]
"""


@pytest.fixture(autouse=True)
def my_controllers(tmp_path, monkeypatch):
    (tmp_path / "my_controllers.py").write_text(SOURCE)
    (tmp_path / "broken.py").write_text("import not_a_module")
    monkeypatch.chdir(tmp_path)  # modules in the current folder count


def test_the_built_in_kind():
    pid = make_controller("pid", CONFIG, {"proportional": 33.0})
    assert isinstance(pid, PID)
    assert pid.gains.proportional == 33.0
    assert pid.layout.control_period == CONFIG.control_period


def test_a_class_a_function_and_an_object_of_ones_own():
    assert type(make_controller("my_controllers:Simple", CONFIG)).__name__ == "Simple"
    tuned = make_controller("my_controllers:Tuned", CONFIG, {"gain": 5.0})
    assert (tuned.period, tuned.gain) == (CONFIG.control_period, 5.0)
    assert make_controller("my_controllers:make", CONFIG).gain == 7.0
    assert make_controller("my_controllers:Group.inner", CONFIG).gain == 1.0
    ready = make_controller("my_controllers:ready", CONFIG)
    assert ready is make_controller("my_controllers:ready", CONFIG)
    command, _ = ready.predict(np.zeros((2, 5)))
    assert command.shape == (2, 1)


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        ("pdi", {}, r"kind 'pdi': unknown; did you mean pid\? known: pid, .*or 'module:attribute'"),
        ("pid", {"proportional": -1}, "pid: proportional = -1"),
        ("pid", {"gain": 1}, "pid: .*gain.*unknown key"),
        ("my_controllers:", {}, "'my_controllers:': must be 'module:attribute'"),
        (":Simple", {}, "must be 'module:attribute'"),
        ("not_a_module:Simple", {}, "'not_a_module' cannot be imported: ModuleNotFoundError"),
        ("broken:Simple", {}, "'broken' cannot be imported: ModuleNotFoundError: No module named 'not_a_module'"),
        ("my_controllers:Absent", {}, "'my_controllers' has no 'Absent'"),
        ("my_controllers:number", {}, "needs a method predict, or must be a class or function"),
        ("my_controllers:ready", {"gain": 1.0}, "is already a controller and takes no settings"),
        ("my_controllers:Tuned", {"gian": 1.0}, "cannot be made .*TypeError: .*'gian'"),
        ("my_controllers:command", {}, "cannot be made .*TypeError"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(kind, settings, message):
    with refused(message):
        make_controller(kind, CONFIG, settings)


def test_an_opponent_is_named_in_the_message():
    with pytest.raises(ConfigurationError, match="mine: 'my_controllers:Absent'"):
        opponent("my_controllers:Absent", CONFIG, "mine")
    with pytest.raises(ConfigurationError, match=r"mine: 'ppoo': unknown"):
        opponent("ppoo", CONFIG, "mine")
    assert type(opponent("my_controllers:Simple", CONFIG, "mine")).__name__ == "Simple"
