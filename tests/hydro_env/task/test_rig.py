"""A task on another rig: what follows from the rig, what stays, the rig's own ranges, names and files."""

import math

import numpy as np
import pytest

from hydro_env import PlantParameters, ServoHydraulicEnv, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.folders import config_folder
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.task.configuration import task_config
from hydro_env.task.randomisation import PUBLISHED_RANGES, own_value
from hydro_env.task.settings import draws_of

RIGS = sorted(file.stem for file in (config_folder() / "rigs").glob("*.yaml"))
TASKS = sorted(file.stem for file in (config_folder() / "tasks").glob("*.yaml"))
SMALL = {"cylinder": {"stroke": 0.1}, "supply": {"model": "constant", "pressure": 140e5}, "load": {"mass": 20.0}}


@pytest.fixture
def small(tmp_path):
    """A rig of a quarter of the stroke and twice the pressure of the paper's."""
    file = tmp_path / "small.yaml"
    PlantParameters().replace(**SMALL).to_yaml(file)
    return file


def drawn(config, count=400):
    envs = ServoHydraulicVectorEnv(count, config, info=False)
    envs.reset(seed=0)
    return {path: envs.axes.physical[:, number] for number, path in enumerate(PARAMETER_PATHS)}


def test_factors_give_the_published_ranges_on_the_papers_rig():
    rows = {PARAMETER_PATHS[row["parameter"]]: (row["low"], row["high"]) for row in draws_of(TaskConfig())}
    for path, ends in PUBLISHED_RANGES.items():
        assert rows.pop(path) == pytest.approx(ends, rel=1e-15)
    assert rows == {"friction.breakaway_force": (1.2, 1.8), "leakage.external_resistance": (1e12, 1e13)}


def test_a_task_moves_there_and_back(small):
    assert task_config(rig="kovari_2015") == task_config(task_config(rig=small), rig="kovari_2015") == TaskConfig()
    assert task_config(task_config(rig="symmetric_eha"), rig=small) == task_config(rig=small)


@pytest.mark.parametrize("name", RIGS)
def test_nothing_overwrites_the_numbers_of_a_rig(name):
    config = task_config(rig=name)
    assert config.plant == PlantParameters.from_yaml(config_folder() / "rigs" / f"{name}.yaml")
    values = drawn(config)
    for path, (low, high) in PUBLISHED_RANGES.items():
        own = own_value(config.plant, path)
        paper = own_value(PlantParameters(), path)
        chosen = values[path][values[path] > 0.0] if path == "load.spring_stiffness" else values[path]
        if own == 0.0:
            assert (values[path] == 0.0).all()
            continue
        assert own * low / paper * (1 - 1e-12) <= chosen.min() <= chosen.max() <= own * high / paper * (1 + 1e-12)
        assert chosen.max() - chosen.min() > 0.9 * own * (high - low) / paper
    excess = values["friction.breakaway_force"] / values["friction.coulomb_force"] - 1.0
    own = config.plant.friction.breakaway_force / config.plant.friction.coulomb_force - 1.0
    assert 0.4 * own - 1e-12 <= excess.min() <= excess.max() <= 1.6 * own + 1e-12


def test_settings_follow_from_stroke_speed_and_pressure(small):
    config, default = task_config(rig=small), TaskConfig()
    assert config.references.largest_amplitude == pytest.approx(0.025)
    assert config.references.step_range == pytest.approx((0.0005, 0.005))
    assert config.reward.error_scale == pytest.approx(0.0025)
    position = config.sensors.position
    assert (position.low, position.high) == pytest.approx((-0.05, 0.05))
    assert position.noise / position.high == pytest.approx(default.sensors.position.noise / 0.2)
    # 140 bar, and 70 bar times the ratio of the areas behind the rod: the next usual ranges.
    for channel, range_end in {"pressure_a": 160e5, "pressure_b": 400e5}.items():
        usual, own = getattr(default.sensors, channel), getattr(config.sensors, channel)
        assert own.high == range_end
        for name in ("noise", "bias", "resolution"):
            assert getattr(own, name) / own.high == pytest.approx(getattr(usual, name) / usual.high)
    assert config.failure.pressure_rating == pytest.approx(500e5)
    # Twice the pressure gives √2 of the speed, but for the pressure of the tank.
    assert config.failure.end_stop_speed / default.failure.end_stop_speed == pytest.approx(math.sqrt(2.0), rel=0.01)
    assert config.references.acceleration_limit == pytest.approx(4.0 * math.sqrt(2.0), rel=0.01)
    assert config.sensors.spool_position == default.sensors.spool_position
    assert config.leakage == default.leakage


def rig_with(file, **groups):
    PlantParameters().replace(**groups).to_yaml(file)
    return task_config(rig=file)


def test_a_heavy_load_or_a_soft_oil_column_lowers_the_acceleration_of_references(small):
    config = rig_with(small, load={"mass": 5000.0, "spring_stiffness": 0.0})
    back = 70e5 * math.pi / 4 * (0.04**2 - 0.028**2) - 1e5 * math.pi / 4 * 0.04**2
    assert config.references.acceleration_limit == pytest.approx(0.25 * back / 5003.0)
    # A quarter of the stiffness halves the natural frequency.
    config = rig_with(small, fluid={"bulk_modulus": 0.35e9}, load={"spring_stiffness": 0.0})
    assert config.references.acceleration_limit == pytest.approx(2.0, rel=0.01)
    weak = rig_with(small, supply={"model": "constant", "pressure": 35e5})  # makes no weak cylinder
    assert weak.failure.pressure_rating == TaskConfig().failure.pressure_rating


def test_what_the_user_set_stays(small):
    changes = {
        "references": {"largest_amplitude": 0.011, "preview_times": []},
        "sensors": {"position": {"noise": 1e-4}},
        "reward": {"effort": 0.2},
        "control_period": 0.002,
        "randomisation": {"load.mass": {"factor": [0.9, 1.1]}},
    }
    config = task_config(changes, rig=small)
    assert config.references.largest_amplitude == 0.011
    assert config.references.step_range == pytest.approx((0.0005, 0.005))
    assert config.sensors.position.noise == 1e-4
    assert config.sensors.position.high == pytest.approx(0.05)
    assert (config.reward.effort, config.control_period, config.references.preview_times) == (0.2, 0.002, ())
    assert config.randomisation["load.mass"].factor == (0.9, 1.1)
    assert task_config(None, rig=small, randomisation={}).randomisation == {}
    assert task_config({"randomisation": {}}, rig=small).randomisation == {}
    # A keyword comes after the rig.
    assert task_config(None, rig=small, plant={"load": {"mass": 33.0}}).plant.load.mass == 33.0


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("task", TASKS)
def test_every_task_can_begin_on_every_rig(task, rig):
    envs = ServoHydraulicVectorEnv(30, task=task, rig=rig)
    observation, _ = envs.reset(seed=0)
    assert np.abs(observation).max() <= envs.single_observation_space.high.max()
    assert envs.axes.column("redraws").mean() < 0.2
    observation, reward, *_ = envs.step(np.zeros((30, 1)))
    assert np.isfinite(observation).all()
    assert np.isfinite(reward).all()


def test_a_rig_says_which_sensors_it_has(small):
    with small.open("a") as file:
        file.write("sensors:\n  pressure_a: {high: 250 bar, noise: 0.1 bar}\n  spool_position: {fitted: false}\n")
    config, without = task_config(rig=small), task_config(rig="kovari_2015")
    assert (config.sensors.pressure_a.high, config.sensors.pressure_a.noise) == (250e5, 0.1e5)
    assert not config.sensors.spool_position.fitted
    assert "spool_position" not in ServoHydraulicEnv(config).observation_names
    # What the file leaves out follows from stroke and range.
    assert config.sensors.pressure_a.bias == pytest.approx(2.5 * without.sensors.pressure_a.bias)
    assert config.sensors.position.high == pytest.approx(0.05)
    # A number that the task sets counts more; a sensor that is absent stays absent.
    mine = task_config({"sensors": {"pressure_a": {"noise": 3e4}}}, rig=small)
    assert (mine.sensors.pressure_a.noise, mine.sensors.pressure_a.high) == (3e4, 250e5)
    assert not mine.sensors.spool_position.fitted
