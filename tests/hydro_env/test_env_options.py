"""Options of reset: each fixes its part of the episode, wrong ones are answered with one line and do no harm."""

import numpy as np
import pytest
from refusal import refused

from hydro_env import REFERENCE_FAMILIES, ConfigurationError, ServoHydraulicEnv, ServoHydraulicVectorEnv

NAN = float("nan")


@pytest.mark.parametrize("family", REFERENCE_FAMILIES[:-1])
def test_the_family_of_the_reference(family):
    env = ServoHydraulicEnv()
    for seed in range(3):
        assert env.reset(seed=seed, options={"reference": family})[1]["reference_family"] == family


def test_the_initial_position():
    env = ServoHydraulicEnv(start="actual")
    for position in (-0.02, 0.0, 0.035):
        observation, info = env.reset(seed=1, options={"initial_position": position, "reference": "sine"})
        assert info["position"] == info["reference"] == position
        assert info["velocity"] == 0.0
        assert observation[env.observation_names.index("position")] * 0.1 == pytest.approx(position, abs=3e-4)


def test_parameters_of_the_plant():
    env = ServoHydraulicEnv()
    wanted = {"load": {"mass": 123.0, "spring_stiffness": 0}, "supply": {"model": "constant", "pressure": 90e5}}
    env.reset(seed=1, options={"parameters": wanted})
    parameters = env.parameters
    assert (parameters.load.mass, parameters.load.spring_stiffness) == (123.0, 0.0)
    assert (parameters.supply.model, parameters.supply.pressure) == ("constant", 90e5)
    env.reset(seed=1)
    assert env.parameters.load.mass != 123.0
    assert env.parameters.load.viscous_damping == parameters.load.viscous_damping  # the rest was drawn as ever


def test_the_whole_plant_of_an_episode_may_be_given_again():
    env = ServoHydraulicEnv()
    env.reset(seed=1)
    plant = env.parameters
    _, info = env.reset(seed=2, options={"parameters": plant, "leakage_flow_lpm": 1.5})
    leak = {"internal_resistance": info["leakage_resistance"]}
    assert env.parameters.load == plant.load
    assert env.parameters.replace(leakage=leak) == plant.replace(leakage=leak)


def test_all_options_together():
    env = ServoHydraulicEnv(sensors={"enabled": False})
    reference = 0.01 + 0.005 * np.sin(0.1 * np.arange(400))
    options = {
        "leakage_flow_lpm": 0.6,
        "reference": reference,
        "initial_position": 0.02,
        "parameters": {"load": {"mass": 55.0}, "supply": {"pressure": 80e5}},
        "persist": False,
    }
    given = {key: value.copy() if isinstance(value, np.ndarray) else value for key, value in options.items()}
    observation, info = env.reset(seed=1, options=options)
    assert info["leakage_flow_lpm"] == pytest.approx(0.6)
    assert info["leakage_class"] == 2
    assert info["reference_family"] == "user"
    assert info["position"] == 0.02
    assert info["reference"] == reference[0]
    assert info["tracking_error"] == pytest.approx(-0.01)
    assert env.parameters.load.mass == 55.0
    assert observation[0] == pytest.approx(0.1)
    for key, value in given.items():  # the caller's dictionary is left alone
        np.testing.assert_array_equal(options[key], value)
    reference[:] = 0.0  # and the caller's array may change afterwards
    env.step(np.zeros(1))
    assert env.step(np.zeros(1))[-1]["reference"] == given["reference"][2]


def test_options_hold_for_one_episode():
    env, plain = ServoHydraulicEnv(), ServoHydraulicEnv()
    env.reset(seed=3, options={"leakage_flow_lpm": 3.9, "initial_position": 0.0, "reference": np.zeros(3)})
    plain.reset(seed=3)
    np.testing.assert_array_equal(env.reset()[0], plain.reset()[0])


WRONG = {
    "unknown": (
        {"leakage": 0.1},
        r"unknown option 'leakage'; did you mean leakage_flow_lpm\? known: leakage_resistance, ",
    ),
    "both leaks": ({"leakage_resistance": 1e12, "leakage_flow_lpm": 0.6}, "exclude each other"),
    "negative leak": ({"leakage_flow_lpm": -0.1}, "leakage of -0.1 l/min at 100 bar: must be within 0 to 20"),
    "leak too large": ({"leakage_flow_lpm": 25.0}, "leakage of 25 l/min at 100 bar: must be within 0 to 20"),
    "leak NaN": ({"leakage_flow_lpm": NAN}, "leakage of nan l/min at 100 bar: must be within 0 to 20"),
    "leak text": ({"leakage_flow_lpm": "much"}, "leakage_flow_lpm = 'much': must be a number"),
    "leak per axis": ({"leakage_flow_lpm": [0.1, 0.2]}, r"leakage_flow_lpm has shape \(2,\): must be one number"),
    "resistance zero": ({"leakage_resistance": 0.0}, "leakage_resistance = 0 Pa s/m³: must be positive"),
    "resistance negative": ({"leakage_resistance": -1e12}, r"leakage_resistance = -1e\+12 Pa s/m³: must be positive"),
    "resistance NaN": ({"leakage_resistance": NAN}, "leakage_resistance = nan Pa s/m³: must be positive"),
    "resistance too small": ({"leakage_resistance": 1e9}, "leakage of 600 l/min at 100 bar: must be within"),
    "reference NaN": ({"reference": [0.0, NAN]}, r"reference\[1\] = nan m: must be a position within the stroke"),
    "reference in mm": ({"reference": [0.0, 10.0]}, r"reference\[1\] = 10 m: .*±0.2 m"),
    "reference at the stop": ({"reference": [-0.2]}, r"reference\[0\] = -0.2 m: must be a position within"),
    "reference empty": ({"reference": []}, "reference: must be a row of positions"),
    "reference of another shape": ({"reference": np.zeros((2, 3, 4))}, r"reference has shape \(2, 3, 4\)"),
    "reference of words": ({"reference": ["up", "down"]}, "reference has 2 names for 1 axes"),
    "reference unknown": ({"reference": "zigzag"}, "reference = 'zigzag': must be an array in m, or of step"),
    "reference user": ({"reference": "user"}, "reference = 'user': must be an array in m"),
    "reference object": ({"reference": {"a": 1}}, "reference must be numbers in m"),
    "reference beyond the spring": (
        {"reference": [0.0, 0.15], "parameters": {"load": {"spring_stiffness": 89e3}, "supply": {"pressure": 70e5}}},
        "reference of 150 mm cannot be reached, only -48.99 to 98.12 mm can, by its plant .supply 70 bar, spring 8.9e",
    ),
    "position outside": ({"initial_position": 0.3}, "initial_position = 0.3 m: must be within the stroke, ±0.2 m"),
    "position NaN": ({"initial_position": NAN}, "initial_position = nan m: must be within the stroke"),
    "position text": ({"initial_position": "left"}, "initial_position = 'left': must be a number"),
    "position not held": (
        {"initial_position": -0.1, "parameters": {"load": {"spring_stiffness": 89e3}}},
        "initial position -100 mm cannot be held by its plant",
    ),
    "reference beyond the spring on the other side": (
        {
            "reference": [0.0, -0.15, 0.05],
            "parameters": {"load": {"spring_stiffness": 89e3}, "supply": {"pressure": 70e5}},
        },
        "reference of -150 mm cannot be reached, only -48.99 to 98.12 mm can",
    ),
    "parameter unknown": (
        {"parameters": {"load": {"weight": 1.0}}},
        "parameters.load.weight is not a parameter of the",
    ),
    "group unknown": (
        {"parameters": {"loads": {"mass": 1.0}}},
        "parameters.loads.mass is not a parameter of the plant",
    ),
    "parameters are a number": ({"parameters": 3}, "parameters must be groups of fields"),
    "group is a number": ({"parameters": {"load": 3}}, "parameters.load must be a mapping of fields"),
    "parameter negative": ({"parameters": {"load": {"mass": -5.0}}}, r"load\.mass = -5\.0: .*unit: kg"),
    "parameter NaN": ({"parameters": {"load": {"mass": NAN}}}, "parameters.load.mass = nan: must be a number"),
    "parameter text": ({"parameters": {"load": {"mass": "big"}}}, "parameters.load.mass = 'big': must be a number"),
    "parameter infinite": ({"parameters": {"load": {"mass": np.inf}}}, r"load\.mass = inf: .*unit: kg"),
    "geometry": ({"parameters": {"cylinder": {"rod_diameter": 0.045}}}, "rod_diameter = 45 mm does not fit"),
    "choice": (
        {"parameters": {"supply": {"model": "hand pump"}}},
        "supply.model = 'hand pump': must be one of constant",
    ),
    "choice by number": ({"parameters": {"supply": {"model": 7}}}, "supply.model = 7: must be one of constant"),
    "precharge above what may be drawn": (
        {"parameters": {"supply": {"precharge_pressure": 65e5}}},
        r"precharge_pressure = 65 bar must be below pressure = 60 bar",
    ),
    "breakaway below what may be drawn": (
        {"parameters": {"friction": {"breakaway_force": 200.0}}},
        "breakaway_force = 200 N must not be below coulomb_force = 300 N",
    ),
    "options are a number": (5, "reset options: 5: must be a mapping, of leakage_resistance"),
    "options are a list": (["persist"], r"reset options: \['persist'\]: must be a mapping"),
    "persist": ({"persist": "yes"}, "persist = 'yes': must be true or false"),
}


@pytest.mark.parametrize(("options", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_option_is_answered_with_one_line_and_does_no_harm(options, message):
    env, untouched = ServoHydraulicEnv(), ServoHydraulicEnv()
    for each in (env, untouched):
        each.reset(seed=1)
    with refused(message):
        env.reset(options=options)
    # The next episode is as if nothing had been asked, save that an attempt to begin one may have been counted.
    np.testing.assert_array_equal(env.reset(seed=2)[0], untouched.reset(seed=2)[0])
    for action in (0.3, -0.2, 0.9):
        np.testing.assert_array_equal(env.step(np.full(1, action))[0], untouched.step(np.full(1, action))[0])


def test_a_wrong_option_leaves_the_running_episode_alone():
    env, untouched = ServoHydraulicEnv(), ServoHydraulicEnv()
    for each in (env, untouched):
        each.reset(seed=1, options={"leakage_flow_lpm": 2.0})
    for options in ({"leakage_flow_lpm": -1.0}, {"initial_position": 0.01, "persist": 3}, {"reference": [NAN]}):
        with pytest.raises(ConfigurationError):
            env.reset(options=options)
        np.testing.assert_array_equal(env.step(np.ones(1))[0], untouched.step(np.ones(1))[0])
    np.testing.assert_array_equal(env.reset()[0], untouched.reset()[0])


def test_after_an_episode_that_could_not_begin_a_reset_is_needed():
    for env, action in ((ServoHydraulicEnv(), np.zeros(1)), (ServoHydraulicVectorEnv(2), np.zeros((2, 1)))):
        impossible = {"initial_position": -0.15, "parameters": {"load": {"spring_stiffness": 1e5}}}
        with pytest.raises(ConfigurationError, match="cannot be held"):
            env.reset(seed=0, options=impossible)
        with pytest.raises(ConfigurationError, match="step: call reset first"):
            env.step(action)
        env.reset()
        assert np.isfinite(env.step(action)[0]).all()


class Odd:
    """An object that NumPy cannot make numbers of."""

    def __array__(self, *_, **__):
        raise RuntimeError("no array")


BAD_ACTIONS = {
    "NaN": np.array([NAN]),
    "infinite": np.array([np.inf]),
    "minus infinite": np.array([-np.inf], dtype=np.float32),
    "complex": [1j],
    "huge": [10**400],
    "two": np.zeros(2),
    "scalar": np.float32(0.1),
    "number": 0.1,
    "matrix": np.zeros((2, 2)),
    "ragged": [[0.1], [0.2, 0.3]],
    "empty": np.zeros(0),
    "text": ["full"],
    "number as text": ["0.5"],
    "word": "full",
    "bytes": b"1",
    "true": [True],
    "nothing": None,
    "list of nothing": [None],
    "mapping": {"a": 1},
    "no array": Odd(),
    "object": object(),
}


@pytest.mark.parametrize("action", BAD_ACTIONS.values(), ids=BAD_ACTIONS)
def test_a_wrong_action_is_answered_with_one_line_and_does_no_harm(action):
    env, untouched = ServoHydraulicEnv(), ServoHydraulicEnv()
    for each in (env, untouched):
        each.reset(seed=1)
        each.step(np.full(1, 0.5))
    with refused(r"action = .*: must be finite, of shape \(1,\)"):
        env.step(action)
    np.testing.assert_array_equal(env.step(np.full(1, 0.5))[0], untouched.step(np.full(1, 0.5))[0])
    envs = ServoHydraulicVectorEnv(2)
    envs.reset(seed=0)
    with refused("^action"):
        envs.step(action)


def test_a_reference_given_for_one_episode_leaves_the_reference_of_the_task():
    task = {"references": {"weights": {"user": 1.0}, "user": [0.0, 0.01]}}
    for make in (lambda: ServoHydraulicEnv(**task), lambda: ServoHydraulicVectorEnv(2, **task)):
        env = make()
        env.reset(seed=0, options={"reference": [0.02, 0.02]})
        assert (env.axes.reference == 0.02).all()
        env.reset()
        assert (env.axes.reference[:, 1:] == 0.01).all()
