"""Options of reset, for one axis and for many: each fixes its part of the episode; wrong ones do no harm."""

import re

import numpy as np
import pytest
from refusal import refused

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv

SHORT = {"episode_duration": 0.05}
NAN = float("nan")
STIFF = {"load": {"spring_stiffness": 89e3}, "supply": {"pressure": 70e5}}


def three(**settings):
    return ServoHydraulicVectorEnv(3, **settings)


BOTH = pytest.mark.parametrize("make", [ServoHydraulicEnv, three])


def stepped(env, value):
    """The observation after a step with the same command on every axis."""
    return env.step(np.full(env.action_space.shape, value))[0]


def test_parameters_of_the_plant():
    env = ServoHydraulicEnv()
    wanted = {"load": {"mass": 123.0, "spring_stiffness": 0}, "supply": {"model": "constant", "pressure": 90e5}}
    env.reset(seed=1, options={"parameters": wanted})
    plant = env.parameters
    assert (plant.load.mass, plant.load.spring_stiffness) == (123.0, 0.0)
    assert (plant.supply.model, plant.supply.pressure) == ("constant", 90e5)
    _, info = env.reset(seed=2, options={"parameters": plant, "leakage_flow_lpm": 1.5})
    leak = {"internal_resistance": info["leakage_resistance"]}
    assert env.parameters.replace(leakage=leak) == plant.replace(leakage=leak)  # the whole plant, given again
    env.reset(seed=1)
    assert env.parameters.load.mass != 123.0
    assert env.parameters.load.viscous_damping == plant.load.viscous_damping  # the rest was drawn as ever


def test_all_options_together():
    env = ServoHydraulicEnv(sensors={"enabled": False})
    reference = 0.01 + 0.005 * np.sin(0.1 * np.arange(400))
    options = {
        "leakage_flow_lpm": 0.6,
        "reference": reference,
        "initial_position": 0.02,
        "parameters": {"load": {"mass": 55.0}, "supply": {"pressure": 80e5}},
    }
    given = {key: value.copy() if isinstance(value, np.ndarray) else value for key, value in options.items()}
    observation, info = env.reset(seed=1, options=options)
    assert info["leakage_flow_lpm"] == pytest.approx(0.6)
    assert (info["leakage_class"], info["reference_family"], info["position"]) == (2, "user", 0.02)
    assert info["reference"] == reference[0]
    assert info["tracking_error"] == pytest.approx(-0.01)
    assert env.parameters.load.mass == 55.0
    assert observation[0] == pytest.approx(0.1)
    for key, value in given.items():  # the caller's dictionary is left alone
        np.testing.assert_array_equal(options[key], value)
    reference[:] = 0.0  # and the caller's array may change afterwards
    env.step(np.zeros(1))
    assert env.step(np.zeros(1))[-1]["reference"] == given["reference"][2]


def test_options_per_axis_are_those_of_the_single_environments():
    references = np.linspace(-0.02, 0.02, 3)[:, None] + 0.001 * np.arange(30)
    flows, positions, masses = [0.01, 0.1, 3.0], [-0.01, 0.0, 0.02], [50.0, 60.0, 70.0]

    def options(flow, position, reference, mass):
        plant = {"load": {"mass": mass}, "friction": {"model": "none"}}
        return {"leakage_flow_lpm": flow, "initial_position": position, "reference": reference, "parameters": plant}

    envs = three(start="actual")
    rows, info = envs.reset(seed=30, options=options(flows, positions, references, masses))
    after = stepped(envs, 0.3)
    for axis, own in enumerate(zip(flows, positions, references, masses, strict=True)):
        single = ServoHydraulicEnv(start="actual")
        observation, single_info = single.reset(seed=30 + axis, options=options(*own))
        np.testing.assert_array_equal(rows[axis], observation)
        assert info["position"][axis] == single_info["position"] == positions[axis]
        assert single_info["velocity"] == 0.0
        assert envs.axes.parameters(axis) == single.parameters
        np.testing.assert_array_equal(after[axis], stepped(single, 0.3))


def test_a_mask_begins_only_some_axes():
    envs, untouched = (ServoHydraulicVectorEnv(5, start="actual") for _ in range(2))
    for each in (envs, untouched):
        each.reset(seed=0)
        stepped(each, 1.0)
    mask = np.array([False, True, False, False, True])
    before = stepped(untouched, 1.0)
    stepped(envs, 1.0)
    rows, info = envs.reset(options={"reset_mask": mask, "initial_position": 0.004})
    np.testing.assert_array_equal(rows[~mask], before[~mask])  # the others' last observation
    np.testing.assert_array_equal(info["position"], np.where(mask, 0.004, 0.0))  # others: not reported
    np.testing.assert_array_equal(info["_position"], mask)
    assert info["failure"].tolist() == [None, "none", None, None, "none"]
    np.testing.assert_array_equal(stepped(envs, 1.0)[~mask], stepped(untouched, 1.0)[~mask])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_options_hold_for_one_episode(mode):
    flows = np.array([0.4, 1.4])
    options = {"leakage_flow_lpm": flows, "reference": 0.01 * np.ones(4), "parameters": {"load": {"mass": 66.0}}}
    envs = ServoHydraulicVectorEnv(2, autoreset_mode=mode, **SHORT)
    _, info = envs.reset(seed=0, options=options)
    assert (info["leakage_flow_lpm"] == flows).all()
    for _ in range(12):
        *_, info = envs.step(np.zeros((2, 1)))
    assert (info["leakage_flow_lpm"] != flows).all()
    assert (info["reference_family"] != "user").all()
    assert envs.axes.parameters(1).load.mass != 66.0
    # An option on one axis lets go of that axis alone.
    envs.reset(options={"leakage_flow_lpm": flows})
    envs.reset(options={"leakage_flow_lpm": 3.5, "reset_mask": np.array([True, False])})
    assert envs.axes.column("leak_flow").tolist() == [3.5, 1.4]


def of_load(**values):
    return {"parameters": {"load": values}}


WRONG = [
    ({"leakage": 0.1}, r"unknown option 'leakage'; did you mean leakage_flow_lpm\? known: leakage_flow_lpm, "),
    ({"leakage_flow_lpm": NAN}, "leakage_flow_lpm = nan l/min at 100 bar: must be within 0 to 20"),
    ({"reference": [0.0, NAN]}, r"reference\[1\] = nan m: must be a position within the stroke"),
    ({"reference": np.zeros((2, 3, 4))}, r"reference has shape \(2, 3, 4\)"),
    ({"reference": "zigzag"}, "reference = 'zigzag': must be an array in m, or of step"),
    ({"reference": [0.0, 0.15], "parameters": STIFF}, "its reference cannot be reached by its plant"),
    ({"initial_position": 0.3}, "initial_position = 0.3 m: must be within -0.2 to 0.2"),
    ({"initial_position": -0.1, "parameters": STIFF}, "initial position -100 mm cannot be held by its plant"),
    (of_load(weight=1.0), "parameters.load.weight is not a parameter of the"),
    (of_load(mass=-5.0), r"load\.mass = -5\.0: .*unit: kg"),
    ({"parameters": {"supply": {"model": "hand pump"}}}, "supply.model = 'hand pump': must be one of constant"),
    # Beyond what may be drawn for the other parameter.
    ({"parameters": {"supply": {"precharge_pressure": 65e5}}}, "precharge_pressure = 65 bar .* pressure = 60 bar"),
    (5, "reset options: 5: must be a mapping, of leakage_flow_lpm"),
]
OF_THREE = [
    ({"leakage_flow_lpm": [0.1, 0.2]}, r"has shape \(2,\): must be one number, or one per axis"),
    (of_load(mass=[50.0, -1.0, 60.0]), r"load\.mass = -1\.0"),
    ({"reference": np.zeros((2, 9))}, r"reference has shape \(2, 9\): must be \(samples,\) or \(3, sam"),
    ({"reference": [[0.0], [NAN], [0.0]]}, r"reference\[0\] = nan m"),
    *(
        ({"reset_mask": mask}, r"reset_mask must be a boolean array of shape \(3,\) with at least one True")
        for mask in (np.array([0, 1, 1]), np.array([True]), np.zeros(3, dtype=bool), "TTT", [[True], [True, False]])
    ),
    ({"initial_position": [0.0, 0.0, -0.12], "parameters": STIFF}, "^axis 2: initial position -120 mm cannot be held"),
]
CASES = [(three, *case) for case in (*WRONG, *OF_THREE)] + [(ServoHydraulicEnv, *case) for case in WRONG[::3]]


def words(value):
    """The same in every worker of pytest."""
    return re.sub(" at 0x[0-9a-f]+", "", str(value))[:60] if isinstance(value, dict | list | int) else None


@pytest.mark.parametrize(("make", "options", "message"), CASES, ids=words)
def test_a_wrong_option_is_refused_and_does_no_harm(make, options, message):
    env, untouched = make(), make()
    for each in (env, untouched):
        each.reset(seed=1)
    with refused(message):
        env.reset(options=options)
    if "held" not in message and "reached" not in message and "only" not in message:  # the episode goes on
        np.testing.assert_array_equal(stepped(env, 0.5), stepped(untouched, 0.5))
    np.testing.assert_array_equal(env.reset(seed=2)[0], untouched.reset(seed=2)[0])
    np.testing.assert_array_equal(stepped(env, 0.3), stepped(untouched, 0.3))


@BOTH
def test_after_an_episode_that_could_not_begin_a_reset_is_needed(make):
    env = make()
    with refused("step: call reset first"):
        stepped(env, 0.0)
    with refused("cannot be held"):
        env.reset(seed=0, options={"initial_position": -0.15, **of_load(spring_stiffness=1e5)})
    with refused("step: call reset first"):
        stepped(env, 0.0)
    env.reset()
    assert np.isfinite(stepped(env, 0.0)).all()


def test_the_first_reset_must_begin_every_axis():
    envs = three()
    with refused("the first reset must begin every axis"):
        envs.reset(options={"reset_mask": np.array([True, False, False])})
    with refused("seed: 2 seeds for 3 axes"):
        envs.reset(seed=[1, 2])
    envs.reset(options={"reset_mask": np.ones(3, dtype=bool)})
    assert np.isfinite(stepped(envs, 0.0)).all()


BAD_ACTIONS = [np.array([NAN]), np.array([-np.inf], np.float32), np.zeros(2), 0.1, ["0.5"], [True], None]
"""``tests/house/test_fuzzing.py`` draws others."""
OF_ONE = r"action = .*: must be finite, of shape \(1,\)"
ACTIONS = [(ServoHydraulicEnv, action, OF_ONE) for action in BAD_ACTIONS]
ACTIONS += [(three, action, "^action") for action in BAD_ACTIONS]
ACTIONS += [
    (three, np.array([[0.0], [NAN], [0.0]]), r"actions\[1\] = nan: must be a finite number"),
    (three, np.zeros(3), r"actions: shape \(3,\): must be numbers within -1 to 1, of shape \(3, 1\)"),
]
