"""What other libraries look for: errors that they understand, the spec, infos of numbers alone, NumPy integers."""

import copy
import json

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from refusal import refused

from hydro_env import PlantParameters, ServoHydraulicEnv, ServoHydraulicVectorEnv, TaskConfig

ID, NAN = "ServoHydraulic-v0", float("nan")
BOTH = (ServoHydraulicEnv, ServoHydraulicVectorEnv)


def test_the_spec_tells_the_length_of_an_episode_and_changes_no_episode():
    env = gym.make(ID, episode_duration=0.1)
    assert env.spec.max_episode_steps == 20
    again = gym.make(env.spec)  # Gymnasium puts a limit of 20 steps around it
    assert again.spec.max_episode_steps == 20
    rows = []
    for each in (env, again):
        each.reset(seed=0)
        rows.append([each.step(np.zeros(1))[:4] for _ in range(20)])
    for mine, other in zip(*rows, strict=True):
        np.testing.assert_array_equal(mine[0], other[0])
        assert mine[1:] == other[1:]
    assert [row[3] for row in rows[0]] == [False] * 19 + [True]
    vector = gym.make_vec(ID, num_envs=2, episode_duration=0.1)
    assert vector.spec.max_episode_steps == 20
    assert gym.make_vec(vector.spec).unwrapped.config == vector.unwrapped.config
    assert gym.make(ID, max_episode_steps=7).spec.max_episode_steps == 7
    assert gym.make_vec(ID, num_envs=2, max_episode_steps=7).spec.max_episode_steps == 7


@pytest.mark.parametrize("make", BOTH)
def test_wrong_seeds(make):
    env = make()
    for seed in (True, -1, 1.5, "3", object(), {}, NAN, [[1]], b"1"):
        with refused(r"^seed = .*: must be a whole number of at least 0"):
            env.reset(seed=seed)
    with refused("seed"):
        ServoHydraulicVectorEnv(2).reset(seed=[1, 1.5])


def test_axes_that_do_not_fit_into_memory():
    with refused("num_envs = 1000000 with 7200000 steps: too large for memory"):
        ServoHydraulicVectorEnv(10**6, TaskConfig(control_period=0.5e-3, command_latency=0.0, episode_duration=3600.0))


def test_a_spec_is_json_of_the_content_and_makes_the_same_environment_again(tmp_path):
    task = TaskConfig(control_period=0.002, references={"weights": {"user": 1.0}, "user": [0.0] * 5})
    file = tmp_path / "task.yaml"
    task.to_yaml(file)
    more, specs = {"plant": PlantParameters(), "reward": {"effort": np.float64(0.2)}}, []
    for config in (task, task.model_dump(), file, str(file)):
        single = gym.make(ID, config=config, **more)
        vector = gym.make_vec(ID, num_envs=2, config=config, autoreset_mode=AutoresetMode.SAME_STEP, **more)
        specs.append((single.spec.to_json(), vector.spec))
        assert single.unwrapped.config == vector.unwrapped.config
    file.unlink()
    for text, of_many in specs:
        assert str(file) not in text
        again = gym.make(EnvSpec.from_json(text))
        assert again.unwrapped.config == single.unwrapped.config == copy.deepcopy(again.spec).make().unwrapped.config
        json.loads(of_many.to_json())
        again = gym.make_vec(of_many).unwrapped
        assert isinstance(again, ServoHydraulicVectorEnv)
        assert again.config == single.unwrapped.config
        assert again.autoreset_mode is AutoresetMode.SAME_STEP


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("num_envs", ("3", 1.5, 10**9, True, None, [], NAN, -1, 0), "must be a whole number within 1 to 1000000"),
        ("threads", ("2", 0, 1.5, 10**9, True, []), "must be a whole number within 1 to 1024"),
        ("max_episode_steps", ("5", 0, 2.5, True, []), "must be a whole number of at least 1"),
        ("render_mode", ("human", 5, [], {}), "the vector environment does not draw"),
        ("info", ("round", 1, None, []), ""),
        ("config", (5, [], b"a", object()), "must be a YAML file, a mapping or a TaskConfig"),
    ],
)
def test_wrong_arguments(name, values, message):
    for value in values:
        with refused(f"{name} = .*{message}") as caught:
            ServoHydraulicVectorEnv(**{name: value})
        assert len(str(caught.value)) < 300
        if name in ("render_mode", "info", "config") and value != "human":
            with refused(f"{name} = "):
                ServoHydraulicEnv(**{name: value})
