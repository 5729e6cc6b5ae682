"""Options of the vector environment: per axis, for some axes, for the automatic resets; and wrong ones."""

import pickle

import numpy as np
import pytest
from refusal import refused

from hydro_env import ConfigurationError, ServoHydraulicEnv, ServoHydraulicVectorEnv

SHORT = {"episode_duration": 0.05}
NAN = float("nan")


def test_one_value_for_all_axes_or_one_for_each():
    envs = ServoHydraulicVectorEnv(3)
    _, info = envs.reset(seed=0, options={"leakage_flow_lpm": 0.5})
    assert info["leakage_flow_lpm"].tolist() == [0.5] * 3
    flow = np.array([0.01, 0.2, 3.0])
    _, info = envs.reset(seed=0, options={"leakage_flow_lpm": flow})
    np.testing.assert_array_equal(info["leakage_flow_lpm"], flow)
    assert info["leakage_class"].tolist() == [0, 1, 3]
    resistance = np.array([1e12, 2e12, 3e13])
    _, info = envs.reset(seed=0, options={"leakage_resistance": resistance.tolist()})
    np.testing.assert_allclose(info["leakage_resistance"], resistance, rtol=1e-12)


def test_options_per_axis_are_those_of_the_single_environments():
    count = 4
    references = np.linspace(-0.02, 0.02, count)[:, None] + 0.001 * np.arange(30)
    options = {
        "leakage_flow_lpm": np.array([0.01, 0.1, 1.0, 3.0]),
        "initial_position": np.array([-0.01, 0.0, 0.01, 0.02]),
        "reference": references,
        "parameters": {"load": {"mass": np.array([50.0, 60.0, 70.0, 80.0])}, "friction": {"model": "none"}},
    }
    envs = ServoHydraulicVectorEnv(count, start="actual")
    rows, info = envs.reset(seed=30, options=options)
    stepped = envs.step(np.full((count, 1), 0.3))[0]
    for axis in range(count):
        single = ServoHydraulicEnv(start="actual")
        own = {
            "leakage_flow_lpm": options["leakage_flow_lpm"][axis],
            "initial_position": options["initial_position"][axis],
            "reference": references[axis],
            "parameters": {"load": {"mass": 50.0 + 10.0 * axis}, "friction": {"model": "none"}},
        }
        observation, single_info = single.reset(seed=30 + axis, options=own)
        np.testing.assert_array_equal(rows[axis], observation)
        assert info["position"][axis] == single_info["position"] == options["initial_position"][axis]
        assert envs.axes.parameters(axis) == single.parameters
        np.testing.assert_array_equal(stepped[axis], single.step(np.full(1, 0.3))[0])


def test_references_by_name_per_axis():
    envs = ServoHydraulicVectorEnv(3)
    _, info = envs.reset(seed=0, options={"reference": ["step", "sine", "ramp"]})
    assert info["reference_family"].tolist() == ["step", "sine", "ramp"]
    _, info = envs.reset(options={"reference": "multi_sine"})
    assert info["reference_family"].tolist() == ["multi_sine"] * 3
    _, info = envs.reset(options={"reference": 0.01 * np.ones(7)})
    assert info["reference"].tolist() == [0.01] * 3


def test_a_mask_begins_only_some_axes():
    envs, untouched = (ServoHydraulicVectorEnv(5, start="actual") for _ in range(2))
    for each in (envs, untouched):
        each.reset(seed=0)
        each.step(np.ones((5, 1)))
    mask = np.array([False, True, False, False, True])
    before = untouched.step(np.ones((5, 1)))
    envs.step(np.ones((5, 1)))
    rows, info = envs.reset(options={"reset_mask": mask, "initial_position": 0.004})
    np.testing.assert_array_equal(rows[~mask], before[0][~mask])  # the others' last observation
    assert (info["position"][mask] == 0.004).all()
    assert (info["position"][~mask] == 0.0).all()  # not reported, as Gymnasium does
    np.testing.assert_array_equal(info["_position"], mask)
    assert info["failure"].tolist() == [None, "none", None, None, "none"]
    mine, other = (env.step(np.ones((5, 1)))[0] for env in (envs, untouched))
    np.testing.assert_array_equal(mine[~mask], other[~mask])


def test_values_per_axis_with_a_mask_may_count_all_or_only_the_chosen_axes():
    mask = np.array([False, True, False, True])
    for values in ([1.0, 2.0, 3.0, 4.0], [2.0, 4.0]):
        envs = ServoHydraulicVectorEnv(4)
        envs.reset(seed=0)
        _, info = envs.reset(options={"reset_mask": mask, "leakage_flow_lpm": values})
        assert info["leakage_flow_lpm"].tolist() == [0.0, 2.0, 0.0, 4.0]
    references = np.array([[0.0], [0.01], [0.0], [0.02]])
    _, info = envs.reset(options={"reset_mask": mask, "reference": references})
    assert info["reference"].tolist() == [0.0, 0.01, 0.0, 0.02]


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_options_hold_for_automatic_resets_only_if_they_persist(mode):
    flows = np.array([0.4, 1.4])
    options = {"leakage_flow_lpm": flows, "reference": 0.01 * np.ones(4), "parameters": {"load": {"mass": 66.0}}}
    for persist in (True, False):
        envs = ServoHydraulicVectorEnv(2, autoreset_mode=mode, **SHORT)
        envs.reset(seed=0, options={**options, "persist": persist})
        began = 0
        for _ in range(35):
            _, _, _, truncated, info = envs.step(np.zeros((2, 1)))
            if (mode == "SameStep" and truncated.any()) or (
                mode == "NextStep" and (envs.axes.column("step") == 0).any()
            ):
                began += 1
                kept = info["leakage_flow_lpm"] == flows
                assert kept.all() == persist
                assert (info["reference_family"] == "user").all() == persist
                assert (envs.axes.parameters(1).load.mass == 66.0) == persist
        assert began >= 3
        # A reset without options is a new beginning in any case.
        _, info = envs.reset(seed=0)
        assert (info["leakage_flow_lpm"] != flows).all()
        for _ in range(12):
            _, _, _, _, info = envs.step(np.zeros((2, 1)))
        assert (info["leakage_flow_lpm"] != flows).all()


def test_persistence_of_some_axes():
    envs = ServoHydraulicVectorEnv(3, **SHORT)
    envs.reset(seed=0)
    mask = np.array([True, False, False])
    envs.reset(options={"leakage_flow_lpm": 2.5, "persist": True, "reset_mask": mask})
    for _ in range(40):
        _, _, _, _, info = envs.step(np.zeros((3, 1)))
        assert info["leakage_flow_lpm"][0] == 2.5
        assert (info["leakage_flow_lpm"][1:] != 2.5).all()
    # An option that does not persist, on one axis, lets go of that axis alone.
    envs.reset(options={"leakage_flow_lpm": 1.5, "persist": True})
    envs.reset(options={"leakage_flow_lpm": 3.5, "reset_mask": mask})
    for _ in range(35):
        _, _, _, _, info = envs.step(np.zeros((3, 1)))
    assert info["leakage_flow_lpm"][0] not in (1.5, 3.5)
    assert info["leakage_flow_lpm"][1:].tolist() == [1.5, 1.5]


WRONG = {
    "leaks for another count": (
        {"leakage_flow_lpm": [0.1, 0.2]},
        r"has shape \(2,\): must be one number, or one per axis",
    ),
    "one leak negative": ({"leakage_flow_lpm": [0.1, -0.2, 0.3]}, "leakage of -0.2 l/min at 100 bar"),
    "one leak NaN": ({"leakage_flow_lpm": [0.1, NAN, 0.3]}, "leakage of nan l/min at 100 bar"),
    "one position outside": ({"initial_position": [0.0, 0.0, 0.25]}, "initial_position = 0.25 m"),
    "one mass negative": ({"parameters": {"load": {"mass": [50.0, -1.0, 60.0]}}}, r"load\.mass = -1\.0"),
    "one mass NaN": ({"parameters": {"load": {"mass": [50.0, NAN, 60.0]}}}, "load.mass = nan"),
    "two references": (
        {"reference": np.zeros((2, 9))},
        r"reference has shape \(2, 9\): must be \(samples,\) or \(3, sam",
    ),
    "one reference NaN": ({"reference": [[0.0], [NAN], [0.0]]}, r"reference\[0\] = nan m"),
    "two names": ({"reference": ["sine", "step"]}, "reference has 2 names for 3 axes"),
    "mask of numbers": ({"reset_mask": np.array([0, 1, 1])}, r"reset_mask must be a boolean array of shape \(3,\)"),
    "mask of another length": ({"reset_mask": np.array([True])}, r"reset_mask must be a boolean array of shape \(3,\)"),
    "mask of none": ({"reset_mask": np.zeros(3, dtype=bool)}, "with at least one True"),
    "unknown": ({"leak": 1.0}, "unknown option 'leak'"),
    "one position not held": (
        {"initial_position": [0.0, 0.0, -0.12], "parameters": {"load": {"spring_stiffness": 89e3}}},
        "^axis 2: initial position -120 mm cannot be held",
    ),
}


@pytest.mark.parametrize(("options", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_option_is_answered_with_one_line_and_does_no_harm(options, message):
    envs, untouched = ServoHydraulicVectorEnv(3), ServoHydraulicVectorEnv(3)
    for each in (envs, untouched):
        each.reset(seed=0)
    with refused(message):
        envs.reset(options=options)
    np.testing.assert_array_equal(envs.reset(seed=1)[0], untouched.reset(seed=1)[0])
    np.testing.assert_array_equal(envs.step(np.ones((3, 1)))[0], untouched.step(np.ones((3, 1)))[0])


BAD_ACTIONS = {
    "NaN": (np.array([[0.0], [NAN], [0.0]]), r"actions\[1\] = nan: must be a finite number"),
    "infinite": (np.array([[0.0], [0.0], [np.inf]]), r"actions\[2\] = inf: must be a finite number"),
    "flat": (np.zeros(3), r"actions: shape \(3,\): must be \(3, 1\)"),
    "too many": (np.zeros((4, 1)), r"actions: shape \(4, 1\): must be \(3, 1\)"),
    "text": ([["a"], ["b"], ["c"]], "actions: must be numbers"),
    "ragged": ([[0.0], [0.0, 1.0], [0.0]], "actions: must be numbers"),
}


@pytest.mark.parametrize(("actions", "message"), BAD_ACTIONS.values(), ids=BAD_ACTIONS)
def test_a_wrong_action_is_answered_with_one_line_and_does_no_harm(actions, message):
    envs, untouched = ServoHydraulicVectorEnv(3), ServoHydraulicVectorEnv(3)
    for each in (envs, untouched):
        each.reset(seed=0)
    with refused(message):
        envs.step(actions)
    np.testing.assert_array_equal(envs.step(np.ones((3, 1)))[0], untouched.step(np.ones((3, 1)))[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs = 0: must be a whole number within 1 to 1000000"),
        ({"threads": 0}, "threads = 0: must be a whole number within 1 to 1024"),
        ({"threads": 1.5}, "threads = 1.5: must be a whole number"),
        ({"render_mode": "human"}, "render_mode = 'human': the vector environment does not draw"),
        ({"autoreset_mode": "later"}, "autoreset_mode = 'later': must be one of NextStep, SameStep, Disabled"),
        ({"max_episode_steps": 0}, "max_episode_steps = 0: must be a whole number of at least 1"),
        ({"leakage": {"law": "none"}}, "leakage.law = 'none'"),
    ],
)
def test_a_wrong_argument_is_answered_with_one_line(arguments, message):
    with refused(message):
        ServoHydraulicVectorEnv(**{"num_envs": 2, **arguments})


def test_the_first_reset_must_begin_every_axis():
    envs = ServoHydraulicVectorEnv(3)
    with pytest.raises(ConfigurationError, match="step: call reset first"):
        envs.step(np.zeros((3, 1)))
    with pytest.raises(ConfigurationError, match="the first reset must begin every axis"):
        envs.reset(options={"reset_mask": np.array([True, False, False])})
    with pytest.raises(ConfigurationError, match="seed: 2 seeds for 3 axes"):
        envs.reset(seed=[1, 2])
    envs.reset(options={"reset_mask": np.ones(3, dtype=bool)})
    assert np.isfinite(envs.step(np.zeros((3, 1)))[0]).all()


@pytest.mark.parametrize("count", [3, 150])
def test_a_copy_goes_on_like_the_original(count):
    """Also where worker threads run."""
    envs = ServoHydraulicVectorEnv(count, threads=2)
    envs.reset(seed=0)
    envs.step(np.ones((count, 1)))
    other = pickle.loads(pickle.dumps(envs))
    for number in range(5):
        mine, copied = (env.step(np.full((count, 1), 0.1 * number)) for env in (envs, other))
        np.testing.assert_array_equal(mine[0], copied[0])
        np.testing.assert_array_equal(mine[1], copied[1])
    np.testing.assert_array_equal(envs.reset()[0], other.reset()[0])
    envs.close()
    other.close()
