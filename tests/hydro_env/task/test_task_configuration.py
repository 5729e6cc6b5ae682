"""The task as data: a file, a mapping and keywords say the same; wrong ones are answered with one line."""

import math

import numpy as np
import pytest
from refusal import refused

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import Group
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.task.configuration import task_config
from hydro_env.units import Number

CHANGES = {
    "control_period": 0.004,
    "command_latency": 0.0005,
    "leakage": {"healthy_share": 0.5, "schedule": "growth"},
    "references": {"weights": {"sine": 2.0, "user": 1.0}, "user": [0.0, 0.01, 0.02]},
    "randomisation": {
        "load.mass": {"uniform": [50.0, 70.0]},
        "leakage.external_resistance": {
            "log_uniform": [1e12, 1e13],
            "otherwise": math.inf,
            "otherwise_probability": 0.5,
        },
    },
    "plant": {"load": {"viscous_damping": 500.0}, "supply": {"model": "constant"}},
    "reward": {"effort": 0.1},
}


@pytest.mark.parametrize("changes", [{}, CHANGES], ids=["default", "changed"])
def test_yaml_gives_back_an_equal_object(changes, tmp_path):
    config = task_config(changes)
    config.to_yaml(tmp_path / "task.yaml")
    assert TaskConfig.from_yaml(tmp_path / "task.yaml") == config


def test_file_mapping_and_keywords_say_the_same(tmp_path):
    path = tmp_path / "task.yaml"
    task_config(CHANGES).to_yaml(path)
    other = {"reward": {"effort": 0.3}}
    given = [(path,), (str(path),), (CHANGES,), (task_config(CHANGES),)]
    environments = [ServoHydraulicEnv(*each) for each in given]
    environments += [ServoHydraulicEnv(*each, **CHANGES) for each in ((), (TaskConfig(),), (other,))]
    rollouts = [[env.reset(seed=1)[0], *(env.step(np.array([0.2]))[0] for _ in range(5))] for env in environments]
    for env, rows in zip(environments, rollouts, strict=True):
        assert env.config == environments[0].config
        np.testing.assert_array_equal(rows, rollouts[0])
    assert ServoHydraulicVectorEnv(2, path).config == environments[0].config


def test_keywords_lay_themselves_over_a_file(tmp_path):
    path = tmp_path / "task.yaml"
    path.write_text("leakage:\n  healthy_share: 0.5\n  law: orifice\nplant:\n  load:\n    mass: 70\n")
    config = task_config(path, leakage={"healthy_share": 0.1}, plant={"load": {"spring_stiffness": 0.0}})
    assert (config.leakage.healthy_share, config.leakage.law) == (0.1, "orifice")
    assert (config.plant.load.mass, config.plant.load.spring_stiffness) == (70.0, 0.0)
    assert config.references == TaskConfig().references


def test_a_leak_of_the_plant_is_refused_because_each_episode_draws_it(tmp_path):
    (tmp_path / "task.yaml").write_text("plant:\n  leakage: {orifice_gain: 1.0e-8}\n")
    with refused("plant.leakage.internal_resistance: .*leakage_flow_lpm"):
        task_config(None, plant={"leakage": {"internal_resistance": 1e11}})
    with refused("task.yaml: plant.leakage.orifice_gain: has no effect"):
        task_config(tmp_path / "task.yaml")
    config = task_config(None, plant={"leakage": {"external_resistance": 1e12}})
    assert config.plant.leakage.external_resistance == 1e12
    assert task_config(config.model_dump()) == config  # a whole rig states its own leak


def drawn(randomisation, count=2000, **config):
    envs = ServoHydraulicVectorEnv(count, randomisation=randomisation, info=False, **config)
    envs.reset(seed=0)
    return {path: envs.axes.physical[:, PARAMETER_PATHS.index(path)] for path in PARAMETER_PATHS}


def test_a_draw_may_multiply_a_parameter_that_is_drawn_itself():
    """In whatever order they are written."""
    coulomb = {"friction.coulomb_force": {"uniform": [100.0, 200.0]}}
    breakaway = {"friction.breakaway_force": {"uniform": [1.5, 2.0], "times": "friction.coulomb_force"}}
    for given in (coulomb | breakaway, breakaway | coulomb):
        values = drawn(given)
        ratio = values["friction.breakaway_force"] / values["friction.coulomb_force"]
        assert 1.5 <= ratio.min() < 1.51
        assert 1.99 < ratio.max() <= 2.0
        assert abs(np.corrcoef(ratio, values["friction.coulomb_force"])[0, 1]) < 0.1
    fixed = drawn({**breakaway, "friction.coulomb_force": None}, plant={"friction": {"coulomb_force": 100.0}})
    assert 150.0 <= fixed["friction.breakaway_force"].min() < 152.0


def test_initial_positions_fill_the_configured_range():
    for shares in ((-1.0, 1.0), (0.5, 0.75), (0.0, 0.0)):
        envs = ServoHydraulicVectorEnv(2000, randomisation={}, initial_position_range=shares)
        _, info = envs.reset(seed=0)
        # 60 % of the range that 70 bar hold against 89 N/mm.
        low, high = 0.6 * -0.0490, 0.6 * 0.0981
        place = np.where(info["position"] > 0, info["position"] / high, -info["position"] / low)
        assert place.min() == pytest.approx(shares[0], abs=0.01)
        assert place.max() == pytest.approx(shares[1], abs=0.01)
        assert (info["velocity"] == 0.0).all()


NAN = float("nan")


def drawn_by(path, **draw):
    return {"randomisation": {path: draw}}


RIG = "aalborg_svsdp_2017"
WRONG = [
    ({"controll_period": 0.01}, "controll_period = 0.01: unknown key; did you mean control_period"),
    ({"plant": {"supply": {"precharge_pressure": 65e5}}}, "randomisation: .*precharge_pressure = 65 bar must be below"),
    # What is drawn.
    (drawn_by("supply.model", uniform=[0, 1]), "'supply.model' is not a number of the plant"),
    (drawn_by("load.mass", uniform=[70, 50]), r"bounds = \[70, 50\]: must be finite and rising"),
    (drawn_by("load.mass", uniform=[1, 2], times="load.weight"), "times = 'load.weight' is not a parameter"),
    (drawn_by("load.mass", uniform=[50, 60], otherwise=55), "belong together"),
    (drawn_by("supply.pressure", uniform=["50 bar", "2000 bar"]), "pressure = 2000 bar is above its limit 1000 bar"),
    (drawn_by("leakage.external_resistance", factor=[0.5, 2.0]), "external_resistance: the rig's own value is infin"),
    ({"initial_position_range": [-2.0, 1.0]}, r"initial_position_range = \[-2, 1\]: must rise within -1 to 1"),
    # Leakage, faults and forces.
    (
        {"leakage": {"healthy_range": [0.03, 0.003]}},
        r"healthy_range = \[0.03, 0.003\]: must rise within 1e-06 to 20 l/min",
    ),
    ({"faults": {"sensor_gain": {"sensors": ["force"]}}}, "unknown sensor 'force'; known: position"),
    # References, sensors, rewards.
    ({"references": {"weights": {"zigzag": 1.0}}}, "unknown family 'zigzag'; known: step, point_to_point"),
    (
        {"references": {"weights": {"user": 1.0}, "user": [0.0, 0.3]}},
        r"references.user\[1\] = 0.3 m: must be a position within",
    ),
    ({"sensors": {"position": {"fitted": False}}}, "position.fitted = false"),
    # Time.
    ({"command_latency": 26e-3}, "command_latency = 0.026 s must not exceed 5 times control_period = 0.005 s"),
    ({"control_period": 20e-3, "episode_duration": 0.015}, "episode_duration must be at least one control_period"),
    # Task and rig by name.
    ({"rig": "aalborg"}, f"rig 'aalborg': unknown; did you mean {RIG}. known: {RIG}, "),
    ({"rig": "symmetric_eha", "plant": "kovari_2015"}, "task: rig = 'symmetric_eha' and plant = "),
]


def groups_of(group):
    """A group of settings, and those within it."""
    kinds = [info.annotation for info in group.model_fields.values()]
    inner = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Group)]
    return [group, *(found for kind in inner for found in groups_of(kind))]


def test_every_number_of_the_task_has_bounds():
    """A number that is absurd or none would poison observations or rewards; bounds exclude infinity too."""
    groups = groups_of(TaskConfig)
    free = set()
    for group in groups:
        for name, info in group.model_fields.items():
            bounds = {type(bound).__name__ for bound in info.metadata}
            if info.annotation is float and not (bounds & {"Ge", "Gt"} and "Le" in bounds):
                free.add(name)
            if info.annotation == tuple[Number, Number] and "high" not in (info.json_schema_extra or {}):
                free.add(name)
    assert len(groups) > 15
    assert not free
    for changes in (
        {"reward": {"effort": NAN}},
        {"initial_position_range": [NAN, 1.0]},
        drawn_by("load.mass", uniform=[0.5, 1e300]),
    ):
        with refused("effort|initial_position_range|load.mass"):
            task_config(None, **changes)


@pytest.mark.parametrize(("changes", "message"), WRONG)
def test_a_wrong_task_is_answered_with_one_line(changes, message):
    with refused(message) as caught:
        ServoHydraulicEnv(**changes)
    named = {"rig", "task"} & set(changes)  # a file is named before the task
    assert named or str(caught.value).startswith(("task: ", "references.user"))
