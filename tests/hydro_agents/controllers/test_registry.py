"""Controllers by name: kinds, modules of one's own, and one clear line for what is wrong."""

import numpy as np
import pytest
from refusal import refused

from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.registry import controller_from_gains, gain_rows, gains_text, make_controller
from hydro_agents.learning.loading import found_in, load_controller
from hydro_env import TaskConfig

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
"""


@pytest.fixture(autouse=True)
def my_controllers(tmp_path, monkeypatch):
    (tmp_path / "my_controllers.py").write_text(SOURCE)
    (tmp_path / "broken.py").write_text("import not_a_module")
    monkeypatch.chdir(tmp_path)  # modules in the current folder count


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
        ("pdi", {}, r"kind 'pdi': unknown; did you mean pid\?"),
        ("pid", {"proportional": -1}, "pid: proportional = -1"),
        ("my_controllers:", {}, "'my_controllers:': must be 'module:attribute'"),
        ("broken:Simple", {}, "'broken' cannot be imported: ModuleNotFoundError: No module named 'not_a_module'"),
        ("my_controllers:Absent", {}, "'my_controllers' has no 'Absent'"),
        ("my_controllers:number", {}, "needs a method predict, or must be a class or function"),
        ("my_controllers:ready", {"gain": 1.0}, "is already a controller and takes no settings"),
        ("my_controllers:Tuned", {"gian": 1.0}, "cannot be made .*TypeError: .*'gian'"),
    ],
)
def test_what_is_wrong_is_told_in_one_line_with_its_name(kind, settings, message):
    with refused(message):
        make_controller(kind, CONFIG, settings)
    if kind in ("broken:Simple", "my_controllers:Absent", "my_controllers:number"):
        with refused(f"mine: .*{message}"):
            load_controller(kind, CONFIG, "mine")


def test_the_file_tells_each_gain_in_the_units_of_a_plc_and_reads_back_unchanged(tmp_path):
    gains = PIDGains(proportional=20.0, integral=40.0, derivative=0.5, reference_lead=0.012, lead_in_integral=False)
    shown = {row.name: row.in_practice for row in gain_rows(gains)}
    # A command of 1 is 10 V: 20 /m are 200 V/m.
    assert shown["proportional"] == "0.2 V/mm"
    assert shown["integral"] == "0.4 V/(mm s)"
    assert shown["derivative"] == "5 V/(m/s)"
    assert shown["reference_lead"] == "12 ms"
    assert shown["lead_in_integral"] == ""
    file = tmp_path / "gains.yaml"
    file.write_text(gains_text(gains), encoding="utf-8")
    assert "proportional: 20.0  # 0.2 V/mm, on the error" in file.read_text(encoding="utf-8")
    assert controller_from_gains(file, TaskConfig()).gains == gains


def test_the_folder_of_a_controller_stands_for_its_weights_or_gains(tmp_path):
    assert found_in(tmp_path) == str(tmp_path)
    (tmp_path / "gains.yaml").write_text("proportional: 12.0\n", encoding="utf-8")
    assert found_in(tmp_path) == str(tmp_path / "gains.yaml")
    (tmp_path / "policy.json").write_text("{}", encoding="utf-8")
    assert found_in(str(tmp_path)) == str(tmp_path / "policy")
