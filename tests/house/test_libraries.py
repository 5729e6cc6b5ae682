"""What other people's libraries take of this project; docs/own_controller.md lists them."""

import inspect
from pathlib import Path

import numpy as np
import pytest
import yaml
from stable_baselines3 import PPO

from hydro_env import PlantParameters, linearise

ZOO = Path(__file__).parents[2] / "configs" / "agents" / "rl_zoo3_ppo.yaml"


def test_control_libraries_take_the_linearised_axis():
    plant = PlantParameters().replace(friction={"model": "none"})
    space = linearise(plant, position=0.02).state_space(outputs=("position", "velocity"))
    a, b, c, d = space.matrices
    at_rest = d - c @ np.linalg.solve(a, b)
    assert np.linalg.eigvals(a).real.max() < 0.0
    assert at_rest[1, 0] == pytest.approx(0.0, abs=1e-9)
    assert np.isfinite(at_rest).all()


def test_the_settings_for_rl_zoo3_are_those_of_ppo():
    ((name, settings),) = yaml.safe_load(ZOO.read_text(encoding="utf-8")).items()
    assert name == "ServoHydraulic-v0"
    own = {"n_envs", "n_timesteps", "normalize"}  # of rl-zoo3
    assert set(settings) - own <= set(inspect.signature(PPO.__init__).parameters)
    assert settings["n_envs"] * settings["n_steps"] % settings["batch_size"] == 0
