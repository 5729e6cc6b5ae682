"""The task as data: a file, a mapping and keywords say the same; wrong ones are answered with one line."""

import math

import numpy as np
import pytest
from refusal import refused

from hydro_env import ConfigurationError, PlantParameters, ServoHydraulicEnv, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.task.configuration import task_config

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
    environments = [
        ServoHydraulicEnv(path),
        ServoHydraulicEnv(str(path)),
        ServoHydraulicEnv(CHANGES),
        ServoHydraulicEnv(**CHANGES),
        ServoHydraulicEnv(task_config(CHANGES)),
        ServoHydraulicEnv(TaskConfig(), **CHANGES),
        ServoHydraulicEnv({"reward": {"effort": 0.3}}, **CHANGES),
    ]
    rollouts = []
    for env in environments:
        assert env.config == environments[0].config
        rows = [env.reset(seed=1)[0]]
        rows += [env.step(np.array([0.2]))[0] for _ in range(5)]
        rollouts.append(rows)
    for rows in rollouts[1:]:
        np.testing.assert_array_equal(rows, rollouts[0])
    assert ServoHydraulicVectorEnv(2, path).config == environments[0].config


def test_keywords_lay_themselves_over_a_file(tmp_path):
    path = tmp_path / "task.yaml"
    path.write_text("leakage:\n  healthy_share: 0.5\n  law: orifice\nplant:\n  load:\n    mass: 70\n")
    config = task_config(path, leakage={"healthy_share": 0.1}, plant={"load": {"spring_stiffness": 0.0}})
    assert (config.leakage.healthy_share, config.leakage.law) == (0.1, "orifice")
    assert (config.plant.load.mass, config.plant.load.spring_stiffness) == (70.0, 0.0)
    assert config.references == TaskConfig().references


def test_weights_and_randomisation_are_replaced_as_a_whole():
    for base in (None, {}, TaskConfig(), TaskConfig().model_dump()):
        config = task_config(base, randomisation={}, references={"weights": {"ramp": 1.0}})
        assert config.randomisation == {}
        assert config.references.weights == {"ramp": 1.0}
        config = task_config(base, randomisation={"load.mass": {"log_uniform": [50.0, 60.0]}})
        assert list(config.randomisation) == ["load.mass"]


def test_without_randomisation_every_episode_has_the_same_plant():
    plant = PlantParameters().replace(load={"mass": 72.0})
    env = ServoHydraulicEnv(plant=plant.model_dump(), randomisation={})
    for seed in range(5):
        env.reset(seed=seed, options={"leakage_resistance": plant.leakage.internal_resistance})
        assert env.parameters.replace(leakage={"internal_resistance": 2e13}) == plant


def test_tasks_are_frozen():
    config = TaskConfig()
    with pytest.raises(ConfigurationError, match="is frozen"):
        config.control_period = 0.01
    with pytest.raises(ConfigurationError, match="is frozen"):
        config.reward.effort = 1.0


def test_steps_and_preview_count_control_periods():
    assert (TaskConfig().steps, TaskConfig().preview_samples) == (400, (1, 2, 4, 8))
    config = task_config(None, control_period=0.01, episode_duration=0.3)
    assert (config.steps, config.preview_samples) == (30, (1, 1, 2, 4))
    assert task_config(None, control_period=0.001, episode_duration=1e-2, command_latency=0.0).steps == 10


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
    fixed = drawn(breakaway, plant={"friction": {"coulomb_force": 100.0}})
    assert 150.0 <= fixed["friction.breakaway_force"].min() < 152.0


def test_a_draw_may_be_something_else_with_a_probability():
    stiffness = drawn(
        {"load.spring_stiffness": {"uniform": [8e4, 9e4], "otherwise": 0.0, "otherwise_probability": 0.3}}
    )["load.spring_stiffness"]
    assert np.mean(stiffness == 0.0) == pytest.approx(0.3, abs=0.04)
    assert stiffness[stiffness > 0].min() >= 8e4


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
WRONG = {
    "unknown key": (
        {"controll_period": 0.01},
        "controll_period = 0.01: unknown key; did you mean control_period. known",
    ),
    "unknown deep key": ({"plant": {"load": {"weight": 1}}}, "plant.load.weight = 1: unknown key; known here: mass"),
    "plant value": ({"plant": {"supply": {"pressure": 70}}}, "plant.supply.pressure = 70: .*unit: Pa"),
    "plant geometry": ({"plant": {"cylinder": {"rod_diameter": 0.04}}}, "rod_diameter = 40 mm does not fit"),
    "group is a number": ({"leakage": 3}, "leakage = 3: "),
    "no such parameter": (
        {"randomisation": {"load.weight": {"uniform": [1, 2]}}},
        "'load.weight' is not a number of the plant",
    ),
    "a choice": (
        {"randomisation": {"supply.model": {"uniform": [0, 1]}}},
        "'supply.model' is not a number of the plant",
    ),
    "leak": (
        {"randomisation": {"leakage.internal_resistance": {"uniform": [1e12, 2e12]}}},
        "'leakage.internal_resistance' is drawn by the group 'leakage'",
    ),
    "no bounds": ({"randomisation": {"load.mass": {}}}, "needs either 'uniform"),
    "two kinds": (
        {"randomisation": {"load.mass": {"uniform": [1, 2], "log_uniform": [1, 2]}}},
        "needs either 'uniform",
    ),
    "falling": (
        {"randomisation": {"load.mass": {"uniform": [70, 50]}}},
        r"bounds = \[70, 50\]: must be finite and rising",
    ),
    "NaN bounds": ({"randomisation": {"load.mass": {"uniform": [NAN, 50]}}}, "must be a number, not NaN"),
    "log of zero": ({"randomisation": {"load.mass": {"log_uniform": [0, 50]}}}, "log_uniform needs positive bounds"),
    "below the limit": (
        {"randomisation": {"load.mass": {"uniform": [0, 50]}}},
        "load.mass = 0 kg is below its limit 0.01 kg",
    ),
    "a limit in the usual unit": (
        {"randomisation": {"supply.pressure": {"uniform": ["50 bar", "2000 bar"]}}},
        "supply.pressure = 2000 bar is above its limit 1000 bar",
    ),
    "a sensor beyond any range": (
        {"sensors": {"pressure_a": {"high": "40000 bar"}}},
        "sensors.pressure_a.high = '40000 bar': must be a number within -10000 to 10000 bar; 40000 psi meant[?]",
    ),
    "a range without its form": (
        {"randomisation": {"supply.pressure": {"low": "50 bar"}}},
        "randomisation.supply.pressure.low = '50 bar': unknown key; known here: uniform",
    ),
    "above the limit": (
        {"randomisation": {"load.mass": {"uniform": [1, 1e9]}}},
        "load.mass = 1e[+]09 kg is above its limit 1e[+]06 kg",
    ),
    "times nothing": (
        {"randomisation": {"load.mass": {"uniform": [1, 2], "times": "load.weight"}}},
        "times = 'load.weight' is not a parameter",
    ),
    "otherwise alone": ({"randomisation": {"load.mass": {"uniform": [50, 60], "otherwise": 55}}}, "belong together"),
    "probability": (
        {"randomisation": {"load.mass": {"uniform": [50, 60], "otherwise": 55, "otherwise_probability": 2}}},
        "otherwise_probability = 2: .*within 0 to 1",
    ),
    "initial range": (
        {"initial_position_range": [-2.0, 1.0]},
        r"initial_position_range = \[-2, 1\]: must rise within -1 to 1",
    ),
    "initial range NaN": ({"initial_position_range": [NAN, 1.0]}, "must be a number, not NaN"),
    "precharge may exceed supply": (
        {"plant": {"supply": {"precharge_pressure": 65e5}}},
        r"randomisation: .*precharge_pressure = 65 bar must be below pressure = 60 bar",
    ),
    "breakaway may fall below Coulomb": (
        {"randomisation": {"friction.coulomb_force": {"uniform": [100, 300]}}},
        "randomisation: .*breakaway_force = 180 N must not be below coulomb_force = 300 N",
    ),
    "circle": (
        {
            "randomisation": {
                "friction.coulomb_force": {"uniform": [1, 2], "times": "friction.breakaway_force"},
                "friction.breakaway_force": {"uniform": [1, 2], "times": "friction.coulomb_force"},
            }
        },
        "'times' runs in a circle",
    ),
    "error_scale": ({"reward": {"error_scale": 0.0}}, "reward.error_scale = 0.0: .*unit: m"),
    "negative weight": ({"reward": {"effort": -1}}, "reward.effort = -1: must be a number"),
    "rating": ({"failure": {"pressure_rating": 250}}, "failure.pressure_rating = 250: .*unit: Pa"),
}

EVERY_NUMBER = [
    (path, field, bad)
    for path, fields in {
        ("sensors", "position"): ("low", "high", "noise", "bias", "resolution"),
        ("sensors",): ("pressure_rise_time", "velocity_filter_time"),
        ("reward",): ("tracking", "error_scale", "error_limit", "effort", "failure"),
        ("failure",): ("end_stop_speed", "pressure_rating"),
        ("disturbance",): ("pulse_duration",),
        ("references",): ("range_share", "largest_amplitude", "speed_share", "acceleration_limit"),
        ("leakage",): ("healthy_share",),
        (): ("control_period", "command_latency", "episode_duration", "tolerance", "maximum_step"),
    }.items()
    for field in fields
    for bad in (NAN, 1e300, -1e300)
] + [
    (path, field, bad)
    for path, fields in {
        ("references",): ("frequency_range", "step_range"),
        ("disturbance",): ("force_range", "start_range", "frequency_range"),
        ("leakage",): ("healthy_range", "faulty_range", "start_range"),
        (): ("initial_position_range",),
        ("randomisation", "load.mass"): ("uniform", "log_uniform"),
        ("randomisation", "leakage.external_resistance"): ("uniform", "log_uniform"),
    }.items()
    for field in fields
    for bad in ([NAN, 1.0], [0.5, 1e300], [-1e300, 0.5])
]


@pytest.mark.parametrize(("path", "field", "bad"), EVERY_NUMBER)
def test_every_number_of_the_task_has_bounds(path, field, bad):
    """A number that is absurd or none would poison observations or rewards; bounds exclude infinity too."""
    changes = {field: bad}
    for name in reversed(path):
        changes = {name: changes}
    with refused(path[-1] if path[:1] == ("randomisation",) else field):
        task_config(None, **changes)


def test_numbers_at_their_bounds_poison_nothing():
    """The largest force, noise, weights and frequencies that are allowed: finite numbers, and failures with a name."""
    absurd = {
        "disturbance": {"kind": "sine", "force_range": [0.0, 1e6], "start_range": [0.0, 0.0]},
        "sensors": {"position": {"noise": 1e9, "bias": 1e9}, "spool_position": {"resolution": 1e9}},
        "reward": {"tracking": 1e6, "error_scale": 1e-6, "error_limit": 1e6, "effort": 1e6, "failure": 1e9},
        "references": {"frequency_range": [1e-3, 1e3], "acceleration_limit": 100.0, "largest_amplitude": 5.0},
        "leakage": {"schedule": "growth", "healthy_range": [1e-6, 20.0], "faulty_range": [1e-6, 20.0]},
    }
    envs = ServoHydraulicVectorEnv(60, start="actual", **absurd)
    observation, _ = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    failures = set()
    for _ in range(60):
        assert (np.abs(observation) <= envs.single_observation_space.high).all()
        observation, reward, terminated, _, info = envs.step(rng.uniform(-1, 1, (60, 1)))
        assert np.isfinite(reward).all()
        failures |= set(info["failure"][terminated])
    assert failures
    assert "none" not in failures


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_task_is_answered_with_one_line(changes, message):
    for make in (ServoHydraulicEnv, lambda **given: ServoHydraulicVectorEnv(2, **given)):
        with refused(message) as caught:
            make(**changes)
        assert str(caught.value).startswith("task: ")


def test_a_wrong_file_is_named(tmp_path):
    path = tmp_path / "task.yaml"
    path.write_text("reward: {effort: -1}\n")
    with pytest.raises(ConfigurationError, match=rf"^{path}: line 1: reward\.effort = -1: "):
        ServoHydraulicEnv(path)
    with pytest.raises(ConfigurationError, match=r"absent\.yaml: cannot be read: No such file"):
        ServoHydraulicEnv(tmp_path / "absent.yaml")


@pytest.mark.parametrize("config", [42, ["reward"], 3.5, True])
def test_a_config_of_another_kind_is_refused(config):
    with pytest.raises(ConfigurationError, match=r"config = .*: must be a YAML file, a mapping or a TaskConfig"):
        ServoHydraulicEnv(config)
