"""docs/circuit.md: every block of YAML loads and runs, does what its name says, and every field it names exists."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_env import PlantParameters, ServoHydraulicEnv, simulate
from hydro_env.files import read_yaml
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.plant.workable import refuse_unworkable
from hydro_env.task.configuration import TaskConfig

PAGE = (Path(__file__).parents[2] / "docs" / "circuit.md").read_text(encoding="utf-8")
BLOCKS = {
    (kind, name): text
    for kind, name, text in re.findall(r"```yaml\n# (rig|task): ([^\n]+)\n(.*?)```", PAGE, flags=re.DOTALL)
}
RIGS = {name: text for (kind, name), text in BLOCKS.items() if kind == "rig"}
TASKS = {name: text for (kind, name), text in BLOCKS.items() if kind == "task"}


def rig(name, folder):
    path = folder / "rig.yaml"
    path.write_text(RIGS[name], encoding="utf-8")
    return PlantParameters.from_yaml(path)


def task(name, folder):
    path = folder / "task.yaml"
    path.write_text(TASKS[name], encoding="utf-8")
    return TaskConfig.from_yaml(path)


def moved(plant, voltage=4.0):
    return simulate(plant, np.repeat([voltage, 0.0, -voltage], 10), 5e-3)


def test_every_block_is_a_rig_or_a_task():
    assert len(BLOCKS) == PAGE.count("```yaml")
    assert len(RIGS) >= 12
    assert len(TASKS) >= 4


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_runs(name, tmp_path):
    plant = rig(name, tmp_path)
    refuse_unworkable(plant)
    run = moved(plant)
    assert run.position.max() - run.position[0] > 2e-3
    assert yaml.safe_load(RIGS[name]) == read_yaml(tmp_path / "rig.yaml")


@pytest.mark.parametrize("name", TASKS)
def test_a_task_runs(name, tmp_path):
    env = ServoHydraulicEnv(task(name, tmp_path))
    observation, info = env.reset(seed=3)
    for _ in range(20):
        observation, _, terminated, _, info = env.step(np.array([0.2]))
        assert np.isfinite(observation).all()
        assert not terminated, info


def test_the_tasks_are_what_they_are_called(tmp_path):
    def episode(name):
        env = ServoHydraulicEnv(task(name, tmp_path))
        return env, *env.reset(seed=1)

    env, *_ = episode("another circuit, nothing drawn")
    assert env.parameters.replace(leakage={"internal_resistance": 2e13}) == env.config.plant
    assert env.parameters.load.spring_stiffness == 0.0
    assert episode("leak through the throttle")[0].parameters.leakage.orifice_gain > 0.0
    poor = task("a poorer position sensor, slow pressure transducers", tmp_path).sensors
    assert (poor.position.noise, poor.position.high) == (1e-4, TaskConfig().sensors.position.high)
    env, observation, info = episode("exact sensors, no latency")
    column = env.observation_names.index("position")
    assert observation[column] * env.observation_scale[column] == pytest.approx(info["position"], abs=1e-8)


def test_every_field_that_the_page_names_exists():
    named = set(re.findall(r"`([a-z_]+\.[a-z_]+)(?:: [^`]+)?`", PAGE))
    assert len(named) > 30
    assert {name for name in named if name not in PARAMETER_PATHS} <= {"docs.model"}
    for field in ("control_period", "command_latency", "sensors", "disturbance", "randomisation", "plant"):
        assert f"`{field}" in PAGE
        assert field in TaskConfig.model_fields


def test_the_page_leaves_no_part_out():
    """Every parameter of the groups that are parts of the circuit stands in the table, but for a few details."""
    details = {
        "cylinder.end_stop_stiffness",
        "cylinder.end_stop_damping",
        "fluid.density",
        "friction.coulomb_force",
        "friction.breakaway_force",
        "friction.stribeck_velocity",
        "friction.transition_velocity",
        "friction.bristle_stiffness",
        "friction.bristle_damping",
    }
    assert {path for path in PARAMETER_PATHS if path not in PAGE} <= details
